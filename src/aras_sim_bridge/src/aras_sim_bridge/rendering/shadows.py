"""Light of several lamps on each pixel, with shadows by ray casting.

Most tiles have no clusters of triangles between them and a lamp, so they are fully lit. In other
tiles, rays are cast from the corners of each pixel to the lamp, or to points on its rim if its
shadows are soft. If all rays of a pixel give the same result, the pixel is lit or dark. Otherwise,
MANY_RAYS rays give the fraction of the pixel that is lit. A shadow that is narrower than a pixel
may be missed.

Both sides of a triangle cast shadows, unless it is transparent. A convex visual, such as a ball,
casts no shadow on itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

from .binning import VisibleTriangles
from .fragments import Fragments
from .lamps import CASTS_SHADOWS, COLOUR, KIND, RADIUS, direction_to_lamp
from .pixel_visibility import PixelSamples
from .tiles import TILE, Tiles
from .triangles import Triangles

# Numbers of shadow rays: MANY_RAYS for a pixel at the edge of a shadow, FEW_RAYS for a fragment.
MANY_RAYS, FEW_RAYS = 160, 16
LIT, DARK, MIXED = 1, 2, 3
# Offset of the start of a shadow ray from the surface: OFF (m) plus OFF_FAR times the distance from
# the camera. The offset is needed because mesh coordinates have single precision.
OFF, OFF_FAR = 2e-5, 2e-6


@dataclass(frozen=True)
class Irradiance:
    """Light (red, green, blue) on pixels and fragments. Light of 1 gives a white surface 255.

    Both arrays are empty if there is only the sun; VisibleTriangles.light is then used instead.

    Attributes:
        pixels: (rows, columns, 3) float32, light on each pixel without an edge; the image is
            enlarged to whole tiles.
        fragments: (F, 3) float32, light on each fragment.
    """

    pixels: np.ndarray
    fragments: np.ndarray


NO_IRRADIANCE = Irradiance(np.zeros((0, 0, 3), np.float32), np.zeros((0, 3), np.float32))


def _make_spread() -> np.ndarray:
    """Return points (MANY_RAYS, 4) that are distributed evenly over a pixel and a unit disc.

    The first two coordinates are a point in the pixel, from -0.5 to 0.5 px; the last two are a
    point in the disc. They come from Roberts's sequence in four dimensions.
    """
    golden = 1.16730397826141868  # base of Roberts's sequence: the root g of g**5 = g + 1
    share = (0.5 + (np.arange(MANY_RAYS)[:, None] + 1) / golden ** np.arange(1, 5)) % 1.0
    radius, angle = np.sqrt(share[:, 2:3]), 2 * np.pi * share[:, 3:]
    return np.hstack([share[:, :2] - 0.5, radius * np.cos(angle), radius * np.sin(angle)])


SPREAD = _make_spread()
# Eight points on the rim of a unit disc, which represents the disc of a lamp.
RIM = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1)


class IrradianceSolver:
    """Computes the light of lamps on the triangles of a scene."""

    def __init__(self, triangles: Triangles) -> None:
        c = triangles.clusters
        rows = len(triangles.row_centre)
        self._triangles = triangles
        casting = np.flatnonzero(c.opaque)
        self._order = casting[np.argsort(c.row[casting], kind="stable")]
        self._bounds = np.searchsorted(c.row[self._order], np.arange(rows + 1))
        self._part = triangles.part[c.first] if len(c.first) else c.first

    def compute_irradiance(
        self,
        tiles: Tiles,
        visible: VisibleTriangles,
        samples: PixelSamples,
        edges: np.ndarray,
        fragments: Fragments,
        optical_T_link: np.ndarray,
        lamps: np.ndarray,
        ambient: np.ndarray,
    ) -> Irradiance:
        """Return the irradiance of the pixels and fragments of an image.

        Args:
            tiles: tiles of the image.
            visible, samples, fragments: triangles that the pixels show.
            edges: bit masks of the pixels with edges, from edge_detection.find_edges.
            optical_T_link: (rows, 4, 4) poses of the links in the optical frame.
            lamps: lights, as returned by lamps.pack_lights.
            ambient: (3,) ambient light, in the same unit as Irradiance.
        """
        t, g, f, c = tiles, self._triangles, fragments, self._triangles.clusters
        turn = optical_T_link[g.row[visible.triangle], :3, :3]
        normals = np.einsum("nij,nkj->nki", turn, g.normals[visible.triangle])
        pixels = np.zeros((t.rows * TILE, t.columns * TILE, 3), np.float32)
        on_fragments = np.zeros((len(f.member), 3), np.float32)
        _illuminate(
            samples.tile,
            samples.pixel,
            edges,
            t.valid,
            t.matrices,
            t.cells,
            t.columns,
            visible.side,
            np.ascontiguousarray(normals),
            visible.triangle,
            g.part,
            g.hull,
            optical_T_link,
            g.row_centre,
            g.row_half,
            self._order,
            self._bounds,
            self._part,
            c.row,
            c.first,
            c.count,
            c.centre,
            c.half,
            g.corners,
            lamps,
            ambient,
            f.pixel,
            f.start,
            f.member,
            f.at,
            pixels,
            on_fragments,
        )
        return Irradiance(pixels, on_fragments)


@jit_inline
def _make_basis(d, e):
    """Write to the rows of e (2, 3) two unit vectors perpendicular to d and to each other."""
    k = 0 if abs(d[0]) < 0.6 else 1
    squared = 1.0 - d[k] * d[k]
    length = np.sqrt(squared)
    for j in range(3):
        e[0, j] = ((1.0 if j == k else 0.0) - d[k] * d[j]) / length
    e[1, 0] = d[1] * e[0, 2] - d[2] * e[0, 1]
    e[1, 1] = d[2] * e[0, 0] - d[0] * e[0, 2]
    e[1, 2] = d[0] * e[0, 1] - d[1] * e[0, 0]


@jit_inline
def _is_beam_in_box(T, r, centre, half, n, point, radius, d, far, growth):
    """Return whether a beam may touch box n, which is given in the frame of link r.

    The beam extends from `point` along the unit vector d over the distance `far`. Its radius is
    `radius` at the start and increases by `growth` m per metre.
    """
    low, high = 0.0, far
    wide = 0.0
    middle = 0.0
    for k in range(3):
        # Each pass of the loop adds one axis: `middle` becomes the distance along d from `point` to
        # the centre of the box, and `wide` the square of half the box's diagonal.
        at = T[r, k, 0] * centre[n, 0] + T[r, k, 1] * centre[n, 1] + T[r, k, 2] * centre[n, 2]
        middle += (at + T[r, k, 3] - point[k]) * d[k]
        wide += half[n, k] * half[n, k]
    wide = radius + growth * max(min(middle + np.sqrt(wide), far), 0.0)
    for k in range(3):
        o = s = 0.0
        for j in range(3):
            o += T[r, j, k] * (point[j] - T[r, j, 3])
            s += T[r, j, k] * d[j]
        o -= centre[n, k]
        reach = half[n, k] + wide
        if abs(s) < 1e-12:
            if abs(o) > reach:
                high = -1.0
        else:
            a, b = (-reach - o) / s, (reach - o) / s
            low, high = max(low, min(a, b)), min(high, max(a, b))
    # The beam may touch the box at the distances low..high. It misses the box if this interval is
    # empty.
    return low <= high


@jit("f8[::1], f8[::1], f8, i8, i8, f8, i8[::1], i8, f8[:,:,::1], i8[::1], i8[::1], i8[::1], "
          "i8[::1], f8[:,::1], f8[:,::1], f8[:,:,::1]", allocates=False)
def _is_blocked(
    p,
    d,
    far,
    skip,
    own,
    own_distance,
    candidates,
    candidate_count,
    T,
    part,
    row,
    first,
    count,
    centre,
    half,
    corners,
):
    """Return whether a cluster in `candidates[:candidate_count]` blocks the ray from p along d.

    The ray ends at p + far * d. Clusters of the visual `skip` are ignored. Clusters of the visual
    `own`, to which p belongs, are ignored up to the distance `own_distance` (m), because p is in
    the plane of its triangle, but may be outside the triangle.
    A cluster that blocks the ray is moved to the front of the candidates.
    """
    least = own_distance / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for i in range(candidate_count):
        c = candidates[i]
        if part[c] == skip:
            continue
        begin = least if part[c] == own else 0.0
        r = row[c]
        x, y, z = p[0] - T[r, 0, 3], p[1] - T[r, 1, 3], p[2] - T[r, 2, 3]
        ox = T[r, 0, 0] * x + T[r, 1, 0] * y + T[r, 2, 0] * z
        oy = T[r, 0, 1] * x + T[r, 1, 1] * y + T[r, 2, 1] * z
        oz = T[r, 0, 2] * x + T[r, 1, 2] * y + T[r, 2, 2] * z
        sx = T[r, 0, 0] * d[0] + T[r, 1, 0] * d[1] + T[r, 2, 0] * d[2]
        sy = T[r, 0, 1] * d[0] + T[r, 1, 1] * d[1] + T[r, 2, 1] * d[2]
        sz = T[r, 0, 2] * d[0] + T[r, 1, 2] * d[1] + T[r, 2, 2] * d[2]
        low, high = 0.0, far
        u, v, w = 1.0 / (sx + 1e-300), 1.0 / (sy + 1e-300), 1.0 / (sz + 1e-300)
        a, b = (centre[c, 0] - half[c, 0] - ox) * u, (centre[c, 0] + half[c, 0] - ox) * u
        low, high = max(low, min(a, b)), min(high, max(a, b))
        a, b = (centre[c, 1] - half[c, 1] - oy) * v, (centre[c, 1] + half[c, 1] - oy) * v
        low, high = max(low, min(a, b)), min(high, max(a, b))
        a, b = (centre[c, 2] - half[c, 2] - oz) * w, (centre[c, 2] + half[c, 2] - oz) * w
        low, high = max(low, min(a, b)), min(high, max(a, b))
        if low > high * (1.0 + 1e-9) + 1e-12:
            continue
        for t in range(first[c], first[c] + count[c]):
            ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
            e1x, e1y, e1z = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
            e2x, e2y, e2z = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
            px, py, pz = sy * e2z - sz * e2y, sz * e2x - sx * e2z, sx * e2y - sy * e2x
            det = e1x * px + e1y * py + e1z * pz
            if det == 0.0:
                continue
            scale = 1.0 / det
            tx, ty, tz = ox - ax, oy - ay, oz - az
            u = (tx * px + ty * py + tz * pz) * scale
            if u < 0.0 or u > 1.0:
                continue
            qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
            v = (sx * qx + sy * qy + sz * qz) * scale
            if v < 0.0 or u + v > 1.0:
                continue
            at = (e2x * qx + e2y * qy + e2z * qz) * scale
            if begin < at < far:
                candidates[i] = candidates[0]
                candidates[0] = c
                return True
    return False


@jit_inline
def _find_surface_point(matrices, c, side, m, x, y, p, g):
    """Find the point where the ray of a pixel meets the plane of triangle m.

    The position x, y, px, is relative to the first pixel of cell c, whose pinhole model is
    matrices[c]. The point, shifted off the plane towards the camera, is written to p (3,), and the
    unit normal of the plane to g (3,). Return whether the ray meets the plane.
    """
    rx = matrices[c, 0, 0] * x + matrices[c, 0, 1] * y + matrices[c, 0, 2]
    ry = matrices[c, 1, 0] * x + matrices[c, 1, 1] * y + matrices[c, 1, 2]
    rz = matrices[c, 2, 0] * x + matrices[c, 2, 1] * y + matrices[c, 2, 2]
    gx = side[m, 0, 0] + side[m, 1, 0] + side[m, 2, 0]
    gy = side[m, 0, 1] + side[m, 1, 1] + side[m, 2, 1]
    gz = side[m, 0, 2] + side[m, 1, 2] + side[m, 2, 2]
    w = gx * rx + gy * ry + gz * rz
    is_hit = w > 1e-9
    size = 1.0 / np.sqrt(gx * gx + gy * gy + gz * gz)
    g[0], g[1], g[2] = -gx * size, -gy * size, -gz * size
    w = 1.0 / w if is_hit else 0.0
    p[0], p[1], p[2] = rx * w, ry * w, rz * w
    off = OFF + OFF_FAR * (abs(p[0]) + abs(p[1]) + abs(p[2]))
    p[0], p[1], p[2] = p[0] + off * g[0], p[1] + off * g[1], p[2] + off * g[2]
    return is_hit


@jit_inline
def _aim_ray(lamps, n, p, d, far, e, a, b, ray):
    """Write to ray (3,) the vector from p to a point of the disc that represents lamp n.

    The point has the coordinates a, b along the rows of e, in units of the disc's radius. d is the
    normal of the disc. Return the length of the ray in units of this vector: 1, or inf for a
    directional lamp.
    """
    radius = lamps[n, RADIUS]
    directional = lamps[n, KIND] == 0.0
    for j in range(3):
        offset = radius * (a * e[0, j] + b * e[1, j])
        ray[j] = d[j] + offset if directional else far * d[j] + offset
    return np.inf if directional else 1.0


@jit("i8[::1], i4[:,::1], u8[::1], b1[:,::1], f8[:,:,::1], i8, i8, f8[:,:,::1], f8[:,:,::1], "
          "i8[::1], i8[::1], i8[::1], f8[:,:,::1], f8[:,::1], f8[:,::1], i8[::1], i8[::1], "
          "i8[::1], i8[::1], i8[::1], i8[::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], "
          "f8[::1], i8[::1], i8[::1], i8[::1], f8[:,::1], f4[:,:,::1], f4[:,::1]")
def _illuminate(tile, pixel, edges, valid, matrices, cells, columns, side, normals, triangle, part,
                hull, T, row_centre, row_half, order, bounds, cluster_part, cluster_row, first,
                count, centre, half, corners, lamps, ambient, f_pixel, f_start, f_member, f_at,
                out, f_out):
    """Compute the irradiance of the pixels without edges and of the fragments.

    It is written to `out` and `f_out`, the arrays `pixels` and `fragments` of Irradiance.
    """
    size, one = TILE // cells, np.uint64(1)
    width = columns * TILE
    tiles = len(tile)
    # For each tile, the index in f_pixel of its first pixel with fragments, or -1 if it has none.
    # Pixels of the same tile follow each other in f_pixel.
    f_first = np.full(tiles + 1, -1)
    for n in range(len(f_pixel)):
        at = (f_pixel[n] // width // TILE) * columns + f_pixel[n] % width // TILE
        if f_first[at] < 0:
            f_first[at] = n
    longest = 0
    for n in range(len(f_pixel)):
        longest = max(longest, f_start[n + 1] - f_start[n])
    room = TILE * TILE * (1 + longest)
    # A point is a pixel or fragment of the current tile. These arrays contain, for each point, its
    # triangle, its cell, and its position in the tile.
    members, cell, place = (
        np.empty(room, np.int64),
        np.empty(room, np.int64),
        np.empty(room, np.int64),
    )
    at = np.empty((room, 2))
    points, facing, flat = np.empty((room, 3)), np.empty((room, 3)), np.empty((room, 3))
    light = np.empty((room, 3))
    candidates = np.empty(len(order) + 1, np.int64)
    corner_of, corner_result = np.empty((9, 9), np.int64), np.empty((9, 9), np.int64)
    p, g, d, ray = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    e = np.zeros((2, 3))  # axes of a lamp's disc; hard shadows multiply these axes by 0
    middle, low, high = np.empty(3), np.empty(3), np.empty(3)
    for n in range(tiles):
        if tile[n] == -2 or tile[n] == -1:
            continue
        u0, v0 = TILE * (n % columns), TILE * (n // columns)
        point_count = 0
        for y in range(TILE):
            for x in range(TILE):
                m = tile[n] if tile[n] >= 0 else np.int64(pixel[v0 + y, u0 + x])
                if (m < 0 or not valid[v0 + y, u0 + x]
                        or edges[n] >> np.uint64(y * TILE + x) & one != 0):
                    continue
                members[point_count], place[point_count] = m, y * TILE + x
                cell[point_count] = n * cells * cells + (y // size) * cells + x // size
                at[point_count, 0], at[point_count, 1] = float(x % size), float(y % size)
                point_count += 1
        pixel_count = point_count
        k = f_first[n]
        while k >= 0 and k < len(f_pixel):
            v, u = f_pixel[k] // width, f_pixel[k] % width
            if (v // TILE) * columns + u // TILE != n:
                break
            x, y = u % TILE, v % TILE
            for i in range(f_start[k], f_start[k + 1]):
                members[point_count], place[point_count] = f_member[i], i
                cell[point_count] = n * cells * cells + (y // size) * cells + x // size
                at[point_count, 0], at[point_count, 1] = f_at[i, 0], f_at[i, 1]
                point_count += 1
            k += 1
        if point_count == 0:
            continue
        # A convex visual casts no shadow on itself, so find out whether all points of the tile
        # belong to one.
        common_part = hull[triangle[members[0]]]
        for i in range(point_count):
            if hull[triangle[members[i]]] != common_part:
                common_part = np.int64(-1)
        step = 0.0
        for j in range(3):
            low[j], high[j] = np.inf, -np.inf
        for i in range(point_count):
            m, c = members[i], cell[i]
            _find_surface_point(matrices, c, side, m, at[i, 0], at[i, 1], p, g)
            for j in range(3):
                points[i, j], flat[i, j], light[i, j] = p[j], g[j], ambient[j]
                low[j], high[j] = min(low[j], p[j]), max(high[j], p[j])
                facing[i, j] = 0.0
            squared = 0.0
            for k in range(3):
                share = side[m, k, 0] * p[0] + side[m, k, 1] * p[1] + side[m, k, 2] * p[2]
                for j in range(3):
                    facing[i, j] += share * normals[m, k, j]
            for j in range(3):
                squared += facing[i, j] * facing[i, j]
            length = 1.0 / np.sqrt(max(squared, 1e-300))
            for j in range(3):
                facing[i, j] *= length
            distance = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
            across = longer = 0.0
            for j in range(3):
                across += matrices[c, j, 0] * matrices[c, j, 0]
                r = matrices[c, j, 0] * at[i, 0] + matrices[c, j, 1] * at[i, 1] + matrices[c, j, 2]
                longer += r * r
            step = max(step, distance * np.sqrt(across / longer))
        radius = 0.0
        for j in range(3):
            middle[j] = 0.5 * (low[j] + high[j])
            radius += (high[j] - low[j])**2
        # Radius of a sphere around the points of the tile. It is enlarged, because a pixel on an
        # inclined surface extends far beyond its centre.
        radius = 0.65 * np.sqrt(radius) + 2.0 * step
        for lamp in range(len(lamps)):
            candidate_count = 0
            if lamps[lamp, CASTS_SHADOWS] > 0.0:
                far, _ = direction_to_lamp(lamps, lamp, middle, d)
                directional = lamps[lamp, KIND] == 0.0
                growth = lamps[lamp, RADIUS] if directional else 0.0
                wide = radius if directional else max(radius, lamps[lamp, RADIUS])
                for r in range(len(row_centre)):
                    if not _is_beam_in_box(
                            T, r, row_centre, row_half, r, middle, wide, d, far, growth):
                        continue
                    for k in range(bounds[r], bounds[r + 1]):
                        if cluster_part[order[k]] != common_part and _is_beam_in_box(
                                T, r, centre, half, order[k], middle, wide, d, far, growth):
                            candidates[candidate_count] = order[k]
                            candidate_count += 1
            for i in range(9):
                for j in range(9):
                    corner_of[i, j] = -1
            soft = lamps[lamp, RADIUS] > 0.0
            for i in range(point_count):
                m = members[i]
                for j in range(3):
                    p[j] = points[i, j]
                far, left = direction_to_lamp(lamps, lamp, p, d)
                cosine = facing[i, 0] * d[0] + facing[i, 1] * d[1] + facing[i, 2] * d[2]
                if cosine <= 0.0 or left <= 0.0:
                    continue
                lit_share = 1.0
                if candidate_count > 0:
                    front = flat[i, 0] * d[0] + flat[i, 1] * d[1] + flat[i, 2] * d[2]
                    t = triangle[m]
                    skip = part[t] if hull[t] >= 0 or front <= 0.0 else np.int64(-1)
                    own_distance = 3.0 * step
                    result = 0
                    if i < pixel_count:
                        x0, y0 = place[i] % TILE, place[i] // TILE
                        for k in range(4):
                            x, y = x0 + k % 2, y0 + k // 2
                            if corner_of[y, x] != m:
                                corner_of[y, x] = m
                                own = 0
                                if not _find_surface_point(
                                    matrices,
                                    cell[i],
                                    side,
                                    m,
                                    at[i, 0] + k % 2 - 0.5,
                                    at[i, 1] + k // 2 - 0.5,
                                    p,
                                    g,
                                ):
                                    own = MIXED
                                far, _ = direction_to_lamp(lamps, lamp, p, d)
                                if soft:
                                    _make_basis(d, e)
                                for q in range(2 if soft else 1):
                                    if own == MIXED:
                                        break
                                    a = b = 0.0
                                    if soft:
                                        rim_point = (x + 2 * y) % 4 + 4 * q
                                        a, b = RIM[rim_point, 0], RIM[rim_point, 1]
                                    end = _aim_ray(lamps, lamp, p, d, far, e, a, b, ray)
                                    own |= (
                                        DARK
                                        if _is_blocked(
                                            p,
                                            ray,
                                            end,
                                            skip,
                                            part[t],
                                            own_distance,
                                            candidates,
                                            candidate_count,
                                            T,
                                            cluster_part,
                                            cluster_row,
                                            first,
                                            count,
                                            centre,
                                            half,
                                            corners,
                                        )
                                        else LIT
                                    )
                                corner_result[y, x] = own
                            result |= corner_result[y, x]
                            if result == MIXED:
                                break
                    else:
                        result = MIXED
                    if result == DARK:
                        lit_share = 0.0
                    elif result == MIXED:
                        rays, hits, shrink = MANY_RAYS, 0, 1.0
                        # A fragment may be small, so all its rays start at its centre.
                        if i >= pixel_count:
                            rays, shrink = FEW_RAYS if soft else 1, 0.0
                        ray_count = 0
                        for k in range(rays):
                            s = k
                            if not _find_surface_point(matrices, cell[i], side, m,
                                          at[i, 0] + shrink * SPREAD[s, 0],
                                          at[i, 1] + shrink * SPREAD[s, 1], p, g):
                                continue
                            far, _ = direction_to_lamp(lamps, lamp, p, d)
                            if soft:
                                _make_basis(d, e)
                            end = _aim_ray(
                                lamps, lamp, p, d, far, e, SPREAD[s, 2], SPREAD[s, 3], ray
                            )
                            ray_count += 1
                            hits += (
                                0
                                if _is_blocked(
                                    p,
                                    ray,
                                    end,
                                    skip,
                                    part[t],
                                    own_distance,
                                    candidates,
                                    candidate_count,
                                    T,
                                    cluster_part,
                                    cluster_row,
                                    first,
                                    count,
                                    centre,
                                    half,
                                    corners,
                                )
                                else 1
                            )
                        lit_share = hits / max(ray_count, 1)
                for j in range(3):
                    light[i, j] += lit_share * left * cosine * lamps[lamp, COLOUR + j]
        for i in range(point_count):
            for j in range(3):
                if i < pixel_count:
                    out[v0 + place[i] // TILE, u0 + place[i] % TILE, j] = light[i, j]
                else:
                    f_out[place[i], j] = light[i, j]
