"""Tests of boxes and triangles against cones. A cone encloses the rays of a tile or of several.

Cones are rows of Tiles.nodes. A test returns True only if this is certain; it may return False
although True would be correct.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

# Number of triangles that are processed together, so that the compiler can use SIMD instructions.
VECTOR_WIDTH = 8


@jit_inline
def is_cone_disjoint(x, y, z, cosine, sine, nodes, n):
    """Return whether the cone of node n does not overlap another cone.

    The other cone is around the unit vector x, y, z; `cosine` and `sine` are those of its half
    angle.
    """
    if nodes[n, 3] > 1.5:
        return True
    # Cones whose half angles add up to more than pi overlap.
    if nodes[n, 4] * cosine + nodes[n, 3] * sine < 0.0:
        return False
    between = x * nodes[n, 0] + y * nodes[n, 1] + z * nodes[n, 2]
    return between < cosine * nodes[n, 3] - sine * nodes[n, 4] - 1e-12


@jit_inline
def is_box_outside(T, r, centre, half, n, nodes, root):
    """Return whether box n of link r is outside the cone of node `root`."""
    cosine, sine = nodes[root, 3], nodes[root, 4]
    if cosine <= 0.0:
        return False
    x, y, z = nodes[root, 0], nodes[root, 1], nodes[root, 2]
    xc, yc, zc = centre[n, 0], centre[n, 1], centre[n, 2]
    xp = T[r, 0, 0] * xc + T[r, 0, 1] * yc + T[r, 0, 2] * zc + T[r, 0, 3]
    yp = T[r, 1, 0] * xc + T[r, 1, 1] * yc + T[r, 1, 2] * zc + T[r, 1, 3]
    zp = T[r, 2, 0] * xc + T[r, 2, 1] * yc + T[r, 2, 2] * zc + T[r, 2, 3]
    along = x * xp + y * yp + z * zp
    ahead = along
    for k in range(3):
        ahead += half[n, k] * abs(T[r, 0, k] * x + T[r, 1, k] * y + T[r, 2, k] * z)
    if ahead <= 0.0:
        return True
    # Test the box against the plane that touches the node's cone on the side of the box's centre.
    xa, ya, za = xp - along * x, yp - along * y, zp - along * z
    across = np.sqrt(xa * xa + ya * ya + za * za)
    share = cosine / max(across, 1e-12)
    xa, ya, za = share * xa - sine * x, share * ya - sine * y, share * za - sine * z
    beyond = cosine * across - sine * along
    for k in range(3):
        beyond -= half[n, k] * abs(T[r, 0, k] * xa + T[r, 1, k] * ya + T[r, 2, k] * za)
    return beyond > 1e-9 * (across + abs(along))


@jit_inline
def is_outside(side, length2, m, nodes, n):
    """Return whether the cone of node n is outside one of the sides of triangle m.

    A ray r is inside side k of the triangle if s_k . r >= 0, with the vectors s_k in `side` (see
    binning.py). `length2` (., 3) contains the squared lengths of the vectors in `side`.
    """
    if nodes[n, 3] <= 0.0:
        return False
    x, y, z, sine = nodes[n, 0], nodes[n, 1], nodes[n, 2], nodes[n, 4]
    for k in range(3):
        at = side[m, k, 0] * x + side[m, k, 1] * y + side[m, k, 2] * z
        if at < 0.0 and at * at > sine * sine * length2[m, k]:
            return True
    return False


@jit_inline
def is_within(side, length2, m, nodes, n):
    """Return whether the cone of node n is inside sides 1 and 2 of triangle m.

    Side 0 is not tested: in a triangle of a quad, it is the diagonal that both triangles share.
    """
    x, y, z, sine2 = nodes[n, 0], nodes[n, 1], nodes[n, 2], nodes[n, 4] * nodes[n, 4]
    within = nodes[n, 3] > 0.0
    for k in range(1, 3):
        at = side[m, k, 0] * x + side[m, k, 1] * y + side[m, k, 2] * z
        within &= (at >= 0.0) & (at * at >= sine2 * length2[m, k])
    return within


@jit("f8[:,:,::1], i8, f8[:,::1], i8", allocates=False)
def find_touching(work, count, nodes, n):
    """Find the triangles of a cluster that may touch the cone of node n.

    Args:
        work: (12, CLUSTER_SIZE / VECTOR_WIDTH, VECTOR_WIDTH) sides of the triangles, and their
            squared lengths.
        count: number of triangles.

    Returns:
        Two bit masks: one of the triangles that may touch the cone, one of the triangles with a
        side that may cross the cone.
    """
    x, y, z = nodes[n, 0], nodes[n, 1], nodes[n, 2]
    sine2 = nodes[n, 4] * nodes[n, 4] if nodes[n, 3] > 0.0 else np.inf
    touching = crossing = np.int64(0)
    g = 0
    while g * VECTOR_WIDTH < count:
        touches = crosses = np.int64(0)
        for k in range(VECTOR_WIDTH):
            at0 = work[0, g, k] * x + work[1, g, k] * y + work[2, g, k] * z
            at1 = work[3, g, k] * x + work[4, g, k] * y + work[5, g, k] * z
            at2 = work[6, g, k] * x + work[7, g, k] * y + work[8, g, k] * z
            near0 = at0 * at0 <= sine2 * work[9, g, k]
            near1 = at1 * at1 <= sine2 * work[10, g, k]
            near2 = at2 * at2 <= sine2 * work[11, g, k]
            is_touching = ((at0 >= 0.0) | near0) & ((at1 >= 0.0) | near1) & ((at2 >= 0.0) | near2)
            touches += np.int64(is_touching) << k
            crosses += np.int64(near0 | near1 | near2) << k
        touching |= touches << (g * VECTOR_WIDTH)
        crossing |= crosses << (g * VECTOR_WIDTH)
        g += 1
    return touching, crossing


@jit_inline
def compare_depth(planes, m, other, nodes, n):
    """Compare the depths of two triangles in the cone of node n.

    Returns:
        1 if triangle m is nearer than `other` everywhere in the cone, -1 if it is farther
        everywhere, 0 if neither is certain.
    """
    x, y, z = (planes[m, 0] - planes[other, 0], planes[m, 1] - planes[other, 1],
               planes[m, 2] - planes[other, 2])
    at = x * nodes[n, 0] + y * nodes[n, 1] + z * nodes[n, 2]
    sine = nodes[n, 4]
    if nodes[n, 3] <= 0.0 or at * at <= sine * sine * (x * x + y * y + z * z):
        return 0
    return 1 if at > 0.0 else -1
