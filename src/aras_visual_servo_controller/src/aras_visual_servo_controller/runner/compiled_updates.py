"""Compiled updates of the loop between two images, from joint states to commands.

They replace LoopRunner.add_joint_state for successive joint states while the arm servoes, until a
joint state is implausible or late, or a joint does not follow its command. Both use the same
compiled functions, but the compiled updates create no Python objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..kinematics.algebra import are_finite
from ..kinematics.arm import find_implausible_joint
from ..kinematics.chain import CHAIN_SIGNATURE
from ..kinematics.compiled_ik import PRIMARY, REUSE_TIME, VELOCITIES, solve_velocities
from ..kinematics.differential_ik import DifferentialIK
from ..kinematics.joint_sample import JointSample
from ..loop.command_integrator import has_jumped, integrate_command
from ..loop.task_executor import ROUNDING

if TYPE_CHECKING:
    from .loop_runner import LoopRunner

# Indices of the array `clock`: time of the last update, time of the latest joint state, time at
# which the present velocities were computed, duration for which they are valid, time of the last
# command, all in s; and the index of the present task, 0 or 1.
NOW, NEWEST, SOLVED_AT, VALID_FOR, SENT_AT, TASK = range(6)
# Indices of the array `rows` with values for each joint (n,): commanded positions, commanded
# velocities, present solution, values that were sent last (positions or velocities), positions and
# velocities of the latest joint state, whether a limit stopped the joint.
COMMAND, VELOCITY, SOLUTION, SENT_VALUES, Q, V, STOPPED = range(7)
# index of the row of `rows` whose values are sent, for each value of the setting `output`
SENT_ROWS = {"position": COMMAND, "velocity": VELOCITY}
# Indices of the array `settings` of `process_joint_state`.
(
    LONGEST_STEP,  # the entries LONGEST_STEP to SOLVE_PERIOD are values of ServoSettings
    WATCHDOG,
    LAG,
    SOLVE_PERIOD,
    ANSWER_TIME,  # time of the last processed image, s
    ANSWER_LIFETIME,  # time for which the task of the last processed image may be executed, s
    SECOND_TASK_TIME,  # time at which the task after the present one starts, s
    # time at which the task after the second one starts, s; compiled code knows only two tasks, so
    # from then on Python processes the joint states
    THIRD_TASK_TIME,
    SENT_ROW,  # index of the row of the array `rows` whose values are sent as the command
) = range(9)
NEEDS_PYTHON = 0  # result of an update: Python has to process the joint state
SAME_COMMAND = 1  # result of an update: the command has not changed
NEW_COMMAND = 2  # result of an update: there is a new command
# Numba type of the tuple `loop` of `process_joint_state`, and the index of its array `rows`.
LOOP_TYPE = (
    f"Tuple((Tuple(({CHAIN_SIGNATURE})), f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], "
    "f8[::1], f8[::1], f8[:,::1], f8[:,:,::1], f8[:,::1], b1[:,::1], f8[:,:,::1], f8[:,::1], "
    "f8[:,::1], b1))"
)
LOOP_ROWS = 2


@jit(f"f8[:], f8[:], f8, {LOOP_TYPE}")
def process_joint_state(q, v, stamp, loop):
    """Process one joint state and compute the command.

    Args:
        q, v: (n,) positions, rad or m, and velocities, rad/s or m/s, of the joint state.
        stamp: stamp of the joint state, s.
        loop: tuple made by `LoopStateConverter.make_loop`, whose arrays are modified: chain: fields
            of the Chain. clock, rows: arrays, whose indices are constants of this module.
            last_velocities: see `last` of `solve_velocities`. bounds: (3, n) see
            `Arm.plausible_bounds`. lead: (n,) distance by which a command may be ahead of its
            joint, rad or m. settings: array, whose indices are constants of this module.
            setting_values, goal: see `settings` and `goal` of `solve_velocities`. L, desired_rates,
            modelled: (2, k, 6), (2, k), (2, 6) fields of two tasks: the present one and the next
            one. range_tasks, elbows, limits: see `solve_velocities`. has_acceleration_limits:
            whether accelerations are limited.

    Returns:
        NEW_COMMAND or SAME_COMMAND; NEEDS_PYTHON if Python has to process the joint state.
    """
    (
        chain, clock, rows, last_velocities, bounds, lead, settings, setting_values, goal, L,
        desired_rates, modelled, range_tasks, elbows, limits, has_acceleration_limits,
    ) = loop  # fmt: skip
    t = max(stamp, clock[NOW])
    elapsed, dt = stamp - clock[NEWEST], min(t - clock[NOW], settings[LONGEST_STEP])
    if not dt > 0.0 or elapsed > settings[WATCHDOG]:
        return NEEDS_PYTHON
    if (
        t - settings[ANSWER_TIME] > settings[ANSWER_LIFETIME]
        or settings[THIRD_TASK_TIME] <= t + ROUNDING
    ):
        return NEEDS_PYTHON
    if find_implausible_joint(q, v, bounds[0], bounds[1], bounds[2])[0] >= 0:
        return NEEDS_PYTHON
    if has_jumped(q, rows[Q], v, rows[V], lead, elapsed):
        return NEEDS_PYTHON
    task, period = 1 if settings[SECOND_TASK_TIME] <= t + ROUNDING else 0, settings[SOLVE_PERIOD]
    valid_for = max(clock[VALID_FOR], period) - 1e-9
    if task != clock[TASK] or not t - clock[SOLVED_AT] < valid_for:
        joints = np.empty((4, len(q)))
        found = solve_velocities(
            *chain, q, np.empty((4, 4)), np.empty((6, len(q))), goal, L[task], desired_rates[task],
            modelled[task], np.zeros(len(q)), range_tasks, elbows, limits, max(dt, period),
            has_acceleration_limits,
            rows[VELOCITY], last_velocities, setting_values, joints, np.empty((3, 6)),
        )  # fmt: skip
        if not are_finite(joints[VELOCITIES]):
            return NEEDS_PYTHON
        for i in range(len(q)):
            rows[SOLUTION, i] = last_velocities[0, i] = joints[VELOCITIES, i]
            last_velocities[1, i] = joints[PRIMARY, i]
        reuse_time = REUSE_TIME if found[4] else 0.0
        clock[SOLVED_AT], clock[VALID_FOR], clock[TASK] = t, reuse_time, task
    after, speeds, stopped, late = integrate_command(
        rows[COMMAND], rows[VELOCITY], rows[SOLUTION], q, limits[0], limits[1], lead, settings[LAG],
        dt,
    )  # fmt: skip
    if late.any() or not are_finite(after):
        return NEEDS_PYTHON
    clock[NOW] = clock[NEWEST] = stamp
    sent_row, same = int(settings[SENT_ROW]), True
    for i in range(len(q)):
        rows[COMMAND, i], rows[VELOCITY, i], rows[STOPPED, i] = after[i], speeds[i], stopped[i]
        rows[Q, i], rows[V, i] = q[i], v[i]
        same &= rows[SENT_VALUES, i] == rows[sent_row, i]
    if same and sent_row == COMMAND:
        # An unchanged position is not sent again, because the controller holds it. Velocities are
        # sent at each update.
        return SAME_COMMAND
    for i in range(len(q)):
        rows[SENT_VALUES, i] = rows[sent_row, i]
    clock[SENT_AT] = t
    return NEW_COMMAND


class LoopStateConverter:
    """Conversion of a runner's state to the tuple `loop` of `process_joint_state`, and back."""

    def __init__(self, runner: LoopRunner, outputs: Sequence[str] = ("position",)) -> None:
        """Prepare the updates.

        Args:
            outputs: outputs (position, velocity) for which the caller of the compiled updates can
                send the commands; for other outputs, `make_loop` returns None.
        """
        self._runner = runner
        servo, ik = runner.servo, runner.servo.differential_ik
        arm, settings = servo.arm, servo.settings
        # User-defined inverse kinematics, secondary tasks and arms are Python code, which compiled
        # code cannot call.
        self._is_possible = (
            getattr(arm, "is_compiled", False) and type(ik) is DifferentialIK
            and not ik.other_tasks
            and settings.output in outputs
            and not (runner.settings.lockstep or runner.settings.dry)
        )  # fmt: skip
        if self._is_possible:
            self._chain = tuple(arm.chain)
            self._constant_arguments = (
                ik.range_tasks, ik.elbow_rows, ik.limit_rows, ik.has_acceleration_limits,
            )  # fmt: skip

    def make_loop(self) -> tuple[np.ndarray | tuple | bool, ...] | None:
        """Return the tuple `loop` of `process_joint_state`.

        Return None if Python has to process the next joint state.
        """
        runner = self._runner
        servo, newest = runner.servo, runner.history.newest_stamp
        executor, integrator, ik = servo.executor, servo.integrator, servo.differential_ik
        task, pending = executor.task, executor.pending_tasks
        if (
            not self._is_possible or newest is None or task is None or executor.is_joint_controlled
            or not servo.is_only_executing or runner.sender.values is None
            or ik.goal is None or "solve" in vars(ik)
        ):  # fmt: skip
            return None
        following = pending[0][1] if pending else task
        if following.L.shape != task.L.shape:
            return None
        settings = servo.settings
        cached = executor.cached_velocities or (-inf, 0.0, 0.0, "")
        self._clock = np.array([runner.update_time, newest, cached[0], cached[2], -inf, 0.0])
        self._rows = rows = np.zeros((STOPPED + 1, len(integrator.names)))
        rows[COMMAND], rows[VELOCITY] = integrator.command, integrator.velocity
        rows[SOLUTION], rows[SENT_VALUES] = cached[1], runner.sender.values
        rows[Q : V + 1] = runner.history.newest_row
        due = pending[0][0] if pending else inf, pending[1][0] if len(pending) > 1 else inf
        numbers = np.array([
            settings.longest_step, settings.watchdog, settings.lag, settings.resolve_period,
            *servo.answer_timing, *due, SENT_ROWS[settings.output],
        ])  # fmt: skip
        return (
            self._chain, self._clock, rows, ik.last_velocities,
            servo.arm.plausible_bounds, integrator.lead, numbers, ik.setting_values,
            np.array(ik.goal), np.array((task.L, following.L)),
            np.array((task.desired_rate, following.desired_rate)),
            np.array((task.modelled, following.modelled)), *self._constant_arguments,
        )  # fmt: skip

    @property
    def command(self) -> np.ndarray:
        """Values (n,) of the command that was sent last."""
        return self._rows[SENT_VALUES]

    def apply_results(self, stamps: Sequence[float], samples: np.ndarray) -> None:
        """Apply the results of `process_joint_state` to the runner.

        Args:
            stamps: (m,) stamps of the processed joint states, s.
            samples: (m, 3, n) their positions and velocities, and the resulting commands.
        """
        runner, clock, rows = self._runner, self._clock, self._rows
        servo = runner.servo
        executor, integrator = servo.executor, servo.integrator
        if clock[TASK]:
            executor.task = executor.pending_tasks.popleft()[1]
        executor.cached_velocities = (
            clock.item(SOLVED_AT), rows[SOLUTION], clock.item(VALID_FOR), "",
        )  # fmt: skip
        if not len(stamps):
            return
        samples.setflags(write=False)
        integrator.set_command(rows[COMMAND], rows[VELOCITY])
        stopped = rows[STOPPED]
        servo.apply_updates(
            JointSample(stamps[-1], servo.arm.names, samples[-1, 0], samples[-1, 1]),
            integrator.describe_stops(np.flatnonzero(stopped)) if any(stopped.tolist()) else "",
        )
        runner.apply_updates(stamps, samples, rows[SENT_VALUES], clock.item(SENT_AT))
