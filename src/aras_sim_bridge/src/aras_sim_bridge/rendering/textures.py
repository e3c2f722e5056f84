"""Texture images with their mipmaps in one array, and texture sampling."""

from __future__ import annotations

import cv2
import numpy as np

from aras_visual_servo_base.compiled import jit_inline

# px per side, powers of two: images are resized to the nearest power within these limits.
SMALLEST, LARGEST = 512, 1024
CHANNEL_BITS = 21  # bits per colour, so that three colours are summed in one integer

# Sample points of a texture in a pixel. Pixels up to WIDE texels long use four; this locates the
# corners of a marker 25 to 43 px wide to 0.002-0.004 px (one point 0.006-0.011, 16 points
# 0.002-0.003). Longer pixels, on inclined surfaces, use DENSE per texel, at most PLACES, evenly
# along the nearest of TURNS directions.
PLACES, DENSE, WIDE, TURNS = 20, 0.8, np.sqrt(8.0), 16


def _make_directions() -> np.ndarray:
    """Return (TURNS, 2) unit vectors x, y over half a turn, numbered as in _find_direction."""
    part = 4.0 * np.arange(TURNS) / TURNS
    cosine = np.where(part < 2.0, 1.0 - part, part - 3.0)
    sine = np.where(part < 2.0, 1.0, -1.0) * (1.0 - abs(cosine))
    angle = 0.5 * np.arctan2(sine, cosine)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _make_sample_points() -> np.ndarray:
    """Return (TURNS, PLACES + 1, PLACES, 2) sample points in a pixel, px from its centre.

    Element [k, n] has n points of equal weight, in coordinates along and across DIRECTIONS[k]:
    evenly spaced along, by the golden ratio across. Element [0, 0] has four points in a square.
    """
    spots = np.zeros((TURNS, PLACES + 1, PLACES, 2))
    fine = np.linspace(-0.75, 0.75, 6001)
    for k, (c, s) in enumerate(DIRECTIONS):
        c, s = (x if abs(x) > 1e-9 else 1e-9 for x in (c, s))
        # Extent of the pixel on both sides of the direction, and cumulative area along it.
        low, high = (pick(0.5 * turn / abs(s) + fine * c / s, 0.5 * turn / abs(c) - fine * s / c)
                     for turn, pick in ((-1.0, np.maximum), (1.0, np.minimum)))
        before = np.cumsum(np.maximum(high - low, 0.0))
        for n in range(1, PLACES + 1):
            along = np.interp((np.arange(n) + 0.5) / n * before[-1], before, fine)
            step = (np.arange(n) - (n - 1) / 2) * (np.sqrt(5.0) - 1.0) / 2
            share = 0.5 + step - np.rint(step)
            spots[k, n, :n, 0] = along
            spots[k, n, :n, 1] = (np.interp(along, fine, low) * (1.0 - share)
                                  + np.interp(along, fine, high) * share)
    spots[0, 0, :4] = [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]]
    return spots


DIRECTIONS = _make_directions()
SAMPLE_POINTS = _make_sample_points()


class Textures:
    """Textures of a scene with their mipmaps.

    Attributes:
        texels: (N,) uint64, one texture after another. Each starts with the number of texels per
            side. Then follow the texels, row by row from v = 0 upwards as in OBJ files, with
            CHANNEL_BITS bits each for red, green and blue from the lowest bit. Then follow the
            levels of half the size, a quarter and so on, down to one texel.
    """

    def __init__(self, files: set[str]) -> None:
        self._first: dict[str, int] = {}
        texels = [np.zeros(0, np.uint64)]
        for file in sorted(files):
            self._first[file] = sum(len(one) for one in texels)
            bgr = cv2.imread(file, cv2.IMREAD_COLOR)
            if bgr is None:
                bgr = np.full((1, 1, 3), 255, np.uint8)
            size = 2 ** int(np.rint(np.log2(max(bgr.shape))))
            size = min(max(size, SMALLEST), LARGEST)
            image = cv2.resize(bgr, (size, size), interpolation=cv2.INTER_AREA)[::-1, :, ::-1]
            texels.append(np.array([size], np.uint64))
            while True:
                red, green, blue = image.reshape(-1, 3).T.astype(np.uint64)
                texels.append(
                    red | green << np.uint64(CHANNEL_BITS) | blue << np.uint64(2 * CHANNEL_BITS)
                )
                if len(image) == 1:
                    break
                rows = image[::2].astype(np.uint16) + image[1::2]
                image = np.rint(0.25 * (rows[:, ::2] + rows[:, 1::2])).astype(np.uint8)
        self.texels = np.concatenate(texels)

    def find_layer(self, file: str) -> int:
        """Return the start of a file's texture in `texels`."""
        return self._first[file]


@jit_inline
def _find_direction(cosine, sine):
    """Return the number of the nearest direction, from cosine and sine of its doubled angle to x.

    Both may have a common factor. The position on a square around 0 replaces that on a circle.
    """
    share = cosine / max(abs(cosine) + abs(sine), 1e-300)
    part = 1.0 - share if sine >= 0.0 else 3.0 + share
    return int(part * (TURNS // 4) + 0.5) % TURNS


@jit_inline
def _sum_texels(texels, at, size, x, y, one, shift):
    """Return red, green and blue of a mipmap level at x, y, packed as in Textures.texels.

    x and y are in units of 2**-15 texels. Values are interpolated linearly between texel centres,
    repeated beyond 0..1, and multiplied by 2**(30 - shift).
    """
    half, mask = np.int64(1) << (shift - np.int64(1)), size - one
    column, row, right, down = x >> 15, y >> 15, x & 32767, y & 32767
    corner_weight = (right * down + half) >> shift
    right_weight = ((right << 15) + half >> shift) - corner_weight
    below_weight = ((down << 15) + half >> shift) - corner_weight
    first_weight = (one << (np.int64(30) - shift)) - corner_weight - right_weight - below_weight
    # The size of a level is a power of two: the mask repeats it.
    upper, lower = at + (row & mask) * size, at + ((row + one) & mask) * size
    left, after = column & mask, (column + one) & mask
    # Unsigned indices spare Numba the test for negative ones.
    return (np.uint64(first_weight) * texels[np.uint64(upper + left)]
            + np.uint64(right_weight) * texels[np.uint64(upper + after)]
            + np.uint64(below_weight) * texels[np.uint64(lower + left)]
            + np.uint64(corner_weight) * texels[np.uint64(lower + after)])


@jit_inline
def map_texture(matrices, c, side, m, uv, t, planes):
    """Write the texture coordinates of triangle m as functions of the pixel in cell c to `planes`.

    The coordinates are U / W and V / W. The rows of `planes` (3, 3) are U, V, W; the columns are
    the changes along x and y, and the value at the cell's first pixel. `t` is the index in
    Triangles.
    """
    for j in range(3):
        U = V = W = 0.0
        for k in range(3):
            share = (side[m, k, 0] * matrices[c, 0, j] + side[m, k, 1] * matrices[c, 1, j]
                     + side[m, k, 2] * matrices[c, 2, j])
            U, V, W = U + share * uv[t, k, 0], V + share * uv[t, k, 1], W + share
        planes[0, j], planes[1, j], planes[2, j] = U, V, W


@jit_inline
def apply_texture(planes, layer, texels, x, y, rgb):
    """Multiply the colour rgb (3,) by the mean of a texture over the pixel at x, y of a cell.

    `planes` are those of map_texture. The mipmap level depends on the pixel's shorter axis.
    """
    Ux, Uy, Vx, Vy, Wx, Wy = (planes[0, 0], planes[0, 1], planes[1, 0], planes[1, 1], planes[2, 0],
                              planes[2, 1])
    W = planes[2, 2] + Wx * x + Wy * y
    U, V = planes[0, 2] + Ux * x + Uy * y, planes[1, 2] + Vx * x + Vy * y
    # Sides of the pixel in texels.
    size, at, one = np.int64(texels[layer]), layer + np.int64(1), np.int64(1)
    scale = size / W
    u, v = U / W, V / W
    ux, uy = (Ux - u * Wx) * scale, (Uy - u * Wy) * scale
    vx, vy = (Vx - v * Wx) * scale, (Vy - v * Wy) * scale
    area = abs(ux * vy - uy * vx)
    both = ux * ux + uy * uy + vx * vx + vy * vy
    longer = np.sqrt(0.5 * (both + np.sqrt(max(both * both - 4.0 * area * area, 0.0))))
    level = 1.0
    while size > 1 and (area > WIDE * longer or DENSE * max(area, longer) > PLACES):
        at += size * size
        size //= 2
        area, longer, level = 0.25 * area, 0.5 * longer, 0.5 * level
    count, shift, turn, kind = 4, np.int64(19), 0, 0
    if longer > WIDE:
        count = min(max(int(np.ceil(DENSE * max(area, longer))), 4), PLACES)
        shift += (count > 4) + (count > 8) + (count > 16)
        turn, kind = _find_direction(ux * ux + vx * vx - uy * uy - vy * vy,
                                2.0 * (ux * uy + vx * vy)), count
        c, s = DIRECTIONS[turn, 0], DIRECTIONS[turn, 1]
        # A mipmap level is blurred by half a texel each way; move the points closer together.
        narrow = np.sqrt(max(1.0 - 3.0 * (1.0 - level * level) * longer * longer
                             / max(area * area, 1e-300), 0.0))
        ux, uy = ux * c + uy * s, narrow * (uy * c - ux * s)
        vx, vy = vx * c + vy * s, narrow * (vy * c - vx * s)
    bright = max(rgb[0], rgb[1], rgb[2]) > 255.0
    u, v = (u * size - 0.5) * 32768.0, (v * size - 0.5) * 32768.0
    scale = 32768.0 * level
    ux, uy, vx, vy = ux * scale, uy * scale, vx * scale, vy * scale
    total, mask = np.uint64(0), np.uint64((1 << CHANNEL_BITS) - 1)
    part = 1.0 / (255.0 * (one << (np.int64(30) - shift)))
    red = green = blue = 0.0
    for k in range(count):
        along, across = SAMPLE_POINTS[turn, kind, k, 0], SAMPLE_POINTS[turn, kind, k, 1]
        texel_sum = _sum_texels(texels, at, size, np.int64(u + along * ux + across * uy),
                     np.int64(v + along * vx + across * vy), one, shift)
        if bright:  # clip each sample to white before averaging, as at edges
            red += min(rgb[0] * part * float(texel_sum & mask), 255.0)
            green += min(rgb[1] * part * float(texel_sum >> np.uint64(CHANNEL_BITS) & mask), 255.0)
            blue += min(rgb[2] * part * float(texel_sum >> np.uint64(2 * CHANNEL_BITS)), 255.0)
        else:
            total += texel_sum
    if bright:
        rgb[0], rgb[1], rgb[2] = red / count, green / count, blue / count
    else:
        rgb[0] *= part / count * float(np.int64(total & mask))
        rgb[1] *= part / count * float(np.int64(total >> np.uint64(CHANNEL_BITS) & mask))
        rgb[2] *= part / count * float(np.int64(total >> np.uint64(2 * CHANNEL_BITS)))
