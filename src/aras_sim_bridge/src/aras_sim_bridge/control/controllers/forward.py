"""Controllers of commanded joints, and those that hand commands on as they are.

None of them zeroes its output when it stops, as upstream's do not.
"""

from collections.abc import Mapping, Sequence

from aras_sim_bridge.control.controllers.base import Context, Controller, checked_number, names_of
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import EFFORT, POSITION, VELOCITY
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read

# The handle's command that belongs to an interface.
COMMAND_OF = {
    EFFORT: "effort_command",
    POSITION: "position_command",
    VELOCITY: "velocity_command",
}


class CommandedController(Controller):
    """A number a joint, in the interface's unit: of the one `joint`, or of a group's `joints`.

    The slot holds them as a list, in the order of `joints`.
    """

    command_kind = "float64"

    @property
    def is_group(self) -> bool:
        """Whether it takes lists, for the joints of the parameter `joints`."""
        return self.command_kind == "float64_array"

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint."""
        super().init(hardware, parameters, context)
        if self.is_group:
            self.joints = names_of(parameters, "joints", context.where)
        else:
            self.joints = (read(parameters, "joint", str, context.where, ControllerError),)
        self.handles = [self.take_handle(hardware, joint) for joint in self.joints]
        self.target = COMMAND_OF[self.interface]

    def set_command(self, value: float | Sequence[float]) -> None:
        """Raises ControllerError, keeping the last command, on a wrong length or a number that is
        not finite."""
        name, joints = self.context.name, self.joints
        if not self.is_group:
            self.slot.append([checked_number(value, name)])
            return
        try:
            given = list(value)
        except TypeError:
            raise ControllerError(f"controller '{name}': command {value!r} is no list") from None
        if len(given) != len(joints):
            raise ControllerError(
                f"controller '{name}': command has {len(given)} values for {len(joints)} "
                f"joints ({', '.join(joints)}); it is dropped"
            )
        self.slot.append([
            checked_number(number, name, f"command for {joint}")
            for number, joint in zip(given, joints, strict=True)
        ])  # fmt: skip


@register("effort_controllers/JointEffortController", interface=EFFORT)
@register("position_controllers/JointPositionController", interface=POSITION)
@register("velocity_controllers/JointVelocityController", interface=VELOCITY)
class ForwardController(CommandedController):
    """Hands efforts (N m, N), positions (rad, m) or velocities (rad/s, m/s) on.

    Limits are the handles' affair.
    """

    def starting(self, time_ns: int) -> None:
        """Stay: the present positions, or 0."""
        super().starting(time_ns)
        stays = self.interface == POSITION
        self._commands = [handle.position if stays else 0.0 for handle in self.handles]

    def update(self, time_ns: int, period: float) -> None:
        """Hand the commands on."""
        if self.slot:
            self._commands = self.slot.pop()
        for handle, command in zip(self.handles, self._commands, strict=True):
            setattr(handle, self.target, command)


@register("effort_controllers/JointGroupEffortController", interface=EFFORT)
@register("position_controllers/JointGroupPositionController", interface=POSITION)
@register("velocity_controllers/JointGroupVelocityController", interface=VELOCITY)
class ForwardGroupController(ForwardController):
    """The same for several joints."""

    command_kind = "float64_array"
