"""Support of a base at rest by the ground below it.

The wrench that the base exerts on the ground follows from the motion of the model in the last step.
The ground can support the base if the centre of pressure is inside the support polygon and the
friction suffices.
"""

import cv2
import numpy as np

from aras_visual_servo_base.compiled import jit

# Safety factor of the support by the ground. The tangential load must not exceed this fraction of
# the largest friction. The centre of pressure must be inside the support polygon after this polygon
# is scaled by the factor.
_LOAD_LIMIT = 0.9
BASE_TYPES = "f8[::1], f8[::1], f8[:,::1], f8[::1], f8[::1]"
# The arguments ground, corners, contact_wrench and ground_wrench of `is_supported` for a model
# whose base is not resting but fixed; they are not read.
FIXED_BASE_ARRAYS = (np.zeros(11), np.zeros((1, 6)), np.zeros(6), np.zeros(6))


@jit("i8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[::1], f8[:,::1], f8[::1], "
          "f8[::1], f8", allocates=False)
def is_supported(
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
    """Return whether the ground supported a base at rest during the last step.

    All vectors are in the axes of the root, and positions are relative to its origin.

    Args:
        tree, frames, state: arrays of mass_matrix.py after the step.
        previous_speeds (n,): joint velocities before the step, rad/s or m/s.
        gravity (3,): gravity vector, m/s².
        ground (11,): mass of the base, kg (0); its centre of mass, m (1:4); normal of the ground
            (4:7); a point of the ground, m (7:10); friction coefficient (10).
        corners (m, 6): corners of the support polygon, m. A row is the vector from the point of the
            ground to a corner, followed by the outward normal of the edge that starts at this
            corner.
        contact_wrench (6,): torque (N m) and force (N) on the model by all contacts except those of
            the base with the ground.
        ground_wrench (6,): output: the torque and force that the model needs for its motion from
            the ground and the weight of the base together.
        dt: time step, s.
    """
    for k in range(6):
        ground_wrench[k] = -contact_wrench[k]
    for j in range(len(tree)):
        f = frames[j]
        a = (state[1, j] - previous_speeds[j]) / dt
        sx, sy, sz, tx, ty, tz = f[12] * a, f[13] * a, f[14] * a, f[15] * a, f[16] * a, f[17] * a
        m, hx, hy, hz = f[30], f[31], f[32], f[33]
        ground_wrench[0] += f[34] * sx + f[35] * sy + f[36] * sz + hy * tz - hz * ty
        ground_wrench[1] += f[35] * sx + f[37] * sy + f[38] * sz + hz * tx - hx * tz
        ground_wrench[2] += f[36] * sx + f[38] * sy + f[39] * sz + hx * ty - hy * tx
        ground_wrench[3] += m * tx + sy * hz - sz * hy
        ground_wrench[4] += m * ty + sz * hx - sx * hz
        ground_wrench[5] += m * tz + sx * hy - sy * hx
        if tree[j, 1] < 0:
            for k in range(6):
                ground_wrench[k] += f[40 + k]
    mass, friction = ground[0], ground[10]
    wx, wy, wz = mass * gravity[0], mass * gravity[1], mass * gravity[2]
    # Reaction of the ground: force f, and torque m about the point ground[7:10].
    fx, fy, fz = ground_wrench[3] - wx, ground_wrench[4] - wy, ground_wrench[5] - wz
    cx, cy, cz = ground[1] - ground[7], ground[2] - ground[8], ground[3] - ground[9]
    px, py, pz = ground[7], ground[8], ground[9]
    mx = ground_wrench[0] - (cy * wz - cz * wy) - (py * ground_wrench[5] - pz * ground_wrench[4])
    my = ground_wrench[1] - (cz * wx - cx * wz) - (pz * ground_wrench[3] - px * ground_wrench[5])
    mz = ground_wrench[2] - (cx * wy - cy * wx) - (px * ground_wrench[4] - py * ground_wrench[3])
    nx, ny, nz = ground[4], ground[5], ground[6]
    pressure = fx * nx + fy * ny + fz * nz
    if pressure <= 0.0:
        return False
    # centre of pressure r, relative to the point ground[7:10]
    rx = (ny * mz - nz * my) / pressure
    ry = (nz * mx - nx * mz) / pressure
    rz = (nx * my - ny * mx) / pressure
    nearest, farthest = 1e300, 0.0
    for corner in corners:
        inside = 0.0
        reach = 0.0
        for k in range(3):
            r = rx if k == 0 else ry if k == 1 else rz
            inside += corner[3 + k] * (corner[k] - r)
            reach += corner[3 + k] * corner[k]
        if inside < (1.0 - _LOAD_LIMIT) * reach:
            return False
        x, y, z = corner[0] - rx, corner[1] - ry, corner[2] - rz
        away = x * x + y * y + z * z
        nearest, farthest = min(nearest, away), max(farthest, away)
    sx, sy, sz = fx - pressure * nx, fy - pressure * ny, fz - pressure * nz
    slide = np.sqrt(sx * sx + sy * sy + sz * sz)
    twist = abs(
        (mx - (ry * sz - rz * sy)) * nx
        + (my - (rz * sx - rx * sz)) * ny
        + (mz - (rx * sy - ry * sx)) * nz
    )
    # Friction must also resist the torque `twist` about the normal. If the pressure is distributed
    # suitably, friction has a lever of at least a² / b, where a and b are the smallest and the
    # largest distance of a corner from the centre of pressure. `nearest` is a², `farthest` is b².
    return slide + twist * np.sqrt(farthest) / nearest <= _LOAD_LIMIT * friction * pressure


@jit("f8[:,::1], f8[:,::1], f8[::1]", allocates=False)
def add_contact_wrenches(contacts, root, contact_wrench):
    """Add the torque and force of contacts to `contact_wrench`.

    Args:
        contacts (m, 15 or more): contacts in world coordinates. A row starts with the contact
            point, m, and three forces, each as magnitude (N) and direction.
        root (3, 4): world_T_root.
        contact_wrench (6,): torque about the root's origin (N m) and force (N), in the root's axes.
    """
    for push in contacts:
        fx = fy = fz = 0.0
        for k in range(3, 15, 4):
            fx += push[k] * push[k + 1]
            fy += push[k] * push[k + 2]
            fz += push[k] * push[k + 3]
        x, y, z = push[0] - root[0, 3], push[1] - root[1, 3], push[2] - root[2, 3]
        tx, ty, tz = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
        for k in range(3):
            contact_wrench[k] += root[0, k] * tx + root[1, k] * ty + root[2, k] * tz
            contact_wrench[3 + k] += root[0, k] * fx + root[1, k] * fy + root[2, k] * fz


def make_support_polygon(points: np.ndarray, normal: np.ndarray) -> np.ndarray | None:
    """Return the convex hull of points (k, 3) in a plane with this normal.

    Returns:
        (m, 6) for each corner of the hull, its position, followed by the outward normal of the edge
        that starts there. None if the points are on a line.
    """
    aside = np.cross(normal, (1.0, 0.0, 0.0) if abs(normal[0]) < 0.7 else (0.0, 1.0, 0.0))
    aside /= np.linalg.norm(aside)
    axes = np.stack([aside, np.cross(normal, aside)])
    flat = points @ axes.T
    hull = cv2.convexHull(flat.astype(np.float32), clockwise=False, returnPoints=False).ravel()
    if len(hull) < 3:
        return None
    corners = flat[hull]
    along = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return np.hstack([corners @ axes, outward @ axes])
