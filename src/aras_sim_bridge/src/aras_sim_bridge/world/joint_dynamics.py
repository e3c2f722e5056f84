"""Compiled joint-space dynamics of a kinematic tree with a fixed base, and its time step.

All vectors are in the axes of the root frame. Spatial vectors refer to the origin of the root frame
and have the angular part first. Therefore the inertias and forces of a subtree can be added without
transformation. The mass matrix M is computed with the composite-rigid-body algorithm. The bias
efforts, due to gravity and velocities, are computed with the recursive Newton-Euler algorithm
(Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6).

A step of the length dt uses the semi-implicit Euler method for the positions q and velocities v;
damping, springs, friction and stops are implicit:

    (M + dt D + dt² K) v+ = M v + dt (effort - bias - K (q - q0)) - dt (friction + stops),
    q+ = q + dt v+

The superscript + marks values after the step. D is the damping. K and q0 are the stiffness and the
rest position of the springs. Joint i has a target speed, which is 0 without a motor, and a largest
friction f_i. The joint moves at its target speed if this needs less friction than f_i. Otherwise
the friction is f_i, against the motion relative to the target speed. The stops apply the efforts
that keep q+ within the limits. These equations have exactly one solution.

The mode of a joint states which of these cases applies: at the target speed, above it, below it, or
at a stop or speed limit. If the modes are known, the equations are linear. The modes of the last
step are the first guess for the next step.

The functions use these arrays, with n joints:

    bodies (n, 50): data of the bodies, see Articulation.bodies
    tree (n, 4): topology. tree[:, 0] lists the joints in an order from the root outwards.
        tree[j, 1:4] are, for joint j, its parent joint (-1 for the root), whether it is prismatic,
        and the joint that it mimics (j itself if none)
    joints (n, 11): parameters of the joints; constants below name the columns
    state (3, n): positions (rad or m), velocities (rad/s or m/s) and efforts (N m or N)
    wrenches (n, 6): external torque about the root's origin (N m) and force (N) on each body in
        the next step
    gravity (3,): gravity vector, m/s²
    frames (n, 46): state of the bodies, see _compute_kinematics
    matrices (3, n, n): the mass matrix in matrices[0]; the others are work space
    rows (9, n): vectors and work space; constants below name the rows
    modes (n,): modes of the joints
"""

from math import cos, inf, isfinite, sin, sqrt

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

# Rows of the array `rows`. BIAS are the bias efforts, PUSH the efforts of damping, springs and
# stops, SPEED the joint velocities after the step, BEFORE those before the step. The others belong
# to the equations of the step: right side, lower and upper speed bound, largest friction and target
# speed.
BIAS, PUSH, SPEED, BEFORE, _RIGHT, _BOTTOM, _TOP, _HOLD, _GOAL = range(9)
_TREE_TYPES = (
    "f8[:,::1], i8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,:,::1], f8[:,::1]"
)
STEP_TYPES = f"{_TREE_TYPES}, f8[:,::1], i8[::1], f8"
_SOLVER_TYPES = "i8[:,::1], i8[::1], f8[:,:,::1], f8[:,::1]"


@jit("f8[::1], f8[::1], f8[::1]", allocates=False)
def _compute_inertia(b, f, gravity):
    """Write the spatial inertia of a body, and the force for its motion, to `f`.

    The force (torque first) is the one that the body needs for its present velocity if all joint
    accelerations are 0, minus gravity.

    Args:
        b: (50,) row of the body in `bodies`.
        f: (46,) row of the body in `frames`.
        gravity: (3,) gravity vector, m/s².
    """
    px, py, pz = f[9], f[10], f[11]
    m = b[33]
    # Mass times the vector from the body's origin (g) and from the root's origin (h) to the centre
    # of mass, in root axes.
    gx = f[0] * b[34] + f[1] * b[35] + f[2] * b[36]
    gy = f[3] * b[34] + f[4] * b[35] + f[5] * b[36]
    gz = f[6] * b[34] + f[7] * b[35] + f[8] * b[36]
    hx, hy, hz = gx + m * px, gy + m * py, gz + m * pz
    # Rotate the inertia tensor of the body to root axes: R I R^T, where R is the rotation of the
    # body. Then move it to the root's origin.
    for i in range(3):
        x, y, z = f[3 * i], f[3 * i + 1], f[3 * i + 2]
        u = x * b[37] + y * b[38] + z * b[39]
        v = x * b[38] + y * b[40] + z * b[41]
        w = x * b[39] + y * b[41] + z * b[42]
        for k in range(i, 3):
            value = u * f[3 * k] + v * f[3 * k + 1] + w * f[3 * k + 2]
            f[34 + (k if i == 0 else k + 2 if i == 1 else 5)] = value
    pg, pp = px * gx + py * gy + pz * gz, px * px + py * py + pz * pz
    f[34] += m * (pp - px * px) + 2.0 * (pg - px * gx)
    f[35] -= m * px * py + px * gy + gx * py
    f[36] -= m * px * pz + px * gz + gx * pz
    f[37] += m * (pp - py * py) + 2.0 * (pg - py * gy)
    f[38] -= m * py * pz + py * gz + gy * pz
    f[39] += m * (pp - pz * pz) + 2.0 * (pg - pz * gz)
    f[30], f[31], f[32], f[33] = m, hx, hy, hz
    ixx, ixy, ixz, iyy, iyz, izz = f[34], f[35], f[36], f[37], f[38], f[39]
    # Angular momentum l and linear momentum k of the body, and their time derivatives if all joint
    # accelerations are 0.
    wx, wy, wz, vx, vy, vz = f[18], f[19], f[20], f[21], f[22], f[23]
    lx = ixx * wx + ixy * wy + ixz * wz + hy * vz - hz * vy
    ly = ixy * wx + iyy * wy + iyz * wz + hz * vx - hx * vz
    lz = ixz * wx + iyz * wy + izz * wz + hx * vy - hy * vx
    kx = m * vx + wy * hz - wz * hy
    ky = m * vy + wz * hx - wx * hz
    kz = m * vz + wx * hy - wy * hx
    bx, by, bz, ax, ay, az = f[24], f[25], f[26], f[27], f[28], f[29]
    f[40] = ixx * bx + ixy * by + ixz * bz + hy * az - hz * ay
    f[41] = ixy * bx + iyy * by + iyz * bz + hz * ax - hx * az
    f[42] = ixz * bx + iyz * by + izz * bz + hx * ay - hy * ax
    f[40] += wy * lz - wz * ly + vy * kz - vz * ky
    f[41] += wz * lx - wx * lz + vz * kx - vx * kz
    f[42] += wx * ly - wy * lx + vx * ky - vy * kx
    f[43] = m * ax + by * hz - bz * hy + wy * kz - wz * ky
    f[44] = m * ay + bz * hx - bx * hz + wz * kx - wx * kz
    f[45] = m * az + bx * hy - by * hx + wx * ky - wy * kx
    # Subtract the gravity on those links of the body that have gravity enabled.
    n = b[43]
    gx, gy, gz = (
        f[0] * b[44] + f[1] * b[45] + f[2] * b[46] + n * px,
        f[3] * b[44] + f[4] * b[45] + f[5] * b[46] + n * py,
        f[6] * b[44] + f[7] * b[45] + f[8] * b[46] + n * pz,
    )
    f[40] -= gy * gravity[2] - gz * gravity[1]
    f[41] -= gz * gravity[0] - gx * gravity[2]
    f[42] -= gx * gravity[1] - gy * gravity[0]
    f[43] -= n * gravity[0]
    f[44] -= n * gravity[1]
    f[45] -= n * gravity[2]


@jit("f8[:,::1], i8[:,::1], f8[:,::1], f8[::1], f8[:,::1]", allocates=False)
def _compute_kinematics(bodies, tree, state, gravity, frames):
    """Write poses, joint axes, velocities, inertias and forces of all bodies to `frames`.

    Row j of `frames` belongs to the body that joint j moves. Its columns are in the axes of the
    root frame and in SI units; all except the first two refer to the origin of the root frame:

        0:9    rotation matrix of the body
        9:12   origin of the body
        12:18  joint axis (angular, linear)
        18:24  velocity (angular, linear)
        24:30  acceleration (angular, linear) for joint accelerations of 0
        30     mass
        31:34  mass times centre of mass
        34:40  inertia tensor (xx xy xz yy yz zz)
        40:46  torque and force, see _compute_inertia
    """
    for place in range(len(tree)):
        j = tree[place, 0]
        parent = tree[j, 1]
        b, f = bodies[j], frames[j]
        q, qd = state[0, j], state[1, j]
        slides = tree[j, 2] == 1
        c, s = (1.0, 0.0) if slides else (cos(q), sin(q))
        shift = q if slides else 0.0
        # Rotation r (matrix) and origin o of the joint's frame in the frame of its parent.
        r0 = b[0] + c * b[9] + s * b[18]
        r1 = b[1] + c * b[10] + s * b[19]
        r2 = b[2] + c * b[11] + s * b[20]
        r3 = b[3] + c * b[12] + s * b[21]
        r4 = b[4] + c * b[13] + s * b[22]
        r5 = b[5] + c * b[14] + s * b[23]
        r6 = b[6] + c * b[15] + s * b[24]
        r7 = b[7] + c * b[16] + s * b[25]
        r8 = b[8] + c * b[17] + s * b[26]
        ox, oy, oz = b[27] + shift * b[47], b[28] + shift * b[48], b[29] + shift * b[49]
        if parent < 0:
            f[0], f[1], f[2], f[3], f[4] = r0, r1, r2, r3, r4
            f[5], f[6], f[7], f[8] = r5, r6, r7, r8
            f[9], f[10], f[11] = ox, oy, oz
        else:
            p = frames[parent]
            for i in range(3):
                x, y, z = p[3 * i], p[3 * i + 1], p[3 * i + 2]
                f[3 * i] = x * r0 + y * r3 + z * r6
                f[3 * i + 1] = x * r1 + y * r4 + z * r7
                f[3 * i + 2] = x * r2 + y * r5 + z * r8
                f[9 + i] = x * ox + y * oy + z * oz + p[9 + i]
        px, py, pz = f[9], f[10], f[11]
        ax = f[0] * b[30] + f[1] * b[31] + f[2] * b[32]
        ay = f[3] * b[30] + f[4] * b[31] + f[5] * b[32]
        az = f[6] * b[30] + f[7] * b[31] + f[8] * b[32]
        if slides:
            f[12], f[13], f[14], f[15], f[16], f[17] = 0.0, 0.0, 0.0, ax, ay, az
        else:
            f[12], f[13], f[14] = ax, ay, az
            f[15], f[16], f[17] = py * az - pz * ay, pz * ax - px * az, px * ay - py * ax
        for i in range(6):
            moved = f[12 + i] * qd
            f[18 + i] = moved if parent < 0 else frames[parent, 18 + i] + moved
        wx, wy, wz, vx, vy, vz = f[18], f[19], f[20], f[21], f[22], f[23]
        sx, sy, sz = f[12] * qd, f[13] * qd, f[14] * qd
        tx, ty, tz = f[15] * qd, f[16] * qd, f[17] * qd
        f[24], f[25], f[26] = wy * sz - wz * sy, wz * sx - wx * sz, wx * sy - wy * sx
        f[27] = wy * tz - wz * ty + vy * sz - vz * sy
        f[28] = wz * tx - wx * tz + vz * sx - vx * sz
        f[29] = wx * ty - wy * tx + vx * sy - vy * sx
        if parent >= 0:
            for i in range(24, 30):
                f[i] += frames[parent, i]
        _compute_inertia(b, f, gravity)


@jit("i8[:,::1], f8[:,::1], f8[:,::1], f8[::1]", allocates=False)
def _compute_mass_matrix(tree, frames, mass, bias):
    """Compute the mass matrix and the bias efforts from the output of `_compute_kinematics`.

    The bodies are visited from the tips to the root. On return, inertias and forces in `frames` are
    those of whole subtrees.
    """
    n = len(tree)
    mass[:] = 0.0
    for place in range(n - 1, -1, -1):
        j = tree[place, 0]
        f = frames[j]
        sx, sy, sz, tx, ty, tz = f[12], f[13], f[14], f[15], f[16], f[17]
        bias[j] = (
            sx * f[40] + sy * f[41] + sz * f[42] + tx * f[43] + ty * f[44] + tz * f[45]
        )
        m, hx, hy, hz = f[30], f[31], f[32], f[33]
        lx = f[34] * sx + f[35] * sy + f[36] * sz + hy * tz - hz * ty
        ly = f[35] * sx + f[37] * sy + f[38] * sz + hz * tx - hx * tz
        lz = f[36] * sx + f[38] * sy + f[39] * sz + hx * ty - hy * tx
        kx = m * tx + sy * hz - sz * hy
        ky = m * ty + sz * hx - sx * hz
        kz = m * tz + sx * hy - sy * hx
        i = j
        while i >= 0:
            g = frames[i]
            value = (
                g[12] * lx + g[13] * ly + g[14] * lz + g[15] * kx + g[16] * ky + g[17] * kz
            )
            mass[i, j] = value
            mass[j, i] = value
            i = tree[i, 1]
        parent = tree[j, 1]
        if parent >= 0:
            p = frames[parent]
            for k in range(30, 46):
                p[k] += f[k]


@jit(_TREE_TYPES, allocates=False)
def _compute_equations(bodies, tree, state, wrenches, gravity, frames, matrices, rows):
    """Write the mass matrix to matrices[0] and the bias efforts to rows[BIAS].

    The bias efforts include the effect of the external wrenches.
    """
    _compute_kinematics(bodies, tree, state, gravity, frames)
    for j in range(len(tree)):
        for k in range(6):
            frames[j, 40 + k] -= wrenches[j, k]
    _compute_mass_matrix(tree, frames, matrices[0], rows[BIAS])


@jit("f8[:,::1], f8[:,::1], f8[:,::1]", allocates=False)
def _start_step(state, wrenches, rows):
    """Store the speeds before the step, and clear the external wrenches."""
    for j in range(len(wrenches)):
        rows[BEFORE, j] = state[1, j]
        for k in range(6):
            wrenches[j, k] = 0.0


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


@jit("i8[:,::1], f8[:,::1], f8[:,::1], f8, f8[:,:,::1], f8[:,::1], i8[::1]", allocates=False)
def _solve(tree, joints, state, dt, matrices, rows, modes):
    """Compute the speed of every joint after the step and write it to rows[SPEED].

    A joint that mimics another joint has the speed of that joint times its ratio.
    """
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


@jit(_TREE_TYPES, allocates=False)
def compute_dynamics(bodies, tree, state, wrenches, gravity, frames, matrices, rows):
    """Write the mass matrix (n, n) to matrices[0] and the bias efforts (n,) to rows[BIAS]."""
    _compute_equations(bodies, tree, state, wrenches, gravity, frames, matrices, rows)


@jit(STEP_TYPES, allocates=False)
def advance(
    bodies, tree, state, wrenches, gravity, frames, matrices, rows, joints, modes, dt
):
    """Make one step of `dt` s: write the new positions and velocities to `state`.

    Returns:
        Index of the first joint whose position is not finite or whose speed exceeds FASTEST_SPEED;
        -1 if there is none.
    """
    _compute_equations(bodies, tree, state, wrenches, gravity, frames, matrices, rows)
    _start_step(state, wrenches, rows)
    _solve(tree, joints, state, dt, matrices, rows, modes)
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
    _compute_equations(bodies, tree, state, wrenches, gravity, frames, matrices, rows)
    _start_step(state, wrenches, rows)
    _solve(tree, joints, state, dt, matrices, rows, modes)
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
