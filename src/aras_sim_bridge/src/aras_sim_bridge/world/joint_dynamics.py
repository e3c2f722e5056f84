"""Compiled time step of a kinematic tree with a fixed base, in joint space.

A step of the length dt uses the semi-implicit Euler method for the positions q and velocities v;
damping, springs, friction and stops are implicit:

    (M + dt D + dt² K) v+ = M v + dt (effort - bias - K (q - q0)) - dt (friction + stops),
    q+ = q + dt v+

The superscript + marks values after the step. M is the mass matrix, D the damping. K and q0 are the
stiffness and the rest position of the springs. Joint i has a target speed, which is 0 without a
motor, and a largest friction f_i. The joint moves at its target speed if this needs less friction
than f_i. Otherwise the friction is f_i, against the motion relative to the target speed. The stops
apply the efforts that keep q+ within the limits. These equations have exactly one solution.

The mode of a joint states which of these cases applies: at the target speed, above it, below it, or
at a stop or speed limit. If the modes are known, the equations are linear. The modes of the last
step are the first guess for the next step.

The functions use the arrays of mass_matrix.py, and with n joints:

    joints (n, 11): parameters of the joints; constants below name the columns
    modes (n,): modes of the joints
"""

from math import inf, isfinite, sqrt

from aras_sim_bridge.world.mass_matrix import BIAS, TREE_TYPES, compute_dynamics
from aras_visual_servo_base.compiled import jit

# Columns of the array `joints`. FORCE is the largest friction of the joint, TARGET its target
# speed. LOWER and UPPER are its stops, RETURN is the speed at which it returns from beyond a stop.
# FASTEST is its velocity limit. RATIO and OFFSET relate it to the joint that it mimics. STIFFNESS
# and REST are the stiffness and the rest position of its spring.
(DAMPING, FORCE, TARGET, LOWER, UPPER, RETURN, FASTEST, RATIO, OFFSET, STIFFNESS,
 REST) = range(11)
# Values of the array `modes`: the joint's speed is at the target speed, above or below the target
# speed, at the lower bound, or at the upper bound.
_AT, _ABOVE, _BELOW, _LOW, _HIGH = range(5)
# Fraction of the position error of a joint that is corrected in each step. The error is the
# distance beyond a limit, or the difference to the position that a mimicking joint should have.
_BACK = 0.2
# Speed of a joint above which the simulation is reported as diverged, rad/s or m/s. With steps of 1
# ms, the joint then makes 160 turns per step, so that no force can depend on its position.
FASTEST_SPEED = 1e6
NO_LIMIT_FORCE = 1e18
# In a step, the modes of the joints are guessed or corrected at most _GUESSES times. If they are
# still wrong, up to _SWEEPS sweeps of the projected Gauss-Seidel method follow.
_GUESSES, _SWEEPS = 20, 4000
_ROUNDING = 1e-12  # assumed relative error of computed speeds, due to rounding

# Rows of the array `rows`. PUSH are the efforts of damping, springs and stops, SPEED the joint
# velocities after the step, BEFORE those before the step. The others belong to the equations of the
# step: right side, lower and upper speed bound, largest friction and target speed.
PUSH, SPEED, BEFORE, _RIGHT, _BOTTOM, _TOP, _HOLD, _GOAL = range(1, 9)
STEP_TYPES = f"{TREE_TYPES}, f8[:,::1], i8[::1], f8"
_SOLVER_TYPES = "i8[:,::1], i8[::1], f8[:,:,::1], f8[:,::1]"


@jit("i8[:,::1], f8[:,::1], f8[:,::1], f8, f8[:,:,::1], f8[:,::1]", allocates=False)
def _reduce(tree, joints, state, dt, matrices, rows):
    """Set up the equations of a step for the joints that do not mimic another joint.

    The matrix of the equations is written to matrices[1]. Their right side, and the speed bounds,
    largest friction and target speed of each joint, are written to `rows`.
    """
    n = len(tree)
    mass, a = matrices[0], matrices[1]
    a[:] = 0.0
    for c in range(n):
        rows[_RIGHT, c], rows[_HOLD, c], rows[_GOAL, c] = 0.0, 0.0, 0.0
        rows[_BOTTOM, c], rows[_TOP, c] = -inf, inf
    for j in range(n):
        c, ratio = tree[j, 3], joints[j, RATIO]
        momentum = dt * (state[2, j] - rows[BIAS, j])
        if joints[j, STIFFNESS] != 0.0:
            momentum -= dt * joints[j, STIFFNESS] * (state[0, j] - joints[j, REST])
            a[c, c] += ratio * ratio * dt * dt * joints[j, STIFFNESS]
        for k in range(n):
            momentum += mass[j, k] * state[1, k]
            a[c, tree[k, 3]] += ratio * joints[k, RATIO] * mass[j, k]
        rows[_RIGHT, c] += ratio * momentum
        a[c, c] += ratio * ratio * dt * joints[j, DAMPING]
        if ratio == 0.0:
            continue
        rows[_HOLD, c] += abs(ratio) * dt * joints[j, FORCE]
        if joints[j, TARGET] != 0.0:
            rows[_GOAL, c] = joints[j, TARGET] / ratio
        q, lower, upper = state[0, j], joints[j, LOWER], joints[j, UPPER]
        # Bounds of the speed that keep the joint within its limits. If it is beyond a limit, they
        # only prevent it from moving farther out; `advance` moves it back.
        low = max(min((lower - q) / dt, 0.0), -joints[j, FASTEST])
        high = min(max((upper - q) / dt, 0.0), joints[j, FASTEST])
        if ratio < 0.0:
            low, high = high / ratio, low / ratio
        else:
            low, high = low / ratio, high / ratio
        rows[_BOTTOM, c] = max(rows[_BOTTOM, c], low)
        rows[_TOP, c] = max(min(rows[_TOP, c], high), rows[_BOTTOM, c])


@jit(_SOLVER_TYPES, allocates=False)
def _solve_speeds(tree, modes, matrices, rows):
    """Compute the speeds after the step if `modes` are the right modes of the joints.

    The linear equations are solved by a Cholesky factorisation.
    """
    n = len(tree)
    a, low = matrices[1], matrices[2]
    v = rows[SPEED]
    for c in range(n):
        mode = modes[c]
        if tree[c, 3] != c:
            v[c] = 0.0
        elif mode == _AT:
            v[c] = rows[_GOAL, c]
        elif mode == _LOW:
            v[c] = rows[_BOTTOM, c]
        elif mode == _HIGH:
            v[c] = rows[_TOP, c]
    for c in range(n):
        if tree[c, 3] != c or modes[c] == _AT or modes[c] >= _LOW:
            continue
        rest = rows[_RIGHT, c] - (rows[_HOLD, c] if modes[c] == _ABOVE else -rows[_HOLD, c])
        pivot = a[c, c]
        for k in range(n):
            if tree[k, 3] != k:
                continue
            if modes[k] == _AT or modes[k] >= _LOW:
                rest -= a[c, k] * v[k]
            elif k < c:
                value = a[c, k]
                for i in range(k):
                    if tree[i, 3] == i and modes[i] != _AT and modes[i] < _LOW:
                        value -= low[c, i] * low[k, i]
                low[c, k] = value = value / low[k, k]
                pivot -= value * value
                rest -= value * v[k]
        # The pivot of a joint that moves no mass is 0 up to rounding. Make it infinite, so that the
        # speed is 0.
        low[c, c] = sqrt(pivot) if pivot > _ROUNDING * a[c, c] else inf
        v[c] = rest / low[c, c]
    for c in range(n - 1, -1, -1):
        if tree[c, 3] != c or modes[c] == _AT or modes[c] >= _LOW:
            continue
        v[c] /= low[c, c]
        for k in range(c):
            if tree[k, 3] == k and modes[k] != _AT and modes[k] < _LOW:
                v[k] -= low[c, k] * v[c]


@jit(_SOLVER_TYPES, allocates=False)
def _correct_modes(tree, modes, matrices, rows):
    """Change the mode of each joint whose new speed or friction contradicts its mode.

    Return whether a mode was changed.
    """
    n = len(tree)
    a, v = matrices[1], rows[SPEED]
    changed = False
    for c in range(n):
        if tree[c, 3] != c:
            continue
        mode, friction, target = modes[c], rows[_HOLD, c], rows[_GOAL, c]
        bottom, top = rows[_BOTTOM, c], rows[_TOP, c]
        new = mode
        if mode in (_ABOVE, _BELOW):
            slack = _ROUNDING * abs(v[c])
            if v[c] > top + slack:
                new = _HIGH
            elif v[c] < bottom - slack:
                new = _LOW
            elif (
                mode == _ABOVE and v[c] < target - slack or mode == _BELOW and v[c] > target + slack
            ):
                new = _AT
        else:
            residual = rows[_RIGHT, c]
            size = abs(residual)
            for k in range(n):
                part = a[c, k] * v[k]
                residual -= part
                size += abs(part)
            slack = _ROUNDING * size
            if mode == _AT:
                if target > top:
                    new = _HIGH
                elif target < bottom:
                    new = _LOW
                elif residual > friction + slack:
                    new = _ABOVE
                elif residual < -friction - slack:
                    new = _BELOW
            elif mode == _HIGH and residual < (friction if top > target else -friction) - slack:
                new = _ABOVE if top > target else _BELOW
            elif mode == _LOW and residual > (-friction if bottom < target else friction) + slack:
                new = _BELOW if bottom < target else _ABOVE
        if new != mode:
            modes[c] = new
            changed = True
    return changed


@jit(_SOLVER_TYPES, allocates=False)
def _sweep(tree, modes, matrices, rows):
    """Compute the speeds after the step, and the modes, by projected Gauss-Seidel.

    This method is slow but always converges.
    """
    n = len(tree)
    a, v = matrices[1], rows[SPEED]
    for c in range(n):
        v[c] = min(max(0.0, rows[_BOTTOM, c]), rows[_TOP, c]) if tree[c, 3] == c else 0.0
    for _ in range(_SWEEPS):
        change = size = 0.0
        for c in range(n):
            if tree[c, 3] != c:
                continue
            rest = rows[_RIGHT, c]
            for k in range(n):
                if k != c:
                    rest -= a[c, k] * v[k]
            friction, target = rows[_HOLD, c], rows[_GOAL, c]
            new, modes[c] = target, _AT
            if (rest - friction) / a[c, c] > target:
                new, modes[c] = (rest - friction) / a[c, c], _ABOVE
            elif (rest + friction) / a[c, c] < target:
                new, modes[c] = (rest + friction) / a[c, c], _BELOW
            if new > rows[_TOP, c]:
                new, modes[c] = rows[_TOP, c], _HIGH
            elif new < rows[_BOTTOM, c]:
                new, modes[c] = rows[_BOTTOM, c], _LOW
            change, size = max(change, abs(new - v[c])), max(size, abs(new))
            v[c] = new
        if change <= _ROUNDING * size:
            break


@jit(STEP_TYPES, allocates=False)
def _solve(bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt):
    """Compute the speed of every joint after the step and write it to rows[SPEED].

    A joint that mimics another joint has the speed of that joint times its ratio. The speeds before
    the step are stored in rows[BEFORE], and the external wrenches are cleared.
    """
    compute_dynamics(bodies, tree, state, wrenches, gravity, frames, matrices, rows)
    for j in range(len(tree)):
        rows[BEFORE, j] = state[1, j]
        for k in range(6):
            wrenches[j, k] = 0.0
    _reduce(tree, joints, state, dt, matrices, rows)
    converged = False
    for c in range(len(tree)):
        bound = rows[_BOTTOM if modes[c] == _LOW else _TOP, c]
        # the guess says "at a stop", but the joint has no such stop any more
        if modes[c] >= _LOW and not isfinite(bound):
            modes[c] = _AT
    for _ in range(_GUESSES):
        _solve_speeds(tree, modes, matrices, rows)
        if not _correct_modes(tree, modes, matrices, rows):
            converged = True
            break
    if not converged:
        _sweep(tree, modes, matrices, rows)
    # This has no effect on a joint j that mimics no other joint: tree[j, 3] is j, and the ratio is
    # 1.
    for j in range(len(tree)):
        rows[SPEED, j] = joints[j, RATIO] * rows[SPEED, tree[j, 3]]


@jit(STEP_TYPES, allocates=False)
def advance(
    bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt
):
    """Make one step of `dt` s: write the new positions and velocities to `state`.

    Returns:
        Index of the first joint whose position is not finite or whose speed exceeds FASTEST_SPEED;
        -1 if there is none.
    """
    _solve(bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt)
    n = len(tree)
    for j in range(n):
        state[1, j] = rows[SPEED, j]
        state[0, j] += dt * rows[SPEED, j]
        # Set the position of a joint at its stop to the exact bound, without the rounding error.
        if tree[j, 3] == j and modes[j] >= _LOW:
            bound = joints[j, LOWER if modes[j] == _LOW else UPPER]
            if abs(state[0, j] - bound) < 1e-12 * (1.0 + abs(bound)):
                state[0, j] = bound
    for j in range(n):
        leader = tree[j, 3]
        if leader != j:
            target = joints[j, RATIO] * state[0, leader] + joints[j, OFFSET]
            state[0, j] += _BACK * (target - state[0, j])
        # Move a joint beyond a limit back by changing only its position, so that its speed stays
        # the same.
        excess = state[0, j] - min(max(state[0, j], joints[j, LOWER]), joints[j, UPPER])
        if excess != 0.0:
            largest = dt * joints[j, RETURN]
            state[0, j] -= min(max(_BACK * excess, -largest), largest)
    for j in range(n):
        if not (abs(state[1, j]) < FASTEST_SPEED and isfinite(state[0, j])):
            return j
    return -1


@jit(STEP_TYPES, allocates=False)
def compute_reactions(
    bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt
):
    """Compute the efforts of damping, springs and stops in the next step of `dt` s.

    They are written to rows[PUSH]. Bullet makes this step and adds the friction.
    """
    _solve(bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt)
    n = len(tree)
    a, v = matrices[1], rows[SPEED]
    for j in range(n):
        rows[PUSH, j] = -joints[j, DAMPING] * v[j]
        if joints[j, STIFFNESS] != 0.0:
            rows[PUSH, j] -= joints[j, STIFFNESS] * (state[0, j] + dt * v[j] - joints[j, REST])
        if tree[j, 3] != j or modes[j] < _LOW:
            continue
        residual = rows[_RIGHT, j]
        for k in range(n):
            if tree[k, 3] == k:
                residual -= a[j, k] * v[k]
        friction_limit, target = rows[_HOLD, j], rows[_GOAL, j]
        friction = (
            friction_limit
            if v[j] > target
            else -friction_limit
            if v[j] < target
            else min(max(residual, -friction_limit), friction_limit)
        )
        rows[PUSH, j] -= (residual - friction) / dt
