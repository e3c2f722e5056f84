"""The control cycle and the physics of a robot that moves alone: ticks in a row, in one call.

Everything of it is compiled where it belongs: loops in joint_loops.py, limits and drives in
drives.py, the step in joint_dynamics.py. Where Python takes part in a tick, ControlLoop and World
call the same ones, one by one.
"""

from math import isfinite

from aras_sim_bridge.control.controllers.joint_loops import follow
from aras_sim_bridge.control.drives import JOINT, KIND, OUTPUT, STRONGEST, TURNS_MOTOR, written
from aras_sim_bridge.control.joints import TAU, Q, V
from aras_sim_bridge.world.joint_dynamics import FORCE, NO_LIMIT_FORCE, STEP, TARGET, advance
from aras_sim_bridge.world.standing import STANDING, bears
from aras_visual_servo_base.compiled import compiled

CYCLE = "f8[:,::1], f8[:,::1], f8[:,::1]"
# How ticks in a row ended: all made; with something to tell; in one that diverged, or after which
# the ground could not bear the base; before one whose efforts are no numbers.
ALL_MADE, NEWS, DIVERGED, NOT_BORNE, NOT_FINITE = range(5)


@compiled("f8[:,::1], f8[:,::1], f8[:,::1]", allocates=False)
def _put_through(drives, state, joints):
    """Outputs of drives into efforts and motors; False, and nothing done, if one is no number."""
    for k in range(len(drives)):
        if not isfinite(drives[k, OUTPUT]):
            return False
    state[2] = 0.0
    for k in range(len(drives)):
        j, output = int(drives[k, JOINT]), drives[k, OUTPUT]
        if drives[k, KIND] == TURNS_MOTOR:
            joints[j, TARGET], joints[j, FORCE] = output, min(drives[k, STRONGEST], NO_LIMIT_FORCE)
        else:
            state[2, j] += output
    return True


@compiled(
    f"i8, i8, i8, {CYCLE}, {STEP}, b1, {STANDING}",
    allocates=False,
)
def cycles(count, time_ns, step_ns, loops, handles, drives,
           bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt,
           stands, before, ground, corners, touch, load):
    """Up to `count` ticks of `step_ns` from `time_ns` on, as far as nothing has to be told.

    Args:
        loops, handles, drives: rows of JointLoop, JointHandle and Drive.
        bodies … modes, dt: JointSpace.arrays, whose state (3, n) goes on; the physics' step, s.
        stands, before … load: whether a standing base is held, and StandingBase.arrays.

    Returns:
        Ticks made; how they ended; the joint that diverged.
    """
    period = step_ns / 1e9
    for made in range(1, count + 1):
        time_ns += step_ns
        for k in range(len(drives)):
            j = int(drives[k, JOINT])
            handles[k, Q], handles[k, V], handles[k, TAU] = state[0, j], state[1, j], state[2, j]
        follow(loops, handles, period)
        news = written(drives, handles, time_ns, period, False)
        if not _put_through(drives, state, joints):
            return made - 1, NOT_FINITE, -1
        bad = advance(bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints,
                      modes, dt)
        if bad >= 0:
            return made, DIVERGED, bad
        if stands and not bears(tree, frames, state, before, gravity, ground, corners, touch, load,
                                dt):
            return made, NOT_BORNE, -1
        if news:
            return made, NEWS, -1
    return count, ALL_MADE, -1
