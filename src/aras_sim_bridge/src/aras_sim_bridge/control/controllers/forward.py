"""Controllers that hand commands on as they are: positions, velocities, efforts.

None of them zeroes its output when it stops, as upstream's do not.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from aras_sim_bridge import parameters as params
from aras_sim_bridge.control.controllers.base import Context, Controller, checked_number
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import EFFORT, POSITION, VELOCITY, JointHandle
from aras_sim_bridge.errors import ControllerError

# The handle's command that belongs to an interface.
COMMAND_OF = {
    "EffortJointInterface": "effort_command",
    "PositionJointInterface": "position_command",
    "VelocityJointInterface": "velocity_command",
}


def resting_command(interface: str, handle: JointHandle) -> float:
    """The command that keeps a joint where it is: its position, or 0."""
    return handle.position if interface == POSITION else 0.0


def checked_numbers(values: object, joints: Sequence[str], controller: str) -> list[float]:
    """`values` as floats. Raises ControllerError on a wrong length or a number not finite."""
    try:
        given = list(values)
    except TypeError:
        raise ControllerError(f"controller '{controller}': command {values!r} is no list") from None
    if len(given) != len(joints):
        raise ControllerError(
            f"controller '{controller}': command has {len(given)} values for {len(joints)} "
            f"joints ({', '.join(joints)}); it is dropped"
        )
    return [
        checked_number(value, controller, f"command for {joint}")
        for value, joint in zip(given, joints, strict=True)
    ]


class ForwardController(Controller):
    """One joint. Parameter: `joint`."""

    command_kind = "float64"

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint."""
        super().init(hardware, parameters, context)
        joint = params.name(parameters, "joint", context.where)
        self.handle = self.take_handle(hardware, joint)
        self.joints = (joint,)
        self._target = COMMAND_OF[self.interface]
        self._command = 0.0

    def starting(self, time_ns: int) -> None:
        """Stay: the present position, or 0."""
        super().starting(time_ns)
        self._command = resting_command(self.interface, self.handle)

    def update(self, time_ns: int, period: float) -> None:
        """Hand the command on."""
        if self.slot:
            self._command = self.slot.pop()
        setattr(self.handle, self._target, self._command)

    def set_command(self, value: float) -> None:
        """In the interface's unit. Raises ControllerError if it is not finite."""
        self.slot.append(checked_number(value, self.context.name))


class ForwardGroupController(Controller):
    """Several joints. Parameter: `joints`."""

    command_kind = "float64_array"
    interface: ClassVar[str]

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint."""
        super().init(hardware, parameters, context)
        joints = params.names(parameters, "joints", context.where)
        self._handles = [self.take_handle(hardware, joint) for joint in joints]
        self.joints = joints
        self._target = COMMAND_OF[self.interface]
        self._commands = [0.0] * len(joints)

    def starting(self, time_ns: int) -> None:
        """Stay: the present positions, or 0."""
        super().starting(time_ns)
        self._commands = [resting_command(self.interface, handle) for handle in self._handles]

    def update(self, time_ns: int, period: float) -> None:
        """Hand the commands on."""
        if self.slot:
            self._commands = self.slot.pop()
        for handle, command in zip(self._handles, self._commands, strict=True):
            setattr(handle, self._target, command)

    def set_command(self, value: Sequence[float]) -> None:
        """One number a joint, in the order of `joints`.

        Raises ControllerError, keeping the last command, on a wrong length or a number that is
        not finite.
        """
        self.slot.append(checked_numbers(value, self.joints, self.context.name))


@register("effort_controllers/JointEffortController")
class EffortJointEffortController(ForwardController):
    """Hands an effort on, N m or N."""

    interface = EFFORT


@register("position_controllers/JointPositionController")
class PositionJointPositionController(ForwardController):
    """Hands a position on, rad or m; its limits are the handle's affair."""

    interface = POSITION


@register("velocity_controllers/JointVelocityController")
class VelocityJointVelocityController(ForwardController):
    """Hands a velocity on, rad/s or m/s."""

    interface = VELOCITY


@register("effort_controllers/JointGroupEffortController")
class GroupEffortController(ForwardGroupController):
    """Hands efforts on."""

    interface = EFFORT


@register("position_controllers/JointGroupPositionController")
class GroupPositionController(ForwardGroupController):
    """Hands positions on."""

    interface = POSITION


@register("velocity_controllers/JointGroupVelocityController")
class GroupVelocityController(ForwardGroupController):
    """Hands velocities on."""

    interface = VELOCITY
