"""Control loop of gazebo_ros_control: read joints, update controllers, write commands."""

from itertools import chain
from math import inf, nan

import numpy as np

from aras_sim_bridge.control.controllers.base import Controller
from aras_sim_bridge.control.controllers.joint_control_loop import LOOP_COLUMNS, set_loop_commands
from aras_sim_bridge.control.controllers.joint_state import find_next_cycle
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.manager import ControllerManager
from aras_sim_bridge.control.switching import LoadedController
from aras_sim_bridge.errors import HardwareError

_NS_PER_S = 1e9


class ControlLoop:
    """Control loop of one robot, which runs hardware and controllers in simulated time.

    Controllers are updated when `control_period` has passed since the last update. Commands are
    written in every physics step. After the start and after reset(), the first period is one
    physics step.
    """

    def __init__(
        self, hardware: RobotHardware, manager: ControllerManager, step_ns: int,
        control_period_ns: int | None = None,
    ) -> None:
        """Set the periods. Raises HardwareError if a period is not positive."""
        self.hardware = hardware
        self.manager = manager
        self._step_ns = step_ns
        self._control_ns = step_ns if control_period_ns is None else control_period_ns
        if self._step_ns <= 0 or self._control_ns <= 0:
            raise HardwareError(
                f"control period {self._control_ns} ns and physics step {step_ns} ns must be "
                f"positive; check <controlPeriod>"
            )
        self._updated_ns: int | None = None
        self._written_ns: int | None = None
        self._loops = np.zeros((0, LOOP_COLUMNS))
        self._running: tuple[LoadedController, ...] | None = None

    def reset(self) -> None:
        """Reset the controllers, and make the next step read the joints and update the controllers.
        """
        self._updated_ns = self._written_ns = None
        self.manager.reset()

    def restart(self) -> None:
        """Restart at the current joint positions; the controllers keep only their set points."""
        self._updated_ns = self._written_ns = None
        self.hardware.start()
        self.manager.reset(restart=True)

    def step(self, time_ns: int) -> None:
        """Read the joints and update the controllers if due, and write the commands in any case.

        `time_ns` is the end of the next physics step.
        """
        updated_ns = self._updated_ns
        elapsed_ns = self._step_ns if updated_ns is None else time_ns - updated_ns
        if updated_ns is None or elapsed_ns >= self._control_ns:
            period = elapsed_ns / _NS_PER_S
            self.hardware.read()
            self.manager.update(time_ns, period)
            self._updated_ns = time_ns
        written_ns = self._written_ns
        elapsed_ns = self._step_ns if written_ns is None else time_ns - written_ns
        self.hardware.write(time_ns, elapsed_ns / _NS_PER_S)
        self._written_ns = time_ns

    def start_cycles(
        self, time_ns: int, step_ns: int, compiled_sampler: Controller | None = None
    ) -> tuple[np.ndarray, float] | None:
        """Prepare to run control cycles in compiled code, one in each step from `time_ns` on.

        Pending commands and gains are applied, unless the next cycle needs Python code.

        Args:
            step_ns: physics step, ns.
            compiled_sampler: controller that only reads the joints and whose samples the compiled
                code takes.

        Returns:
            The states (m, 39) of all running JointLoops, and the time, ns, up to which no cycle
            needs Python code. None if the next cycle needs Python code.
        """
        before = None, time_ns - step_ns
        in_step = self._updated_ns in before and self._written_ns in before
        if not in_step or step_ns < self._control_ns:
            return None
        if self.manager.running is not self._running:
            self._gather_loops(self.manager.running)
        if self.manager.is_busy or self.hardware.has_position_drives:
            return None
        for part in self._pids, self._compiled_controllers:
            for one in part:
                if one.on_state is not None:
                    return None
        idle_ns = inf
        for entry in self._other_entries:
            if entry.controller is compiled_sampler:
                continue
            until_ns = entry.controller.idle_until(time_ns)
            if until_ns < time_ns:
                if not entry.controller.is_read_only:
                    return None
                until_ns = time_ns
            elif entry.controller.is_read_only and until_ns < inf:
                until_ns = find_next_cycle(until_ns, time_ns, step_ns)
            idle_ns = min(idle_ns, until_ns)
        for pid in self._pids:
            if pid.has_new_gains:
                pid.apply_gains()
        for controller in self._compiled_controllers:
            if controller.slot:
                self._apply_pending_commands(time_ns)
                break
        return self._loops, idle_ns

    @property
    def joint_names(self) -> list[str]:
        """Joint name of each row that `start_cycles` returns."""
        return [loop.handle.name for c in self._compiled_controllers for loop in c.loops]

    def _apply_pending_commands(self, time_ns: int) -> None:
        """Apply the pending commands of all controllers whose loops compiled code can run."""
        given = [
            c.slot.pop() if c.slot else [nan] * len(c.loops) for c in self._compiled_controllers
        ]
        self.set_commands(np.array(list(chain(*given))), time_ns)

    def set_commands(self, commands: np.ndarray, time_ns: int) -> None:
        """Set the commands (m,) of all loops in the cycle at `time_ns`; NaN means no command."""
        if set_loop_commands(self._loops, commands, time_ns):
            self.warn_beyond_limits(commands, time_ns)

    def warn_beyond_limits(self, commands: np.ndarray, time_ns: int) -> None:
        """Log the commands (m,) of the cycle at `time_ns` that are beyond the limits of a joint."""
        loops = chain.from_iterable(c.loops for c in self._compiled_controllers)
        for loop, command in zip(loops, commands.tolist(), strict=True):
            if command == command:
                loop.warn_beyond_limits(command, time_ns)

    def _gather_loops(self, running: tuple[LoadedController, ...]) -> None:
        """Store the states of all running loops in one array, for control cycles in compiled code.
        """
        self._running = running
        self._other_entries = [entry for entry in running if not entry.controller.is_compilable]
        self._compiled_controllers = [e.controller for e in running if e.controller.is_compilable]
        self._pids = list(self.hardware.pids.values())
        self._loops = np.zeros(
            (sum(len(one.rows) for one in self._compiled_controllers), LOOP_COLUMNS)
        )
        first = 0
        for controller in self._compiled_controllers:
            self._pids += controller.pids.values()
            controller.bind(self._loops[first : first + len(controller.rows)])
            first += len(controller.rows)

    def end_cycles(self, time_ns: int) -> None:
        """Finish control cycles that ran in compiled code, the last of them at `time_ns`.

        Controllers that only read the joints publish a sample of the last cycle if one is due.
        """
        for entry in self._other_entries:
            controller = entry.controller
            if controller.is_read_only and controller.idle_until(time_ns) < time_ns:
                self.manager.run(entry, time_ns, self._step_ns / _NS_PER_S)
        self._updated_ns = self._written_ns = time_ns
