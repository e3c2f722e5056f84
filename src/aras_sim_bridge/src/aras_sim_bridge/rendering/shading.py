"""The colours of samples and fragments: albedo or texture, lit by one sun, smooth between corners.

A pixel is a word: red, green, blue from the lowest byte up, and 255, or 0 where the lens shows
nothing.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import compiled, inlined

from .binning import Seen
from .fragments import Fragments
from .sampling import BACKGROUND, NOTHING, Samples
from .textures import SIZE
from .tiles import TILE, Tiles
from .triangles import Triangles

# Places a side at which a texture is read in a pixel: a marker 25 to 43 px wide has its corners
# found to 0.002-0.004 px; with one place 0.006-0.011, with four 0.002-0.003.
TAPS = 2


class Shader:
    """Colours one picture after another through the same tiles."""

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._words = np.empty((tiles.rows * TILE, tiles.columns * TILE), np.uint32)

    def plain(self, triangles: Triangles, seen: Seen) -> np.ndarray:
        """(N,) words of the triangles seen that have one colour, 0 for the others."""
        return _plain(seen.triangle, seen.light, triangles.albedo, triangles.layer)

    def words(self, triangles: Triangles, seen: Seen, samples: Samples, plain: np.ndarray,
              sky: np.uint32, edges: np.ndarray) -> np.ndarray:
        """The picture but for the pixels with edges, in an array that the next one overwrites.

        plain, sky, edges: as in finding.found_edges.
        """
        t, g = self._tiles, triangles
        if samples.most == BACKGROUND:
            self._words.fill(sky)
        elif plain[samples.most]:
            self._words.fill(plain[samples.most])
        _colour(samples.tile, samples.pixel, samples.most, edges, plain, sky, seen.triangle,
                seen.side, seen.light, g.albedo, g.layer, g.uv, g.textures.texels, t.matrices,
                t.valid, t.cells, t.columns, self._words)
        return self._words

    def blend(self, triangles: Triangles, seen: Seen, fragments: Fragments, background: np.ndarray,
              words: np.ndarray) -> None:
        """Put the pixels that consist of fragments into words. background: (3,) rgb 0..255."""
        g, t, f = triangles, self._tiles, fragments
        _blend(f.pixel, f.start, f.member, f.share, f.at, seen.triangle, seen.side, seen.light,
               g.albedo, g.layer, g.uv, g.textures.texels, t.matrices, t.cells, t.columns,
               background, words)


@compiled("f8, f8, f8")
def word(red, green, blue):
    """A colour 0..255 as a pixel."""
    r = np.uint32(np.rint(min(max(red, 0.0), 255.0)))
    g = np.uint32(np.rint(min(max(green, 0.0), 255.0)))
    b = np.uint32(np.rint(min(max(blue, 0.0), 255.0)))
    return np.uint32(r | (g << np.uint32(8)) | (b << np.uint32(16)) | np.uint32(0xFF000000))


@compiled("i8[::1], f8[:,::1], f8[:,::1], i8[::1]")
def _plain(triangle, light, albedo, layer):
    out = np.zeros(len(triangle), np.uint32)
    for n in range(len(triangle)):
        t, lit = triangle[n], light[n]
        if layer[t] < 0 and lit[0] == lit[1] and lit[1] == lit[2]:
            out[n] = word(albedo[t, 0] * lit[0], albedo[t, 1] * lit[0], albedo[t, 2] * lit[0])
    return out


@compiled("u1[:,::1], i8, f8, f8, f8")
def _texel(texels, layer, area, u, v):
    """Bilinear red, green, blue at u, v, repeated beyond 0..1, of the half in which `area` texels
    are about one."""
    size, at = SIZE, layer * ((4 * SIZE * SIZE - 1) // 3)
    while area > 2.0 and size > 1:
        at += size * size
        size //= 2
        area /= 4.0
    x, y = u * size - 0.5, v * size - 0.5
    column, row = np.floor(x), np.floor(y)
    right, down = x - column, y - row
    red = green = blue = 0.0
    for i in range(2):
        for j in range(2):
            weight = (right if j else 1.0 - right) * (down if i else 1.0 - down)
            # A half has a power of two a side: the mask repeats it.
            n = at + ((int(row) + i) & (size - 1)) * size + ((int(column) + j) & (size - 1))
            red += weight * texels[n, 0]
            green += weight * texels[n, 1]
            blue += weight * texels[n, 2]
    return red, green, blue


@compiled("f8[:,:,::1], i8, f8[:,:,::1], i8, i8, f8[:,:,::1], i8, u1[:,::1], f8, f8, f8[::1]")
def _textured(matrices, c, side, m, layer, uv, t, texels, x, y, rgb):
    """Multiply the colour rgb (3,) by the texture of triangle m, t in Triangles, over the pixel
    at x, y of cell c: the mean of TAPS x TAPS places in it."""
    # Texture coordinates are U / W, V / W, all three linear in x and y.
    W = Wx = Wy = U = Ux = Uy = V = Vx = Vy = 0.0
    for k in range(3):
        share = along = across = 0.0
        for j in range(3):
            share += side[m, k, j] * (matrices[c, j, 0] * x + matrices[c, j, 1] * y
                                      + matrices[c, j, 2])
            along += side[m, k, j] * matrices[c, j, 0]
            across += side[m, k, j] * matrices[c, j, 1]
        W, Wx, Wy = W + share, Wx + along, Wy + across
        u, v = uv[t, k, 0], uv[t, k, 1]
        U, Ux, Uy = U + share * u, Ux + along * u, Uy + across * u
        V, Vx, Vy = V + share * v, Vx + along * v, Vy + across * v
    u, v = U / W, V / W
    ux, uy = (Ux - u * Wx) / W, (Uy - u * Wy) / W
    vx, vy = (Vx - v * Wx) / W, (Vy - v * Wy) / W
    area = abs(ux * vy - uy * vx) * (SIZE * SIZE / TAPS**2)
    red = green = blue = 0.0
    for i in range(TAPS):
        for j in range(TAPS):
            right, down = (j + 0.5) / TAPS - 0.5, (i + 0.5) / TAPS - 0.5
            r, g, b = _texel(texels, layer, area, u + right * ux + down * uy,
                             v + right * vx + down * vy)
            # What is brighter than white is white before it is mixed, as at edges of triangles.
            red += min(rgb[0] * r / 255.0, 255.0)
            green += min(rgb[1] * g / 255.0, 255.0)
            blue += min(rgb[2] * b / 255.0, 255.0)
    rgb[0], rgb[1], rgb[2] = red / TAPS**2, green / TAPS**2, blue / TAPS**2


@inlined
def _light(matrices, c, side, light, m, x, y):
    """Light on triangle m at x, y of cell c."""
    rx = matrices[c, 0, 0] * x + matrices[c, 0, 1] * y + matrices[c, 0, 2]
    ry = matrices[c, 1, 0] * x + matrices[c, 1, 1] * y + matrices[c, 1, 2]
    rz = matrices[c, 2, 0] * x + matrices[c, 2, 1] * y + matrices[c, 2, 2]
    lit = w = 0.0
    for k in range(3):
        share = side[m, k, 0] * rx + side[m, k, 1] * ry + side[m, k, 2] * rz
        w += share
        lit += share * light[m, k]
    return lit / w


@compiled("i8[::1], i4[:,::1], i8, u8[::1], u4[::1], u4, i8[::1], f8[:,:,::1], f8[:,::1], "
          "f8[:,::1], i8[::1], f8[:,:,::1], u1[:,::1], f8[:,:,::1], b1[:,::1], i8, i8, u4[:,::1]")
def _colour(tile, pixel, most, edges, plain, sky, triangle, side, light, albedo, layer, uv, texels,
            matrices, valid, cells, columns, words):
    size = TILE // cells
    rgb = np.empty(3)
    for n in range(len(tile)):
        u, v = TILE * (n % columns), TILE * (n // columns)
        one = tile[n]
        if one in (NOTHING, BACKGROUND) or (one >= 0 and plain[one] != 0):
            if one == NOTHING:
                words[v:v + TILE, u:u + TILE] = 0
            elif one != most:
                words[v:v + TILE, u:u + TILE] = sky if one == BACKGROUND else plain[one]
            continue
        for y in range(TILE):
            for x in range(TILE):
                m = one if one >= 0 else pixel[v + y, u + x]
                if edges[n] >> np.uint64(y * TILE + x) & np.uint64(1) != 0:
                    continue
                if not valid[v + y, u + x]:
                    words[v + y, u + x] = 0
                elif m < 0:
                    words[v + y, u + x] = sky
                elif plain[m] != 0:
                    words[v + y, u + x] = plain[m]
                else:
                    t = triangle[m]
                    c = n * cells * cells + (y // size) * cells + x // size
                    xc, yc = float(x % size), float(y % size)
                    lit = _light(matrices, c, side, light, m, xc, yc)
                    for k in range(3):
                        rgb[k] = albedo[t, k] * lit
                    if layer[t] >= 0:
                        _textured(matrices, c, side, m, layer[t], uv, t, texels, xc, yc, rgb)
                    words[v + y, u + x] = word(rgb[0], rgb[1], rgb[2])


@compiled("i8[::1], i8[::1], i8[::1], f8[::1], f8[:,::1], i8[::1], f8[:,:,::1], f8[:,::1], "
          "f8[:,::1], i8[::1], f8[:,:,::1], u1[:,::1], f8[:,:,::1], i8, i8, f8[::1], u4[:,::1]")
def _blend(pixel, start, member, share, at, triangle, side, light, albedo, layer, uv, texels,
           matrices, cells, columns, background, words):
    size = TILE // cells
    rgb, total = np.empty(3), np.empty(3)
    width = words.shape[1]
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
        for k in range(start[n], start[n + 1]):
            m = member[k]
            t = triangle[m]
            lit = light[m, 0]
            if light[m, 1] != lit or light[m, 2] != lit:
                lit = _light(matrices, c, side, light, m, at[k, 0], at[k, 1])
            for j in range(3):
                rgb[j] = min(albedo[t, j] * lit, 255.0)
            if layer[t] >= 0:
                _textured(matrices, c, side, m, layer[t], uv, t, texels, at[k, 0], at[k, 1], rgb)
            through = albedo[t, 3] < 1.0
            weight = share[k] * albedo[t, 3]
            for j in range(3):
                total[j] += weight * (rgb[j] - total[j] if through else rgb[j])
        words[v, u] = word(total[0], total[1], total[2])
