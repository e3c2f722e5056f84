"""Grouping of neighbouring triangles that face the same direction into clusters.

The grouping is compiled, because the model of a robot may have a hundred thousand triangles, and
the simulation waits until they are grouped.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

# Largest number of triangles in a cluster. With 32, a scene with 40 000 triangles is drawn as fast
# as with 16 or 64, and the ARAS robot is drawn a tenth faster than with 128.
CLUSTER_SIZE = 32
# A small cluster is split, too, if the estimated time for its two halves is less than
# LARGEST_COST_RATIO times that for the whole. The estimate for n triangles in a bounding box of the
# surface A is A (n + BOX_TEST_COST) in arbitrary units: testing the box takes as long as
# BOX_TEST_COST triangles.
LARGEST_COST_RATIO, BOX_TEST_COST = 0.6, 1


def cluster_triangles(
    corners: np.ndarray, normal: np.ndarray, part: np.ndarray
) -> list[np.ndarray]:
    """Group triangles into clusters; return the indices of each cluster's triangles.

    The triangles of a cluster belong to the same visual and face roughly the same direction: the
    largest component of their normals is along the same axis, with the same sign. Clusters are
    split in two until they have at most CLUSTER_SIZE triangles, and further if this makes drawing
    cheaper.

    Args:
        corners: (T, 3, 3) corners of the triangles.
        normal: (T, 3) normals of the triangles.
        part: (T,) number of each triangle's visual.
    """
    if not len(corners):
        return []
    along = np.abs(normal).argmax(axis=1)
    side = 2 * along + (normal[np.arange(len(along)), along] > 0)
    label = 6 * part + side
    order = np.argsort(label, kind="stable")
    bounds = np.flatnonzero(np.diff(label[order], prepend=-1, append=label.max() + 1))
    low, high = corners.min(axis=1), corners.max(axis=1)
    keys = np.column_stack([low + high, (high - low).max(axis=1)])
    members, first = _split_clusters(low, high, np.ascontiguousarray(keys.T), order, bounds)
    return np.split(members, first[1:])


@jit_inline
def _compute_surface(low, high, members):
    """Return half the surface area of the box that encloses the bounding boxes of triangles."""
    a0, a1, a2 = low[members[0]]
    b0, b1, b2 = high[members[0]]
    for m in members[1:]:
        a0, a1, a2 = min(a0, low[m, 0]), min(a1, low[m, 1]), min(a2, low[m, 2])
        b0, b1, b2 = max(b0, high[m, 0]), max(b1, high[m, 1]), max(b2, high[m, 2])
    x, y, z = b0 - a0, b1 - a1, b2 - a2
    return x * y + y * z + z * x


@jit("f8[:,::1], f8[:,::1], f8[:,::1], i8[::1], i8[::1]")
def _split_clusters(low, high, keys, order, bounds):
    """Split groups of triangles into clusters.

    Args:
        low, high: (T, 3) corners of the triangles' bounding boxes.
        keys: (K, T) numbers by which the triangles may be sorted before a group is split.
        order, bounds: group k consists of the triangles order[bounds[k]:bounds[k + 1]].

    Returns:
        The triangles cluster by cluster, (T,), and the start of each cluster.
    """
    members, first = np.empty_like(order), np.empty_like(order)
    done, found = 0, 0
    pending = [(bounds[k], bounds[k + 1]) for k in range(len(bounds) - 1)]
    while pending:
        begin, end = pending.pop()
        group = order[begin:end].copy()
        count = end - begin
        half = count // 2
        cost, best = np.inf, group
        if count > 1:
            # Sort the triangles by each key (positions along the three axes, and size), and split
            # them in the middle.
            for k in range(len(keys)):
                one = group[np.argsort(keys[k][group], kind="mergesort")]
                split_cost = (BOX_TEST_COST + half) * _compute_surface(low, high, one[:half])
                split_cost += (BOX_TEST_COST + count - half) * _compute_surface(
                    low, high, one[half:]
                )
                if split_cost < cost:
                    cost, best = split_cost, one
        whole_cost = (BOX_TEST_COST + count) * _compute_surface(low, high, group)
        if count > CLUSTER_SIZE or cost < LARGEST_COST_RATIO * whole_cost:
            for i in range(count):
                order[begin + i] = best[i]
            pending.append((begin, begin + half))
            pending.append((begin + half, end))
        else:
            for i in range(count):
                members[done + i] = group[i]
            first[found] = done
            done, found = done + count, found + 1
    return members, first[:found]
