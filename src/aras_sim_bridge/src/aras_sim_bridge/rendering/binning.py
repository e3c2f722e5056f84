"""Binning: sorting the triangles that may be visible into the tiles of the image.

A triangle has the corners p0, p1, p2 in the optical frame. With det = p0 . (p1 x p2), its side
vectors are s0 = p1 x p2 / det, s1 = p2 x p0 / det, s2 = p0 x p1 / det. A ray r from the camera is
the sum of (s_k . r) p_k, so it hits the triangle if all three products s_k . r are positive. It
meets the plane of the triangle at the point r / ((s0 + s1 + s2) . r). This holds for rays in any
direction, so triangles need not be clipped behind the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.compiled_bits import lowest_bit

from .clustering import CLUSTER_SIZE
from .cones import (
    VECTOR_WIDTH,
    compare_depth,
    find_touching,
    is_box_outside,
    is_cone_disjoint,
    is_outside,
    is_within,
)
from .packed_colours import pack_colour
from .tiles import Tiles
from .triangles import Triangles


@dataclass
class VisibleTriangles:
    """Triangles that face the camera, and the tiles that they touch.

    Attributes:
        triangle: (N,) index of each visible triangle in Triangles. In the other arrays, the number
            of a triangle is its position in this array.
        corner: (N, 3, 3) corners p0, p1, p2 in the optical frame, m.
        side: (N, 3, 3) side vectors s0, s1, s2 in the optical frame, 1/m; see the top of
            binning.py.
        light: (N, 3) light at the corners.
        colour: (N,) packed colour (see packed_colours.py) of each triangle; 0 if its colour varies.
        cut: (N,) bool, whether the triangle crosses the near or far clip distance.
        opaque: (N,) bool, whether the triangle is opaque.
        cover: (tiles,) number of a triangle that covers the whole tile, or -1. It may hide other
            triangles; these are not in `member`.
        start: (tiles + 1,) start of each tile's list in `member`.
        member: (P,) numbers of the other triangles that touch each tile, in ascending order.
        full: (P,) bool, whether each triangle in `member` covers the whole tile.
    """

    triangle: np.ndarray
    corner: np.ndarray
    side: np.ndarray
    light: np.ndarray
    colour: np.ndarray
    cut: np.ndarray
    opaque: np.ndarray
    cover: np.ndarray
    start: np.ndarray
    member: np.ndarray
    full: np.ndarray


class TileBinning:
    """Finds the visible triangles in views of one scene.

    The arrays of a result are overwritten by the next call.
    """

    def __init__(self, triangles: Triangles) -> None:
        self._triangles = triangles
        count = len(triangles.corners)
        self._triangle = np.empty(count, np.int64)
        self._cut, self._opaque = np.empty(count, np.bool_), np.empty(count, np.bool_)
        self._corner, self._side = np.empty((count, 3, 3)), np.empty((count, 3, 3))
        self._light, self._plane, self._length2 = (np.empty((count, 3)) for _ in range(3))
        self._colour = np.empty(count, np.uint32)
        self._cover = self._start = np.empty(0, np.int64)
        self._allocate_pairs(4096)

    def _allocate_pairs(self, capacity: int) -> None:
        """Make room for pairs of a triangle and a tile, unsorted and sorted."""
        self._tile = np.empty(capacity, np.int64)
        self._members = [np.empty(capacity, np.int64) for _ in range(2)]
        self._fulls = [np.empty(capacity, np.bool_) for _ in range(2)]

    def find_visible(
        self,
        tiles: Tiles,
        optical_T_link: np.ndarray,
        sun: np.ndarray,
        light: np.ndarray,
        near: float,
        far: float,
    ) -> VisibleTriangles:
        """Return the triangles that may be visible, sorted into tiles.

        Args:
            tiles: tiles of the image.
            optical_T_link: (rows, 4, 4) poses of the links in the optical frame.
            sun: (rows, 3) unit vectors towards the sun in the link frames.
            light: (2,) ambient light and diffuse light of the sun.
            near, far: clip distances along the axes of the tiles, m.
        """
        g, c, tile_count = self._triangles, self._triangles.clusters, len(tiles.whole)
        if len(self._cover) != len(tiles.nodes) or len(self._start) != tile_count + 1:
            self._cover = np.empty(len(tiles.nodes), np.int64)
            self._start = np.empty(tile_count + 1, np.int64)
        while True:
            count, pairs = _bin(
                optical_T_link, sun, light, c.first, c.count, c.row, c.centre, c.half, c.radius,
                c.axis, c.cosine, c.height, c.opaque, c.quad, g.row_centre, g.row_half, g.corners,
                g.normals, g.plane, g.albedo, g.layer, tiles.nodes, tiles.levels, tiles.children,
                near * tiles.widest, far, self._triangle, self._corner, self._side, self._light,
                self._colour, self._cut, self._opaque, self._plane, self._length2, self._cover,
                self._tile, self._members[0], self._fulls[0], self._start, self._members[1],
                self._fulls[1],
            )
            if pairs <= len(self._tile):
                break
            self._allocate_pairs(2 * pairs)
        return VisibleTriangles(
            self._triangle[:count], self._corner[:count], self._side[:count], self._light[:count],
            self._colour[:count], self._cut[:count], self._opaque[:count], self._cover[:tile_count],
            self._start, self._members[1][:pairs], self._fulls[1][:pairs],
        )  # fmt: skip


@jit("f8[:,:,::1], f8[:,::1], f8[::1], i8[::1], i8[::1], i8[::1], f8[:,::1], f8[:,::1], "
          "f8[::1], f8[:,::1], f8[::1], f8[::1], b1[::1], b1[::1], f8[:,::1], f8[:,::1], "
          "f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], i8[::1], f8[:,::1], i8[:,::1], "
          "f8[:,:,::1], f8, f8, i8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], u4[::1], b1[::1], "
          "b1[::1], f8[:,::1], f8[:,::1], i8[::1], i8[::1], i8[::1], b1[::1], i8[::1], i8[::1], "
          "b1[::1]")
def _bin(T, sun, light, first, count, row, centre, half, radius, axis, cosine, height, opaque, quad,
         row_centre, row_half, corners, normals, plane, albedo, layer, nodes, levels, children,
         near, far, out_triangle, out_corner, out_side, out_light, out_colour, out_cut, out_opaque,
         planes, length2, cover, out_tile, out_member, out_full, start, sorted_member,
         sorted_full):
    """Write the visible triangles and their tiles to the output arrays; see VisibleTriangles.

    Return the number of triangles, and the number of pairs of a triangle and a tile that it
    touches. Pairs beyond the capacity of the output arrays are counted but not stored.

    Args:
        planes: work space for the planes of the triangles; points x of a plane fulfil plane . x =
            1.
        length2: work space for the squared lengths of the vectors in out_side.
        cover: (M,) receives, for each node of the tile tree, the number of a triangle that covers
            all tiles of the node, or -1.
        out_tile, out_member, out_full: work space for the unsorted pairs.
    """
    for n in range(len(cover)):
        cover[n] = -1
    visible = pairs = 0
    top = len(levels) - 1
    root = levels[top, 0]
    one = np.int64(1)
    p = np.empty((3, 3))
    # Position of the camera in the frame of each link, and whether all shapes of the link are
    # outside the image.
    camera_origins, out_of_view = (
        np.empty((len(row_centre), 3)),
        np.empty(len(row_centre), np.bool_),
    )
    for r in range(len(row_centre)):
        for k in range(3):
            camera_origins[r, k] = -(T[r, 0, 3] * T[r, 0, k] + T[r, 1, 3] * T[r, 1, k]
                           + T[r, 2, 3] * T[r, 2, k])
        out_of_view[r] = row_half[r, 0] < 0.0 or is_box_outside(
            T, r, row_centre, row_half, r, nodes, root
        )
    # Stack of nodes of the tile tree that are still to be visited. The columns are level, row and
    # column of the node; a bit mask of the cluster's triangles that may touch the node; and the
    # nearest triangle that covers the node, or -1.
    stack = np.empty((15 * (top - 1) + 1, 5), np.int64)
    touched = np.empty(16, np.bool_)
    # Sides of the triangles in the current cluster, and the squared lengths of these sides.
    work = np.zeros((12, CLUSTER_SIZE // VECTOR_WIDTH, VECTOR_WIDTH))
    for c in range(len(first)):
        r = row[c]
        if out_of_view[r]:
            continue
        # Skip the cluster if all its triangles face away from the camera.
        xe, ye, ze = camera_origins[r, 0], camera_origins[r, 1], camera_origins[r, 2]
        x, y, z = xe - centre[c, 0], ye - centre[c, 1], ze - centre[c, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        along = axis[c, 0] * x + axis[c, 1] * y + axis[c, 2] * z
        highest = distance
        if along < cosine[c] * distance:
            across = np.sqrt(max(distance * distance - along * along, 0.0))
            highest = along * cosine[c] + across * np.sqrt(max(1.0 - cosine[c] * cosine[c], 0.0))
        if highest <= height[c]:
            continue
        sine_c, cosine_c = 0.0, -1.0
        if distance > radius[c]:
            sine_c = radius[c] / distance
            cosine_c = np.sqrt(1.0 - sine_c * sine_c)
        small_c = sine_c if distance > radius[c] else np.inf
        scale = 1.0 / max(distance, 1e-12)
        x, y, z = -x * scale, -y * scale, -z * scale
        xc = T[r, 0, 0] * x + T[r, 0, 1] * y + T[r, 0, 2] * z
        yc = T[r, 1, 0] * x + T[r, 1, 1] * y + T[r, 1, 2] * z
        zc = T[r, 2, 0] * x + T[r, 2, 1] * y + T[r, 2, 2] * z
        if (is_cone_disjoint(xc, yc, zc, cosine_c, sine_c, nodes, root)
                or is_box_outside(T, r, centre, half, c, nodes, root)):
            continue
        first_visible = visible
        for t in range(first[c], first[c] + count[c]):
            if plane[t, 0] * xe + plane[t, 1] * ye + plane[t, 2] * ze <= plane[t, 3]:
                continue
            farthest = 0.0
            for k in range(3):
                x, y, z = corners[t, k, 0], corners[t, k, 1], corners[t, k, 2]
                squared = 0.0
                for j in range(3):
                    p[k, j] = T[r, j, 0] * x + T[r, j, 1] * y + T[r, j, 2] * z + T[r, j, 3]
                    out_corner[visible, k, j] = p[k, j]
                    squared += p[k, j] * p[k, j]
                farthest = max(farthest, squared)
            for k in range(3):
                a, b = (k + 1) % 3, (k + 2) % 3
                out_side[visible, k, 0] = p[a, 1] * p[b, 2] - p[a, 2] * p[b, 1]
                out_side[visible, k, 1] = p[a, 2] * p[b, 0] - p[a, 0] * p[b, 2]
                out_side[visible, k, 2] = p[a, 0] * p[b, 1] - p[a, 1] * p[b, 0]
            det = (p[0, 0] * out_side[visible, 0, 0] + p[0, 1] * out_side[visible, 0, 1]
                   + p[0, 2] * out_side[visible, 0, 2])
            if det >= 0.0:
                continue
            scale = 1.0 / det
            x = y = z = 0.0
            for k in range(3):
                squared = 0.0
                for j in range(3):
                    out_side[visible, k, j] *= scale
                    squared += out_side[visible, k, j] * out_side[visible, k, j]
                length2[visible, k] = squared
                x += out_side[visible, k, 0]
                y += out_side[visible, k, 1]
                z += out_side[visible, k, 2]
            if is_outside(out_side, length2, visible, nodes, root):
                continue
            planes[visible, 0], planes[visible, 1], planes[visible, 2] = x, y, z
            out_cut[visible] = (x * x + y * y + z * z) * near * near > 1.0 or farthest > far * far
            for k in range(3):
                out_light[visible, k] = light[0] + light[1] * max(
                    normals[t, k, 0] * sun[r, 0] + normals[t, k, 1] * sun[r, 1]
                    + normals[t, k, 2] * sun[r, 2], 0.0)
            lit, out_colour[visible] = out_light[visible, 0], 0
            if layer[t] < 0 and lit == out_light[visible, 1] == out_light[visible, 2]:
                out_colour[visible] = pack_colour(
                    albedo[t, 0] * lit, albedo[t, 1] * lit, albedo[t, 2] * lit
                )
            out_triangle[visible], out_opaque[visible] = t, opaque[c]
            g, place = (
                (visible - first_visible) // VECTOR_WIDTH,
                (visible - first_visible) % VECTOR_WIDTH,
            )
            for k in range(3):
                for j in range(3):
                    work[3 * k + j, g, place] = out_side[visible, k, j]
                work[9 + k, g, place] = length2[visible, k]
            visible += 1
        if visible == first_visible:
            continue
        # The two triangles of a quad together cover a tile that is inside the four outer sides of
        # the quad. The first triangle then represents the whole quad.
        whole = (quad[c] and visible == first_visible + 2 and not out_cut[visible - 1]
                 and not out_cut[visible - 2])
        stack[0, 0], stack[0, 1], stack[0, 2] = top, 0, 0
        stack[0, 3], stack[0, 4] = (one << (visible - first_visible)) - one, cover[root]
        stack_size = 1
        while stack_size > 0:
            stack_size -= 1
            level, i0, j0 = stack[stack_size, 0], stack[stack_size, 1], stack[stack_size, 2]
            members, above = stack[stack_size, 3], stack[stack_size, 4]
            parent = levels[level, 3] + i0 * levels[level, 2] + j0
            touched_count = 0
            for k in range(16):
                cosine_n, sine_n = children[parent, 3, k], children[parent, 4, k]
                at = (
                    xc * children[parent, 0, k]
                    + yc * children[parent, 1, k]
                    + zc * children[parent, 2, k]
                )
                # If the half angles of the cluster's and the node's cones add up to more than pi,
                # the cones always overlap; the test `... < 0.0` detects this.
                touched[k] = (cosine_n < 1.5) & (
                    (sine_n * cosine_c + cosine_n * sine_c < 0.0)
                    | (at >= cosine_c * cosine_n - sine_c * sine_n - 1e-12))
                touched_count += touched[k]
            # If the cluster touches only one node, or is small compared with the nodes, do not test
            # its triangles one by one: most of them touch the same nodes as the cluster.
            all_together = touched_count == 1 or (level > 1 and small_c < children[parent, 4, 0])
            level -= 1
            for child in range(16):
                if not touched[child]:
                    continue
                i, j = 4 * i0 + child // 4, 4 * j0 + child % 4
                node = levels[level, 0] + i * levels[level, 2] + j
                own = cover[node] if cover[node] >= 0 else above
                if own >= 0:
                    # Skip the node if the whole cluster is behind a triangle that covers the node.
                    x, y, z = planes[own, 0], planes[own, 1], planes[own, 2]
                    nearest = distance * (x * xc + y * yc + z * zc)
                    for k in range(3):
                        nearest -= half[c, k] * abs(T[r, 0, k] * x + T[r, 1, k] * y
                                                    + T[r, 2, k] * z)
                    if nearest > 1.0:
                        continue
                covered = (whole and is_within(out_side, length2, first_visible, nodes, node)
                           and is_within(out_side, length2, first_visible + 1, nodes, node))
                remaining = members
                if covered or not all_together or level == 0:
                    remaining = np.int64(0)
                    touching, crossing = one, np.int64(0)
                    if not covered:
                        touching, crossing = find_touching(
                            work, visible - first_visible, nodes, node
                        )
                        touching &= members
                    while touching != 0:
                        k = lowest_bit(touching)
                        touching &= touching - one
                        m = first_visible + k
                        full = crossing >> k & one == 0 and (covered or not out_cut[m])
                        if opaque[c]:
                            order = 1 if own < 0 else compare_depth(planes, m, own, nodes, node)
                            if full and order > 0:
                                cover[node] = own = m
                            if order < 0 or full and order > 0:
                                continue
                        if level > 0:
                            remaining |= one << k
                            continue
                        if pairs < len(out_tile):
                            out_tile[pairs], out_member[pairs], out_full[pairs] = node, m, full
                        pairs += 1
                if level > 0 and remaining != 0:
                    stack[stack_size, 0], stack[stack_size, 1], stack[stack_size, 2] = level, i, j
                    stack[stack_size, 3], stack[stack_size, 4] = remaining, own
                    stack_size += 1
    # If a triangle covers a node, it covers all tiles of the node: pass it on to them. If two
    # triangles cover a tile and each is nearer in a part of it, add one of them to the tile's list.
    for level in range(top, 0, -1):
        span = 1 << (2 * level - 2)
        for i0 in range(levels[level, 1]):
            for j0 in range(levels[level, 2]):
                above = cover[levels[level, 0] + i0 * levels[level, 2] + j0]
                if above < 0:
                    continue
                for i in range(4 * i0, min(4 * i0 + 4, levels[level - 1, 1])):
                    for j in range(4 * j0, min(4 * j0 + 4, levels[level - 1, 2])):
                        node = levels[level - 1, 0] + i * levels[level - 1, 2] + j
                        order = 1
                        if cover[node] >= 0:
                            order = compare_depth(planes, above, cover[node], nodes, node)
                        if order > 0:
                            cover[node] = above
                        if order != 0:
                            continue
                        for v in range(i * span, min((i + 1) * span, levels[0, 1])):
                            for u in range(j * span, min((j + 1) * span, levels[0, 2])):
                                if pairs < len(out_tile):
                                    out_tile[pairs] = v * levels[0, 2] + u
                                    out_member[pairs], out_full[pairs] = above, True
                                pairs += 1
    if pairs <= len(out_tile):
        _sort_by_tile(out_tile, out_member, out_full, pairs, start, sorted_member, sorted_full)
    return visible, pairs


@jit("i8[::1], i8[::1], b1[::1], i8, i8[::1], i8[::1], b1[::1]")
def _sort_by_tile(tile, member, full, pairs, start, out_member, out_full):
    """Sort pairs, each of a `tile` and a triangle (`member`), first by tile and then by triangle.

    The results are written to start (tiles + 1,), out_member and out_full, the arrays `start`,
    `member` and `full` of VisibleTriangles.
    """
    tiles = len(start) - 1
    for n in range(tiles + 1):
        start[n] = 0
    for n in range(pairs):
        start[tile[n] + 1] += 1
    for n in range(tiles):
        start[n + 1] += start[n]
    place = start.copy()
    for n in range(pairs):
        at = place[tile[n]]
        place[tile[n]] = at + 1
        # Some triangles come late in the input, because _bin adds triangles that cover whole nodes
        # last. Move them forward, so that each tile's triangles are sorted by number.
        while at > start[tile[n]] and out_member[at - 1] > member[n]:
            out_member[at], out_full[at] = out_member[at - 1], out_full[at - 1]
            at -= 1
        out_member[at], out_full[at] = member[n], full[n]
