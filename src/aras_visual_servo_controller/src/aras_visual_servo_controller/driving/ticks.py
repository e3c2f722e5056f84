"""The loop's ticks between two images, compiled: joint states in, commands out.

What Driver.joints does with one joint state after another while the arm servoes and nothing is out
of the ordinary: the same compiled functions, without the objects between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import compiled

from ..arm.algebra import finite
from ..arm.arm import Arm, implausible
from ..arm.inversion import LASTING, resolved
from ..arm.joint_sample import JointSample
from ..arm.kinematics import CHAIN
from ..arm.resolver import Resolver
from ..loop.motion import advanced, jumped
from ..loop.task_follower import ROUNDING

if TYPE_CHECKING:
    from .driver import Driver

# Of `clock`: the last tick, the latest joint state, when the velocities were worked out and for how
# long at least, when something was sent, s; which of the two tasks is pursued.
NOW, NEWEST, KEPT_AT, KEPT_FOR, SENT_AT, TASK = range(6)
# Of `rows`, (n,) each: command and its velocity, velocities that are kept, what was sent last;
# positions and velocities of the latest joint state; whether a limit stopped a joint.
COMMAND, VELOCITY, KEPT, SENT, Q, V, STOPPED = range(7)
# Of `settings`: see ServoSettings; when the last image was answered and for how long that is fresh,
# s; when the second task is taken up, and when a third would be.
LONGEST, WATCHDOG, LAG, PERIOD, ANSWERED, PATIENCE, SECOND, THIRD = range(8)
# What became of a joint state: not taken, as Python has to look at it; nothing new to send; sent.
ODD, NOTHING_NEW, SENT_ON = range(3)
TICKED = (
    f"Tuple(({CHAIN})), f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[::1], "
    "f8[:,:], f8[:,:,::1], f8[:,::1], b1[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], b1"
)


@compiled(f"f8[:], f8[:], f8, {TICKED}")
def ticked(q, v, stamp, chain, clock, rows, last, bounds, lead, settings, numbers, goal, L, rates,
           modelled, pulls, folds, limits, accelerates):
    """One joint state and the tick it brings; where it is ODD, Python begins with it anew.

    Args:
        q, v, stamp: (n,), (n,) and s of the joint state. chain: see Chain.
        clock, rows, settings: see above. last, numbers, goal, pulls, folds, limits: of
            `resolved`. bounds: (3, n) of plausible joint states. lead: (n,).
        L, rates, modelled: (2, k, 6), (2, k), (2, 6) of the task, and of the one after it.
        accelerates: whether there are limits of acceleration.
    """
    t = max(stamp, clock[NOW])
    gone, dt = stamp - clock[NEWEST], min(t - clock[NOW], settings[LONGEST])
    if not dt > 0.0 or gone > settings[WATCHDOG]:
        return ODD
    if t - settings[ANSWERED] > settings[PATIENCE] or settings[THIRD] <= t + ROUNDING:
        return ODD
    if implausible(q, v, bounds[0], bounds[1], bounds[2])[0] >= 0:
        return ODD
    if jumped(q, rows[Q], v, rows[V], lead, gone):
        return ODD
    task, period = 1 if settings[SECOND] <= t + ROUNDING else 0, settings[PERIOD]
    lasts = max(clock[KEPT_FOR], period) - 1e-9
    if task != clock[TASK] or not t - clock[KEPT_AT] < lasts:
        found = resolved(
            *chain, q, np.empty((4, 4)), np.empty((6, len(q))), goal, L[task], rates[task],
            modelled[task], np.zeros(len(q)), pulls, folds, limits, max(dt, period), accelerates,
            rows[VELOCITY], last, numbers,
        )  # fmt: skip
        if not finite(found[0], found[0], found[0]):
            return ODD
        velocities, primary = found[0], found[1]
        for i in range(len(q)):
            rows[KEPT, i], last[0, i], last[1, i] = velocities[i], velocities[i], primary[i]
        clock[KEPT_AT], clock[KEPT_FOR], clock[TASK] = t, LASTING if found[10] else 0.0, task
    after, speeds, stopped, late = advanced(
        rows[COMMAND], rows[VELOCITY], rows[KEPT], q, limits[0], limits[1], lead, settings[LAG], dt
    )
    if late.any() or not finite(after, after, after):
        return ODD
    clock[NOW] = clock[NEWEST] = stamp
    same = True
    for i in range(len(q)):
        rows[COMMAND, i], rows[VELOCITY, i], rows[STOPPED, i] = after[i], speeds[i], stopped[i]
        rows[Q, i], rows[V, i] = q[i], v[i]
        same &= rows[SENT, i] == after[i]
    if same:
        return NOTHING_NEW
    for i in range(len(q)):
        rows[SENT, i] = after[i]
    clock[SENT_AT] = t
    return SENT_ON


class Ticks:
    """A driver's state as `ticked` takes it, and back."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        servo, resolver = driver.servo, driver.servo.resolver
        arm, settings = servo.arm, servo.settings
        # A resolver, tasks or an arm of somebody's own are asked in Python.
        self._possible = (
            type(arm) is Arm and type(resolver) is Resolver and not resolver.others
            and settings.output == "position"
            and not (driver.settings.lockstep or driver.settings.dry)
        )  # fmt: skip
        if self._possible:
            self._fixed = (resolver.pulls, resolver.fold_rows, resolver.limit_rows,
                           resolver.accelerates)  # fmt: skip

    def begin(self) -> tuple[np.ndarray | tuple | bool, ...] | None:
        """Arguments of `ticked` from `chain` on; None where the next tick is not one of them."""
        driver = self._driver
        servo, newest = driver.servo, driver.history.newest
        pursuit, motion, resolver = servo.pursuit, servo.motion, servo.resolver
        task, pending = pursuit.task, pursuit.pending
        if (
            not self._possible or newest is None or task is None or pursuit.controlled
            or not servo.goes_on or driver.sent is None
            or resolver.goal is None or "resolve" in vars(resolver)
        ):  # fmt: skip
            return None
        following = pending[0][1] if pending else task
        if following.L.shape != task.L.shape:
            return None
        settings = servo.settings
        kept = pursuit.kept or (-inf, np.zeros(len(motion.names)), 0.0, "")
        self._clock = np.array([driver.time, newest.stamp, kept[0], kept[2], -inf, 0.0])
        self._rows = np.array([
            motion.command, motion.velocity, kept[1], driver.sent, newest.positions,
            newest.velocities, np.zeros(len(motion.names)),
        ])  # fmt: skip
        due = [pending[k][0] if len(pending) > k else inf for k in range(2)]
        numbers = np.array([
            settings.longest_step, settings.watchdog, settings.lag, settings.resolve_period,
            *servo.answered, *due,
        ])  # fmt: skip
        both = task, following
        return (
            tuple(servo.arm.chain), self._clock, self._rows, resolver.last,
            servo.arm.plausible, motion.lead, numbers, resolver.numbers,
            resolver.goal, np.array([t.L for t in both]), np.array([t.rate for t in both]),
            np.array([t.modelled for t in both]), *self._fixed,
        )  # fmt: skip

    @property
    def command(self) -> np.ndarray:
        """(n,) where the command stands."""
        return self._rows[COMMAND]

    def end(self, stamps: Sequence[float], samples: np.ndarray, commands: np.ndarray) -> None:
        """Take back what `ticked` made of the first joint states (m, 2, n), at stamps in s:
        commands (m, n)."""
        driver, clock, rows = self._driver, self._clock, self._rows
        servo = driver.servo
        pursuit, names = servo.pursuit, servo.arm.names
        if clock[TASK]:
            pursuit.task = pursuit.pending.popleft()[1]
        pursuit.kept = clock.item(KEPT_AT), rows[KEPT], clock.item(KEPT_FOR), ""
        if not stamps:
            return
        for array in (samples, commands):
            array.setflags(write=False)
        taken = [
            JointSample(stamp, names, *sample)
            for stamp, sample in zip(stamps, samples, strict=False)
        ]
        servo.motion.go_on(rows[COMMAND], rows[VELOCITY])
        servo.ticked(taken[-1], servo.motion.stopped_words(np.flatnonzero(rows[STOPPED])))
        driver.ticked(taken, commands, rows[SENT], clock.item(SENT_AT))
