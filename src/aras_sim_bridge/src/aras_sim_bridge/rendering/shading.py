"""Shading of pixels: the albedo or texture of the visible surface times the light.

The light is either that of the sun, interpolated between the corners of a triangle, or the
irradiance from several lights (shadows.Irradiance).

A pixel is a packed colour (see packed_colours.py). Pixels outside the image circle of a lens are 0.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

from .binning import VisibleTriangles
from .fragments import Fragments
from .packed_colours import pack_colour
from .pixel_visibility import PixelSamples
from .shadows import Irradiance
from .textures import apply_texture, map_texture
from .tiles import BACKGROUND, NOTHING, TILE, Tiles
from .triangles import Triangles


class Shader:
    """Shades images that have the same tiles."""

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._packed_image = np.empty((tiles.rows * TILE, tiles.columns * TILE), np.uint32)

    def draw(
        self,
        triangles: Triangles,
        visible: VisibleTriangles,
        samples: PixelSamples,
        edges: np.ndarray,
        fragments: Fragments,
        background: np.ndarray,
        sky: np.uint32,
        light: Irradiance,
        backdrop: np.ndarray,
    ) -> np.ndarray:
        """Return the packed image. The next call overwrites it.

        Args:
            triangles: triangles of the scene.
            visible, samples: visible triangles, and the one that each pixel shows. If there are
                several lights, VisibleTriangles.colour must be 0.
            edges: bit masks of the pixels with edges.
            fragments: visible parts of the triangles in these pixels.
            background: colour (3,) of the background, rgb 0..255.
            sky: packed colour of the background.
            light: irradiance from several lights; empty if there is only the sun.
            backdrop: packed colour of the background at each pixel; if it is empty, the background
                has the same colour everywhere.
        """
        t, g, f = self._tiles, triangles, fragments
        _draw_samples(
            samples.tile, samples.pixel, edges, visible.colour, sky, visible.triangle, visible.side,
            visible.light, g.albedo, g.layer, g.uv, g.textures.texels, t.matrices, t.valid, t.cells,
            t.columns, light.pixels, backdrop, self._packed_image,
        )  # fmt: skip
        _blend_fragments(
            f.pixel, f.start, f.member, f.share, f.at, visible.triangle, visible.side,
            visible.light, g.albedo, g.layer, g.uv, g.textures.texels, t.matrices, t.cells,
            t.columns, background, light.fragments, backdrop, self._packed_image,
        )  # fmt: skip
        return self._packed_image


@jit_inline
def interpolate_light(side, light, m, rx, ry, rz):
    """Return the light on triangle m where the ray (rx, ry, rz) meets its plane."""
    lit = w = 0.0
    for k in range(3):
        share = side[m, k, 0] * rx + side[m, k, 1] * ry + side[m, k, 2] * rz
        w += share
        lit += share * light[m, k]
    return lit / w


@jit_inline
def _find_light(matrices, c, side, light, m, x, y):
    """Return the light on triangle m where the ray of a pixel meets it.

    The position x, y, px, is relative to the first pixel of cell c, whose pinhole model is
    matrices[c].
    """
    rx = matrices[c, 0, 0] * x + matrices[c, 0, 1] * y + matrices[c, 0, 2]
    ry = matrices[c, 1, 0] * x + matrices[c, 1, 1] * y + matrices[c, 1, 2]
    rz = matrices[c, 2, 0] * x + matrices[c, 2, 1] * y + matrices[c, 2, 2]
    return interpolate_light(side, light, m, rx, ry, rz)


@jit("i8[::1], i4[:,::1], u8[::1], u4[::1], u4, i8[::1], f8[:,:,::1], f8[:,::1], "
          "f8[:,::1], i8[::1], f8[:,:,::1], u8[::1], f8[:,:,::1], b1[:,::1], i8, i8, f4[:,:,::1], "
          "u4[:,::1], u4[:,::1]")
def _draw_samples(
    tile,
    pixel,
    edges,
    uniform,
    sky,
    triangle,
    side,
    light,
    albedo,
    layer,
    uv,
    texels,
    matrices,
    valid,
    cells,
    columns,
    irradiance,
    backdrop,
    packed_image,
):
    size = TILE // cells
    rgb, planes = np.empty(3), np.empty((3, 3))
    lamps, has_backdrop = len(irradiance) > 0, len(backdrop) > 0
    last_c = last_m = np.int64(-1)
    for n in range(len(tile)):
        u, v = TILE * (n % columns), TILE * (n // columns)
        one = tile[n]
        if one in (NOTHING, BACKGROUND) or (one >= 0 and uniform[one] != 0):
            colour = np.uint32(0)
            if one != NOTHING:
                colour = sky if one == BACKGROUND else uniform[one]
            for y in range(TILE):
                for x in range(TILE):
                    packed_image[v + y, u + x] = colour
            if one == BACKGROUND and has_backdrop:
                for y in range(TILE):
                    for x in range(TILE):
                        packed_image[v + y, u + x] = backdrop[v + y, u + x]
            continue
        for y in range(TILE):
            for x in range(TILE):
                m = one if one >= 0 else pixel[v + y, u + x]
                if edges[n] >> np.uint64(y * TILE + x) & np.uint64(1) != 0:
                    continue
                if not valid[v + y, u + x]:
                    packed_image[v + y, u + x] = 0
                elif m < 0:
                    packed_image[v + y, u + x] = backdrop[v + y, u + x] if has_backdrop else sky
                elif uniform[m] != 0:
                    packed_image[v + y, u + x] = uniform[m]
                else:
                    t = triangle[m]
                    c = n * cells * cells + (y // size) * cells + x // size
                    xc, yc = float(x % size), float(y % size)
                    lit = light[m, 0]
                    if light[m, 1] != lit or light[m, 2] != lit:
                        lit = _find_light(matrices, c, side, light, m, xc, yc)
                    for k in range(3):
                        rgb[k] = albedo[t, k] * (irradiance[v + y, u + x, k] if lamps else lit)
                    if layer[t] >= 0:
                        if c != last_c or m != last_m:
                            map_texture(matrices, c, side, m, uv, t, planes)
                            last_c, last_m = c, m
                        apply_texture(planes, layer[t], texels, xc, yc, rgb)
                    packed_image[v + y, u + x] = pack_colour(rgb[0], rgb[1], rgb[2])


@jit("i8[::1], i8[::1], i8[::1], f8[::1], f8[:,::1], i8[::1], f8[:,:,::1], f8[:,::1], "
          "f8[:,::1], i8[::1], f8[:,:,::1], u8[::1], f8[:,:,::1], i8, i8, f8[::1], f4[:,::1], "
          "u4[:,::1], u4[:,::1]")
def _blend_fragments(
    pixel,
    start,
    member,
    share,
    at,
    triangle,
    side,
    light,
    albedo,
    layer,
    uv,
    texels,
    matrices,
    cells,
    columns,
    background,
    irradiance,
    backdrop,
    packed_image,
):
    size, lamps = TILE // cells, len(irradiance) > 0
    rgb, total, planes = np.empty(3), np.empty(3), np.empty((3, 3))
    width = packed_image.shape[1]
    for n in range(len(pixel)):
        v, u = pixel[n] // width, pixel[n] % width
        x, y = u % TILE, v % TILE
        cell = (y // size) * cells + x // size
        c = ((v // TILE) * columns + u // TILE) * cells * cells + cell
        left = 1.0
        for k in range(start[n], start[n + 1]):
            if albedo[triangle[member[k]], 3] >= 1.0:
                left -= share[k]
        for j in range(3):
            total[j] = left * background[j]
            if len(backdrop):
                total[j] = left * float(backdrop[v, u] >> np.uint32(8 * j) & np.uint32(255))
        for k in range(start[n], start[n + 1]):
            m = member[k]
            t = triangle[m]
            lit = light[m, 0]
            if light[m, 1] != lit or light[m, 2] != lit:
                lit = _find_light(matrices, c, side, light, m, at[k, 0], at[k, 1])
            for j in range(3):
                rgb[j] = albedo[t, j] * (irradiance[k, j] if lamps else lit)
            if layer[t] >= 0:
                map_texture(matrices, c, side, m, uv, t, planes)
                apply_texture(planes, layer[t], texels, at[k, 0], at[k, 1], rgb)
            for j in range(3):
                rgb[j] = min(rgb[j], 255.0)
            transparent = albedo[t, 3] < 1.0
            weight = share[k] * albedo[t, 3]
            for j in range(3):
                total[j] += weight * (rgb[j] - total[j] if transparent else rgb[j])
        packed_image[v, u] = pack_colour(total[0], total[1], total[2])
