"""Compiled mass matrix and bias efforts of a kinematic tree with a fixed base.

All vectors are in the axes of the root frame. Spatial vectors refer to the origin of the root frame
and have the angular part first. Therefore the inertias and forces of a subtree can be added without
transformation. The mass matrix M is computed with the composite-rigid-body algorithm. The bias
efforts, due to gravity and velocities, are computed with the recursive Newton-Euler algorithm
(Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6).

The functions use these arrays, with n joints:

    bodies (n, 50): data of the bodies, see FixedBaseTree.bodies
    tree (n, 4): topology. tree[:, 0] lists the joints in an order from the root outwards.
        tree[j, 1:4] are, for joint j, its parent joint (-1 for the root), whether it is prismatic,
        and the joint that it mimics (j itself if none)
    state (3, n): positions (rad or m), velocities (rad/s or m/s) and efforts (N m or N)
    wrenches (n, 6): external torque about the root's origin (N m) and force (N) on each body in
        the next step
    gravity (3,): gravity vector, m/s²
    frames (n, 46): state of the bodies, see _compute_kinematics
    matrices (3, n, n): the mass matrix in matrices[0]; the others are work space of
        joint_dynamics.py
    rows (9, n): vectors and work space; the bias efforts are in the row BIAS
"""

from math import cos, sin

from aras_visual_servo_base.compiled import jit

BIAS = 0  # row of the array `rows`
TREE_TYPES = (
    "f8[:,::1], i8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,:,::1], f8[:,::1]"
)


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


@jit(TREE_TYPES, allocates=False)
def compute_dynamics(bodies, tree, state, wrenches, gravity, frames, matrices, rows):
    """Write the mass matrix (n, n) to matrices[0] and the bias efforts (n,) to rows[BIAS].

    The bias efforts include the effect of the external wrenches.
    """
    _compute_kinematics(bodies, tree, state, gravity, frames)
    for j in range(len(tree)):
        for k in range(6):
            frames[j, 40 + k] -= wrenches[j, k]
    _compute_mass_matrix(tree, frames, matrices[0], rows[BIAS])
