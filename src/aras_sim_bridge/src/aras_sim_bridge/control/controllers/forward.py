"""Base class of controllers with one command per joint, and controllers that forward commands.

As in ros_controllers, a controller does not set its output to zero when it stops.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from aras_sim_bridge.control.controllers.base import (
    STATE_EVERY,
    Controller,
    ControllerContext,
    check_number,
    read_joint_names,
)
from aras_sim_bridge.control.controllers.joint_control_loop import (
    FORWARD,
    LOOP_COLUMNS,
    JointControlLoop,
    update_loops,
)
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import EFFORT, POSITION, VELOCITY
from aras_sim_bridge.control.pid import Pid
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read


class JointCommandController(Controller):
    """Controller with one commanded number for each joint, in the interface's unit.

    The parameter `joint` names the joint; for a group, the parameter `joints` lists several.

    Attributes:
        loops: one loop for each joint.
        rows: (m, 39) array; each row stores the state of one of the m loops.
    """

    command_kind = "float64"
    loop_kind = FORWARD

    @property
    def is_group(self) -> bool:
        """Whether a command is a list with one number for each joint of the parameter `joints`."""
        return self.command_kind == "float64_array"

    def init(
        self, hardware: RobotHardware, parameters: Mapping, context: ControllerContext
    ) -> None:
        """Read the joints and create their loops. Raises ControllerError for a missing joint."""
        super().init(hardware, parameters, context)
        if self.is_group:
            self.joints = read_joint_names(parameters, "joints", context.where)
        else:
            self.joints = (read(parameters, "joint", str, context.where, ControllerError),)
        handles = [self.take_handle(hardware, joint) for joint in self.joints]
        known = list(hardware.handles)
        self._handles = hardware.handle_rows
        self.rows = np.zeros((len(handles), LOOP_COLUMNS))
        self.loops = [
            JointControlLoop(
                row, self.loop_kind, handle, known.index(handle.name), context.name,
                **self._make_loop_options(handle.name, parameters),
            )
            for row, handle in zip(self.rows, handles, strict=True)
        ]  # fmt: skip

    def get_loop_gains(self) -> dict[str, tuple[float, float]]:
        found = {loop.handle.name: loop.gains for loop in self.loops if loop.pid is not None}
        return found if self.interface == EFFORT else {}

    def _make_loop_options(self, joint: str, parameters: Mapping) -> dict[str, Pid | bool]:
        """Return additional keyword arguments for the JointControlLoop of a joint."""
        return {}

    def bind(self, rows: np.ndarray) -> None:
        """Copy the state of the m loops to `rows` (m, 39), and store it there from now on."""
        self.rows = rows
        for loop, row in zip(self.loops, rows, strict=True):
            loop.bind(row)

    def set_command(self, value: float | Sequence[float]) -> None:
        """Store a command.

        Raises:
            ControllerError: the length is wrong or a number is not finite; the last command remains
                in use.
        """
        name, joints = self.context.name, self.joints
        if not self.is_group:
            self.slot.append([check_number(value, name)])
            return
        try:
            given = list(value)
        except TypeError:
            raise ControllerError(
                f"controller '{name}': command {value!r} is not a list of numbers; send one number "
                "for each joint"
            ) from None
        if len(given) != len(joints):
            raise ControllerError(
                f"controller '{name}': command has {len(given)} values for {len(joints)} "
                f"joints ({', '.join(joints)}); the command is ignored; send one value for each"
            )
        self.slot.append([
            check_number(number, name, f"command for {joint}")
            for number, joint in zip(given, joints, strict=True)
        ])  # fmt: skip

    def starting(self, time_ns: int) -> None:
        """Hold the current positions; if commands are efforts or velocities, command 0."""
        super().starting(time_ns)
        for loop in self.loops:
            loop.start()

    def apply_pending_command(self, time_ns: int) -> None:
        """Pass the last command of `set_command` to the loops, in the control cycle at `time_ns`.
        """
        for loop, command in zip(self.loops, self.slot.pop(), strict=True):
            loop.set_command(command, time_ns)

    @property
    def is_compilable(self) -> bool:
        """Whether no subclass overrides a method that compiled code replaces."""
        return all(
            getattr(type(self), name) is getattr(JointCommandController, name)
            for name in ("set_command", "apply_pending_command", "update")
        )

    def update(self, time_ns: int, period: float) -> None:
        """Compute the output of each loop and write it to the joint handles."""
        is_state_due = self.loops[0].updates % STATE_EVERY == 0
        if self.slot:
            self.apply_pending_command(time_ns)
        for pid in self.pids.values():
            pid.apply_gains()
        update_loops(self.rows, self._handles, period)
        for pid in self.pids.values():
            pid.notify_listener(period)
        listener = self.on_state
        if listener is not None and is_state_due:
            listener(self.loops[0].make_state(time_ns, period))


@register("effort_controllers/JointEffortController", interface=EFFORT)
@register("position_controllers/JointPositionController", interface=POSITION)
@register("velocity_controllers/JointVelocityController", interface=VELOCITY)
class ForwardController(JointCommandController):
    """Forward a command to one joint: effort (N m, N), position (rad, m) or velocity (rad/s, m/s).

    Limits are applied by the hardware, not here.
    """


@register("effort_controllers/JointGroupEffortController", interface=EFFORT)
@register("position_controllers/JointGroupPositionController", interface=POSITION)
@register("velocity_controllers/JointGroupVelocityController", interface=VELOCITY)
class ForwardGroupController(ForwardController):
    """Forward a list of commands to several joints, in the order of the parameter `joints`."""

    command_kind = "float64_array"
