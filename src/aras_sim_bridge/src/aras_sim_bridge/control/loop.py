"""gazebo_ros_control's part of a physics step: read, update controllers, write."""

from itertools import chain
from math import inf, nan

import numpy as np

from aras_sim_bridge.control.controllers.base import Controller
from aras_sim_bridge.control.controllers.joint_loops import LOOP_COLUMNS, taken_together
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.manager import ControllerManager
from aras_sim_bridge.control.switching import Entry
from aras_sim_bridge.errors import HardwareError

_NS_PER_S = 1e9


class ControlLoop:
    """Runs hardware and controllers at their periods of simulated time.

    Controllers are updated whenever `control_period` passed since the last update; commands are
    written every physics step. The first period, also the first after reset(), is one step.
    """

    __slots__ = ("hardware", "manager", "_step_ns", "_control_ns", "_updated_ns", "_written_ns",
                 "_loops", "_running",
                 "_commanded", "_others", "_pids")

    def __init__(
        self, hardware: RobotHardware, manager: ControllerManager, step_ns: int,
        control_period_ns: int | None = None,
    ) -> None:
        """Raises HardwareError if a period is not positive."""
        self.hardware = hardware
        self.manager = manager
        self._step_ns = step_ns
        self._control_ns = step_ns if control_period_ns is None else control_period_ns
        if self._step_ns <= 0 or self._control_ns <= 0:
            raise HardwareError(
                f"control period {self._control_ns} ns and physics step {step_ns} ns must be "
                f"positive; look at <controlPeriod>"
            )
        self._updated_ns: int | None = None
        self._written_ns: int | None = None
        self._loops = np.zeros((0, LOOP_COLUMNS))
        self._running: tuple[Entry, ...] | None = None

    def reset(self) -> None:
        """Start over with the periods: the next step reads, updates and writes."""
        self._updated_ns = self._written_ns = None
        self.manager.reset()

    def begin_anew(self) -> None:
        """Begin anew, with the joints where they are now: set points stay, nothing else does."""
        self._updated_ns = self._written_ns = None
        self.hardware.start()
        self.manager.reset(anew=True)

    def step(self, time_ns: int) -> None:
        """What is due at `time_ns`, the simulated time the coming physics step ends at."""
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

    def begin(
        self, time_ns: int, step_ns: int, sampled: Controller | None = None
    ) -> tuple[np.ndarray, float] | None:
        """Take commands and gains for compiled cycles from `time_ns` on, a physics step of
        `step_ns` each; None, and nothing taken, where Python takes part in the next one. What the
        controller `sampled` looks at is looked at in those cycles.

        Returns:
            Rows (m, 39) of the loops that run; the last cycle, ns, that may be among them.
        """
        before = None, time_ns - step_ns
        in_step = self._updated_ns in before and self._written_ns in before
        if not in_step or step_ns < self._control_ns:
            return None
        if self.manager.running is not self._running:
            self._gather(self.manager.running)
        if self.manager.busy or self.hardware.sets_positions:
            return None
        for part in self._pids, self._commanded:
            for one in part:
                if one.on_state is not None:
                    return None
        idle_ns = inf
        for entry in self._others:
            until_ns = entry.controller.idle_until(time_ns)
            if entry.controller is sampled and until_ns > -inf:
                continue
            if until_ns < time_ns:
                if not entry.controller.looks:
                    return None
                until_ns = time_ns
            elif entry.controller.looks and until_ns < inf:
                until_ns = time_ns + (int(until_ns - time_ns) // step_ns + 1) * step_ns
            idle_ns = min(idle_ns, until_ns)
        for pid in self._pids:
            pid.take_gains()
        for controller in self._commanded:
            if controller.slot:
                self._take(time_ns)
                break
        return self._loops, idle_ns

    @property
    def joints(self) -> list[str]:
        """Of the rows that `begin` answers."""
        return [loop.handle.name for c in self._commanded for loop in c.loops]

    def _take(self, time_ns: int) -> None:
        """Let all loops take the commands that wait, as CommandedController.take one by one."""
        given = [c.slot.pop() if c.slot else [nan] * len(c.loops) for c in self._commanded]
        self.take(np.array(list(chain(*given))), time_ns)

    def take(self, commands: np.ndarray, time_ns: int) -> None:
        """Let all loops take commands (m,), in the cycle at `time_ns`; NaN: there is none."""
        if taken_together(self._loops, commands, time_ns):
            loops = chain.from_iterable(c.loops for c in self._commanded)
            for loop, command in zip(loops, commands.tolist(), strict=True):
                if command == command:
                    loop.told(command, time_ns)

    def _gather(self, running: tuple[Entry, ...]) -> None:
        """Put the rows of all loops that run into one array."""
        self._running = running
        self._others = [entry for entry in running if not entry.controller.compiled]
        self._commanded = [e.controller for e in running if e.controller.compiled]
        self._pids = list(self.hardware.pids.values())
        self._loops = np.zeros((sum(len(one.rows) for one in self._commanded), LOOP_COLUMNS))
        first = 0
        for controller in self._commanded:
            self._pids += controller.pids.values()
            controller.bind(self._loops[first : first + len(controller.rows)])
            first += len(controller.rows)

    def end(self, time_ns: int) -> None:
        """Compiled cycles are over; the last one was at `time_ns`. What they measured is still in
        the handles: controllers that look and command nothing do so now."""
        for entry in self._others:
            controller = entry.controller
            if controller.looks and controller.idle_until(time_ns) < time_ns:
                self.manager.run(entry, time_ns, self._step_ns / _NS_PER_S)
        self._updated_ns = self._written_ns = time_ns
