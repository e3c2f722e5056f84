"""Compiled function for many control cycles and physics steps of one robot without contacts.

The compiled parts are the joint loops (joint_control_loop.py), limits and drives (drives.py) and
the joint dynamics (joint_dynamics.py). When a cycle needs Python code, ControlLoop and World call
the same compiled functions one at a time.
"""

from math import isfinite

from aras_sim_bridge.control.controllers.joint_control_loop import update_loops
from aras_sim_bridge.control.drives import (
    JOINT,
    KIND,
    MAX_EFFORT,
    OUTPUT,
    TURNS_MOTOR,
    compute_outputs,
)
from aras_sim_bridge.control.joints import TAU, Q, V
from aras_sim_bridge.world.ground_support import BASE_TYPES, is_supported
from aras_sim_bridge.world.joint_dynamics import FORCE, NO_LIMIT_FORCE, STEP_TYPES, TARGET, advance
from aras_visual_servo_base.compiled import jit

CYCLE_TYPES = "f8[:,::1], f8[:,::1], f8[:,::1]"
# Numba types of the arguments of run_cycles that follow `drives`.
PHYSICS_TYPES = f"{STEP_TYPES}, b1, {BASE_TYPES}"
# Reasons why run_cycles returns:
ALL_MADE = 0  # all requested cycles are done
WARNING = 1  # a drive or controller produced a warning in the last cycle
DIVERGED = 2  # the motion of a joint diverged in the last cycle
BASE_UNSUPPORTED = 3  # the ground can no longer support a resting base after the last cycle
NOT_FINITE = 4  # a commanded effort of the next cycle is not finite


@jit("f8[:,::1], f8[:,::1], f8[:,::1]", allocates=False)
def _apply_outputs(drives, state, joints):
    """Copy the outputs of the drives to the efforts and motor targets of the joints.

    `state` and `joints` are elements of FixedBaseDynamics.arrays. Return False, without a change,
    if an output is not finite.
    """
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
    f"i8, i8, i8, {CYCLE_TYPES}, {PHYSICS_TYPES}",
    allocates=False,
)
def run_cycles(count, time_ns, step_ns, loops, handles, drives,
           bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt,
           is_base_resting, previous_speeds, ground, corners, contact_wrench, ground_wrench):
    """Run up to `count` control cycles of `step_ns` each, starting at `time_ns`.

    The function returns early if Python code has to act, for example to log a warning.

    Args:
        loops, handles, drives: arrays (number, columns) with one row for each JointControlLoop,
            JointHandle and Drive.
        bodies to modes: the elements of FixedBaseDynamics.arrays, in this order. `state` (3, n)
            holds the joint positions, velocities and efforts and is updated in place.
        dt: physics step, s.
        is_base_resting: whether the base rests on the ground without being fixed.
        previous_speeds to ground_wrench: the elements of RestingBase.arrays, in this order.

    Returns:
        Number of cycles done; reason for returning, such as ALL_MADE or DIVERGED; and index of the
        joint that diverged, or -1.
    """
    period = step_ns / 1e9
    for made in range(1, count + 1):
        time_ns += step_ns
        for k in range(len(drives)):
            j = int(drives[k, JOINT])
            handles[k, Q], handles[k, V], handles[k, TAU] = state[0, j], state[1, j], state[2, j]
        update_loops(loops, handles, period)
        has_warning = compute_outputs(drives, handles, time_ns, period, False)
        if not _apply_outputs(drives, state, joints):
            return made - 1, NOT_FINITE, -1
        diverged = advance(bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints,
                           modes, dt)
        if diverged >= 0:
            return made, DIVERGED, diverged
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
        if has_warning:
            return made, WARNING, -1
    return count, ALL_MADE, -1
