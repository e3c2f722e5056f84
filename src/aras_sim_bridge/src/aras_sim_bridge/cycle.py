"""The control cycle and the physics of a robot that moves alone: ticks in a row, in one call.

Everything of it is compiled where it belongs: loops in joint_loops.py, limits and drives in
drives.py, the step in joint_dynamics.py. Where Python takes part in a tick, ControlLoop and World
call the same ones, one by one.
"""

from math import isfinite

from aras_sim_bridge.control.controllers.joint_loops import update_loops
from aras_sim_bridge.control.drives import (
    JOINT,
    KIND,
    MAX_EFFORT,
    OUTPUT,
    TURNS_MOTOR,
    compute_outputs,
)
from aras_sim_bridge.control.joints import TAU, Q, V
from aras_sim_bridge.world.joint_dynamics import FORCE, NO_LIMIT_FORCE, STEP_TYPES, TARGET, advance
from aras_sim_bridge.world.resting_base import BASE_TYPES, is_supported
from aras_visual_servo_base.compiled import jit

CYCLE_TYPES = "f8[:,::1], f8[:,::1], f8[:,::1]"
# How ticks in a row ended: all made; with something to tell; in one that diverged, or after which
# the ground could not bear the base; before one whose efforts are no numbers.
ALL_MADE, WARNING, DIVERGED, BASE_UNSUPPORTED, NOT_FINITE = range(5)


@jit("f8[:,::1], f8[:,::1], f8[:,::1]", allocates=False)
def _apply_outputs(drives, state, joints):
    """Outputs of drives into efforts and motors; False, and nothing done, if one is no number."""
    for k in range(len(drives)):
        if not isfinite(drives[k, OUTPUT]):
            return False
    state[2] = 0.0
    for k in range(len(drives)):
        j, output = int(drives[k, JOINT]), drives[k, OUTPUT]
        if drives[k, KIND] == TURNS_MOTOR:
            joints[j, TARGET], joints[j, FORCE] = output, min(drives[k, MAX_EFFORT], NO_LIMIT_FORCE)
        else:
            state[2, j] += output
    return True


@jit(
    f"i8, i8, i8, {CYCLE_TYPES}, {STEP_TYPES}, b1, {BASE_TYPES}",
    allocates=False,
)
def run_cycles(count, time_ns, step_ns, loops, handles, drives,
           bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt,
           is_base_resting, previous_speeds, ground, corners, contact_wrench, ground_wrench):
    """Up to `count` ticks of `step_ns` from `time_ns` on, as far as nothing has to be told.

    Args:
        loops, handles, drives: rows of JointLoop, JointHandle and Drive.
        bodies … modes, dt: JointSpace.arrays, whose state (3, n) goes on; the physics' step, s.
        stands, before … load: whether a standing base is held, and RestingBase.arrays.

    Returns:
        Ticks made; how they ended; the joint that diverged.
    """
    period = step_ns / 1e9
    for made in range(1, count + 1):
        time_ns += step_ns
        for k in range(len(drives)):
            j = int(drives[k, JOINT])
            handles[k, Q], handles[k, V], handles[k, TAU] = state[0, j], state[1, j], state[2, j]
        update_loops(loops, handles, period)
        news = compute_outputs(drives, handles, time_ns, period, False)
        if not _apply_outputs(drives, state, joints):
            return made - 1, NOT_FINITE, -1
        bad = advance(bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints,
                      modes, dt)
        if bad >= 0:
            return made, DIVERGED, bad
        if is_base_resting and not is_supported(
            tree,
            frames,
            state,
            previous_speeds,
            gravity,
            ground,
            corners,
            contact_wrench,
            ground_wrench,
            dt,
        ):
            return made, BASE_UNSUPPORTED, -1
        if news:
            return made, WARNING, -1
    return count, ALL_MADE, -1
