"""Storage of textures with their mipmaps in one array, and sampling of textures."""

from __future__ import annotations

import cv2
import numpy as np

from aras_visual_servo_base.compiled import jit_inline

# Smallest and largest side of a texture, px. Images are resized to a power of two within these
# limits.
SMALLEST, LARGEST = 512, 1024
# Number of bits for each of red, green and blue in a texel. With this number, one integer can hold
# the sums of the three colours of several texels.
CHANNEL_BITS = 21

# A pixel is shaded with the mean of the texture at several points. It has four points if the area
# that it covers on the texture is at most WIDE texels long. Longer areas, as on inclined surfaces,
# have DENSE points per texel, at most PLACES, along the nearest of TURNS directions. With four
# points, the image corners of a marker that is 25 to 43 px wide have errors of 0.002-0.004 px; with
# one point, the errors are 0.006-0.011 px.
PLACES, DENSE, WIDE, TURNS = 20, 0.8, np.sqrt(8.0), 16


def _make_directions() -> np.ndarray:
    """Return TURNS unit vectors (TURNS, 2) whose directions are spread over half a turn."""
    part = 4.0 * np.arange(TURNS) / TURNS
    cosine = np.where(part < 2.0, 1.0 - part, part - 3.0)
    sine = np.where(part < 2.0, 1.0, -1.0) * (1.0 - abs(cosine))
    angle = 0.5 * np.arctan2(sine, cosine)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _make_sample_points() -> np.ndarray:
    """Return sample points (TURNS, PLACES + 1, PLACES, 2) in a pixel, px from its centre.

    The first n points of element [k, n] have equal weights. Their two coordinates are measured
    along and across DIRECTIONS[k]. They divide the pixel into n parts of equal area along this
    direction; across it, they are spread by the golden ratio. Element [0, 0] contains four points
    in a square.
    """
    spots = np.zeros((TURNS, PLACES + 1, PLACES, 2))
    fine = np.linspace(-0.75, 0.75, 6001)
    for k, (c, s) in enumerate(DIRECTIONS):
        c, s = (x if abs(x) > 1e-9 else 1e-9 for x in (c, s))
        # For each position along the direction: lower and upper limit of the pixel across the
        # direction. `before` is the area of the pixel up to this position.
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
        texels: (N,) uint64, one texture after another. A texture consists of its number of texels
            per side, its texels, row by row from v = 0 upwards as in OBJ files, and the texels of
            its mipmap levels, each with half the size of the previous one, down to one texel. A
            texel contains red, green and blue from the lowest bit on, with CHANNEL_BITS bits each.
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
        """Return the index in `texels` at which the texture of a file starts."""
        return self._first[file]


@jit_inline
def _find_direction(cosine, sine):
    """Return the index in DIRECTIONS of the direction whose angle from x is nearest to t.

    `cosine` and `sine` are those of 2 t, times any positive factor. Opposite directions count as
    equal.
    """
    share = cosine / max(abs(cosine) + abs(sine), 1e-300)
    part = 1.0 - share if sine >= 0.0 else 3.0 + share
    return int(part * (TURNS // 4) + 0.5) % TURNS


@jit_inline
def _sum_texels(texels, at, size, x, y, one, shift):
    """Return the colour of a mipmap level at one point, packed as in Textures.texels.

    The point x, y is in units of 2**-15 texels. Colours are interpolated linearly between texel
    centres. The result is the colour times 2**(30 - shift). The texture is repeated beyond its
    borders.
    """
    half, mask = np.int64(1) << (shift - np.int64(1)), size - one
    column, row, right, down = x >> 15, y >> 15, x & 32767, y & 32767
    corner_weight = (right * down + half) >> shift
    right_weight = ((right << 15) + half >> shift) - corner_weight
    below_weight = ((down << 15) + half >> shift) - corner_weight
    first_weight = (one << (np.int64(30) - shift)) - corner_weight - right_weight - below_weight
    # The bit mask repeats the texture beyond its borders, because the size of a mipmap level is a
    # power of two.
    upper, lower = at + (row & mask) * size, at + ((row + one) & mask) * size
    left, after = column & mask, (column + one) & mask
    # The indices are unsigned, so that Numba does not test whether they are negative.
    return (np.uint64(first_weight) * texels[np.uint64(upper + left)]
            + np.uint64(right_weight) * texels[np.uint64(upper + after)]
            + np.uint64(below_weight) * texels[np.uint64(lower + left)]
            + np.uint64(corner_weight) * texels[np.uint64(lower + after)])


@jit_inline
def map_texture(matrices, c, side, m, uv, t, planes):
    """Compute how the texture coordinates of a triangle depend on the pixel position in cell c.

    The texture coordinates at x, y (px from the first pixel of the cell) are U / W and V / W, where
    U, V and W are linear functions of x and y. Each is written to a row of `planes` (3, 3): its
    change along x, its change along y, and its value at x = y = 0. `m` is the triangle's index in
    VisibleTriangles, and `t` its index in Triangles.
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
    """Multiply the colour rgb (3,) by the mean of a texture over one pixel.

    `planes` is the result of map_texture for a cell, and x, y is the pixel's position relative to
    the first pixel of this cell. The area of the pixel on the texture is treated as an ellipse,
    whose shorter axis determines the mipmap level.
    """
    Ux, Uy, Vx, Vy, Wx, Wy = (planes[0, 0], planes[0, 1], planes[1, 0], planes[1, 1], planes[2, 0],
                              planes[2, 1])
    W = planes[2, 2] + Wx * x + Wy * y
    U, V = planes[0, 2] + Ux * x + Uy * y, planes[1, 2] + Vx * x + Vy * y
    # Derivatives of the texture position (u, v), in texels, with respect to the pixel position (x,
    # y).
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
        # Each texel of a mipmap level is an average of several texels of the texture. This widens
        # the area from which the samples take their colour. Therefore move the samples closer
        # together across the narrow side of this area.
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
        if bright:  # limit each sample to 255 before the samples are averaged
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
