"""Light of several lamps on each pixel, with shadows by ray casting.

Most tiles have no clusters of triangles between them and a lamp, so they are fully lit. In other
tiles, rays are cast from the corners of each pixel to the lamp, or to points on its rim if its
shadows are soft. If all rays of a pixel give the same result, the pixel is lit or dark. Otherwise,
MANY_RAYS rays give the fraction of the pixel that is lit. A shadow that is narrower than a pixel
may be missed.

A convex visual, such as a ball, casts no shadow on itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.compiled import jit

from .binning import VisibleTriangles
from .fragments import Fragments
from .lamps import CASTS_SHADOWS, COLOUR, KIND, RADIUS, direction_to_lamp
from .pixel_visibility import PixelSamples
from .shadow_rays import (
    DARK,
    LIT,
    MIXED,
    ShadowCasters,
    cast_ray,
    find_surface_point,
    is_beam_in_box,
)
from .tiles import TILE, Tiles
from .triangles import Triangles

# Numbers of shadow rays: MANY_RAYS for a pixel at the edge of a shadow, FEW_RAYS for a fragment.
MANY_RAYS, FEW_RAYS = 160, 16


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
            edges: bit masks of the pixels with edges, from triangle_edge_pixels.find_edges.
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
    p, g, d = np.empty(3), np.empty(3), np.empty(3)
    work = np.zeros((6, 3))
    casters = ShadowCasters(T, cluster_part, cluster_row, first, count, centre, half, corners)
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
            find_surface_point(matrices, c, side, m, at[i, 0], at[i, 1], p, g)
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
                    if not is_beam_in_box(
                            T, r, row_centre, row_half, r, middle, wide, d, far, growth):
                        continue
                    for k in range(bounds[r], bounds[r + 1]):
                        if cluster_part[order[k]] != common_part and is_beam_in_box(
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
                                for q in range(2 if soft else 1):
                                    a = b = 0.0
                                    if soft:
                                        rim_point = (x + 2 * y) % 4 + 4 * q
                                        a, b = RIM[rim_point, 0], RIM[rim_point, 1]
                                    if own != MIXED:
                                        own |= cast_ray(
                                            casters, candidates, candidate_count, skip, part[t],
                                            own_distance, lamps, lamp, a, b, matrices, cell[i],
                                            side, m, at[i, 0] + k % 2 - 0.5,
                                            at[i, 1] + k // 2 - 0.5, work)
                                corner_result[y, x] = own
                            result |= corner_result[y, x]
                            if result == MIXED:
                                break
                    else:
                        result = MIXED
                    if result == DARK:
                        lit_share = 0.0
                    elif result == MIXED:
                        rays, shrink = MANY_RAYS, 1.0
                        # A fragment may be small, so all its rays start at its centre.
                        if i >= pixel_count:
                            rays, shrink = FEW_RAYS if soft else 1, 0.0
                        ray_count = hits = 0
                        for k in range(rays):
                            own = cast_ray(
                                casters, candidates, candidate_count, skip, part[t], own_distance,
                                lamps, lamp, SPREAD[k, 2], SPREAD[k, 3], matrices, cell[i], side, m,
                                at[i, 0] + shrink * SPREAD[k, 0], at[i, 1] + shrink * SPREAD[k, 1],
                                work)
                            ray_count += np.int64(own != MIXED)
                            hits += np.int64(own == LIT)
                        lit_share = hits / max(ray_count, 1)
                for j in range(3):
                    light[i, j] += lit_share * left * cosine * lamps[lamp, COLOUR + j]
        for i in range(point_count):
            for j in range(3):
                if i < pixel_count:
                    out[v0 + place[i] // TILE, u0 + place[i] % TILE, j] = light[i, j]
                else:
                    f_out[place[i], j] = light[i, j]
