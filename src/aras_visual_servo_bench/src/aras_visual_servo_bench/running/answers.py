"""The arm's control cycles and the loop's ticks between two images, joined in one compiled call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, nan
from typing import TYPE_CHECKING

import numpy as np

from aras_sim_bridge.control.controllers.joint_loops import taken_together
from aras_sim_bridge.control.joints import Q, V
from aras_sim_bridge.cycle import ALL_MADE, CYCLE, cycles
from aras_sim_bridge.world.joint_dynamics import STEP
from aras_sim_bridge.world.standing import STANDING
from aras_visual_servo_base.compiled import compiled
from aras_visual_servo_controller.loop.ticks import (
    COMMAND,
    ODD,
    SENT,
    SENT_ON,
    TICKED,
    Ticks,
    ticked,
)

from ..plants.base import seconds

if TYPE_CHECKING:
    from aras_sim_bridge.control.controllers.joint_state import JointStateController
    from aras_sim_bridge.simulation import ControlledModel
    from aras_visual_servo_controller.loop.driver import Driver

    from ..plants.base import JointListener


class ArmAnswers:
    """A loop's answers to an arm's joint states: see simulation.Answers."""

    def __init__(
        self,
        driver: Driver,
        listener: JointListener,
        robot: ControlledModel,
        sampler: str,
        joints: Sequence[str],
        send: Callable[[np.ndarray], None],
        last_ns: Callable[[], float],
    ) -> None:
        """Args:
            sampler: the controller of the joint states. joints: (n,) as they are commanded.
            send: takes commands (n,). last_ns: until when the run goes on, as known by then, ns.
        """
        self._listener, self._robot, self._send = listener, robot, send
        self._last_ns, self._sampler = last_ns, robot.manager.get(sampler)
        self._ticks = Ticks(driver) if driver.servo.arm.names == tuple(joints) else None
        handles = list(robot.hardware.handles)
        self._handles = np.array([handles.index(name) for name in joints])
        self._joints = {name: k for k, name in enumerate(joints)}

    def begin(self, time_ns: int, until_ns: int) -> JointStateController | None:
        """The joint states' controller while the loop does nothing but go after its task."""
        due = self._ticks is not None and -inf < self._sampler.idle_until(time_ns) < until_ns
        self._state = self._ticks.begin() if due else None
        return None if self._state is None else self._sampler

    def cycles(
        self, count: int, time_ns: int, step_ns: int, loops: np.ndarray, handles: np.ndarray,
        drives: np.ndarray, *physics: np.ndarray | float,
    ) -> tuple[int, int, int]:
        """As cycle.cycles."""
        due = self._sampler.due_in(time_ns + step_ns, time_ns + count * step_ns, step_ns)
        last_ns, n = self._last_ns(), len(self._handles)
        most = sum(instant <= last_ns for instant in due)
        stamps = np.array([seconds(instant) for instant in due])
        samples, commands = np.empty((most, 2, n)), np.empty((most, n))
        commanded = self._robot.loop.loops
        places = np.array([self._joints.get(loop.handle.name, -1) for loop in commanded])
        made, end, bad, answered, waits, beyond = _answering(
            count, time_ns, step_ns, loops, handles, drives, physics, np.array(due, np.int64),
            stamps, self._handles, places, samples, commands, *self._state,
        )  # fmt: skip
        self._sampler.sampled(answered)
        self._ticks.end(stamps[:answered], samples[:answered], commands[:answered])
        for k in range(answered):
            self._listener.commanded(commands[k])
            self._listener.joints(stamps.item(k), *samples[k])
        if waits:
            self._send(commands[answered - 1])
        if beyond:
            told = [commands.item(answered - 1, k) if k >= 0 else nan for k in places]
            self._robot.loop.told(told, time_ns + (made + 1) * step_ns)
        return made, end, bad


@compiled(
    f"i8, i8, i8, {CYCLE}, Tuple(({STEP}, b1, {STANDING})), i8[::1], f8[::1], i8[::1], i8[::1], "
    f"f8[:,:,::1], f8[:,::1], {TICKED}",
    calls=(cycles, taken_together, ticked),
)
def _answering(count, time_ns, step_ns, loops, handles, drives, physics, due, stamps, joints,
               places, samples, commands, chain, clock, rows, last, bounds, lead, settings,
               numbers, goal, L, rates, modelled, pulls, folds, limits, accelerates):
    """Cycles in which joint states are answered with commands.

    Args:
        count … drives: see `cycles`; physics: what follows there.
        due, stamps: (m,) cycles that sample the joints, ns and s.
        joints: (n,) their handles. places: (l,) the joint of each loop, -1: none.
        samples, commands: (a, 2, n), (a, n) of the first of them, which may be answered.
        chain … accelerates: see `ticked`.

    Returns:
        Ticks made; how they ended; the joint that diverged; joint states that were answered;
        whether the last command still waits; whether it was beyond a limit.
    """
    made, answered, end, bad = 0, 0, ALL_MADE, -1
    waits, beyond = False, False
    q, v, given = np.empty(len(joints)), np.empty(len(joints)), np.empty(len(loops))
    while made < count and not beyond:
        ticks = count - made
        if answered < len(due):
            ticks = min(ticks, (due[answered] - time_ns) // step_ns)
        done, end, bad = cycles(ticks, time_ns, step_ns, loops, handles, drives, *physics)
        made, time_ns, waits = made + done, time_ns + done * step_ns, False
        if end != ALL_MADE or answered == len(due) or time_ns < due[answered]:
            break
        for i in range(len(joints)):
            q[i], v[i] = handles[joints[i], Q], handles[joints[i], V]
        if answered == len(samples):
            break
        became = ticked(
            q, v, stamps[answered], chain, clock, rows, last, bounds, lead, settings, numbers, goal,
            L, rates, modelled, pulls, folds, limits, accelerates,
        )  # fmt: skip
        if became == ODD:
            break
        samples[answered, 0], samples[answered, 1], commands[answered] = q, v, rows[COMMAND]
        answered, waits = answered + 1, became == SENT_ON
        if waits and made < count:
            for k in range(len(loops)):
                given[k] = rows[SENT, places[k]] if places[k] >= 0 else np.nan
            beyond, waits = taken_together(loops, given, time_ns + step_ns), False
    return made, end, bad, answered, waits, beyond
