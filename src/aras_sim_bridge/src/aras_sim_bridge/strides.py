"""Physics steps in a row, each with its control cycle, in one compiled loop (see control/stride.py
for when nobody looks in between)."""

from __future__ import annotations

import numpy as np

from aras_sim_bridge.control import stride
from aras_sim_bridge.control.controllers.interpolation import ARRIVED, ROUNDING
from aras_sim_bridge.control.controllers.pid_loops import PLAIN_DIFFERENCE
from aras_sim_bridge.world import joint_dynamics, standing
from aras_visual_servo_base.compiled import compiled

cycle, advance, bears = stride.cycle, joint_dynamics.advance, standing.bears

_BOLTED = (np.zeros(11), np.zeros((1, 6)), np.zeros(6), np.zeros(6))


@compiled(
    f"i8, f8, f8[:,::1], f8, f8, f8, {joint_dynamics.STEP}, "
    "b1, f8[::1], f8[::1], f8[:,::1], f8[::1], f8[::1]",
    calls=(cycle, advance, bears),
)
def _steps(count, period, loops, arrived, rounding, plain,
           bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt,
           stands, before, ground, corners, touch, load):
    """Up to `count` steps, as far as cycles are ordinary, nothing diverges and the ground bears.

    Returns:
        Steps made; what the last one's `advance` said; whether the ground bore it.
    """
    for k in range(count):
        if not cycle(state, loops, period, arrived, rounding, plain):
            return k, -1, True
        bad = advance(bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints,
                      modes, dt)
        if bad >= 0:
            return k + 1, bad, True
        if stands and not bears(tree, frames, state, before, gravity, ground, corners, touch, load,
                                dt):
            return k + 1, -1, False
    return max(count, 0), -1, True


def make_steps(cycles: stride.Stride, count: int, period: float, joints: tuple[np.ndarray, ...],
               stands: tuple[np.ndarray, ...] | None, dt: float) -> tuple[int, bool]:
    """Up to `count` steps, counted in cycles.made.

    Args:
        cycles: begun; `rows` (m, 42) go on. period: of a cycle, s. dt: of a physics step, s.
        joints: JointSpace.arrays, whose state (3, n) goes on: rad or m, per s, N m or N.
        stands: StandingBase.arrays; None: the model is bolted down.

    Returns:
        -1, or the number of a joint that diverged; whether the ground could bear the last step.
    """
    before, *ground = (joints[2][1], *_BOLTED) if stands is None else (stands[3], *stands[5:])
    cycles.made, bad, borne = _steps(
        count, period, cycles.rows, ARRIVED, ROUNDING, PLAIN_DIFFERENCE, *joints, dt,
        stands is not None, before, *ground,
    )  # fmt: skip
    return bad, borne
