"""Estimate of the fraction of each pixel that the target covers, from the pixel's grey level."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.compiled import jit

from .errors import SegmentationError
from .segmented_target import Mask, SegmentedTarget

# Half width, px, of the square around a pixel over which the local grey level of the background or
# of the target is averaged.
BAND_WIDTH = 3
# If the local grey levels of background and target differ by less than this, the weight of an edge
# pixel is not computed from them: it is 1 for a pixel in the target's mask, otherwise 0.
MIN_CONTRAST = 8.0


def compute_coverage(
    grey: Mask, target: SegmentedTarget, band: int = 2
) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Compute the weight of each pixel, which is the fraction that the target covers.

    A pixel that is more than `band` pixels from the target's edge has the weight one inside the
    target and zero outside. Noise in these pixels therefore has no effect. In the band along the
    edge, a pixel with the grey level I has the weight (bg - I) / (bg - fg), where bg and fg are the
    mean grey levels of the background and of the target outside the band. This weight is not
    clipped to [0, 1], because the mean of clipped noise is not zero.

    If the grey levels vary over the image (`target.is_uneven`), bg and fg are computed for each
    pixel, as means over its neighbourhood. The band is then one pixel wide on each side of the
    edge, and the weights are clipped to [0, 1]. Where bg and fg differ by less than MIN_CONTRAST,
    the weight is 1 in the target's mask, otherwise 0.

    The result is stored in the target, because its moments and its outline need the same weights.

    Returns:
        The weights (rows, columns) of a crop of the image around the target; and (column, row) of
        the crop's first pixel.

    Raises:
        SegmentationError: bg and fg differ by less than one grey level.
    """
    known = target.coverage
    if known is None or known[0] is not grey or known[1] != band:
        target.coverage = known = grey, band, _compute_coverage(grey, target, band)
    return known[2]


def _compute_coverage(
    grey: Mask, target: SegmentedTarget, band: int
) -> tuple[NDArray[np.float64], tuple[int, int]]:
    margin = 2 * band + 1
    column, row, width, height = target.box
    left, top = max(column - margin, 0), max(row - margin, 0)
    right = min(column + width + margin, grey.shape[1])
    bottom = min(row + height + margin, grey.shape[0])
    inside = target.mask[top:bottom, left:right] & 1
    image = grey[top:bottom, left:right]
    if target.is_uneven:
        return _compute_local_coverage(image, inside), (left, top)
    element = _make_square(band)
    around = cv2.dilate(inside, element)
    core = cv2.erode(inside, element, borderType=cv2.BORDER_REPLICATE)
    weights = np.empty(image.shape)
    bg, fg = _compute_weights(image, around, core, weights)
    if abs(bg - fg) < 1.0:
        raise SegmentationError(
            f"the target has no contrast to its surroundings: both have the grey level {bg:.0f}; "
            "use another background, or change the exposure"
        )
    return weights, (left, top)


def _compute_local_coverage(image: Mask, inside: Mask) -> NDArray[np.float64]:
    """Compute the weights (rows, columns) of a crop for grey levels that vary over the image.

    Args:
        image: (rows, columns) grey levels of the crop.
        inside: (rows, columns) 1 on the target, 0 elsewhere.
    """
    around = cv2.dilate(inside, _make_square(1))
    core = cv2.erode(inside, _make_square(1), borderType=cv2.BORDER_REPLICATE)
    levels = []
    for region in (1 - around, core):
        total, count = (
            cv2.boxFilter(part, -1, (2 * BAND_WIDTH + 1,) * 2, normalize=False,
                          borderType=cv2.BORDER_CONSTANT)
            for part in (region * image.astype(np.float64), region.astype(np.float64))
        )  # fmt: skip
        levels.append(np.where(count > 0.5, total / np.maximum(count, 1.0), np.nan))
    bg, fg = levels
    weights = inside.astype(float)
    edge = (around > core) & (np.abs(bg - fg) > MIN_CONTRAST)
    weights[edge] = np.clip((bg[edge] - image[edge]) / (bg[edge] - fg[edge]), 0.0, 1.0)
    return weights


@cache
def _make_square(band: int) -> Mask:
    """Return a square structuring element whose side has 2 band + 1 pixels."""
    return cv2.getStructuringElement(cv2.MORPH_RECT, (2 * band + 1, 2 * band + 1))


@jit("u1[:,:], u1[:,:], u1[:,:]", allocates=False)
def _measure_levels(image, around, core):
    """Return the mean grey levels of the background and of the target.

    Pixels in the band along the target's edge are not used. If all pixels of the background are in
    the band, the level of the background is the highest level in the image. If all pixels of the
    target are in the band, the level of the target is the lowest level in the image.

    Args:
        image: (rows, columns) grey levels.
        around: (rows, columns) zero on the background, nonzero in the band and on the target.
        core: (rows, columns) nonzero on the target without the band.
    """
    bg_count = fg_count = bg_sum = fg_sum = np.int64(0)
    highest, lowest = 0, 255
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            level = np.int64(image[row, column])
            highest, lowest = max(highest, level), min(lowest, level)
            if not around[row, column]:
                bg_count += 1
                bg_sum += level
            elif core[row, column]:
                fg_count += 1
                fg_sum += level
    bg = bg_sum / bg_count if bg_count else float(highest)
    fg = fg_sum / fg_count if fg_count else float(lowest)
    return bg, fg


@jit("u1[:,:], u1[:,:], u1[:,:], f8[:,::1]", allocates=False)
def _compute_weights(image, around, core, weights):
    """Compute the weight of each pixel, i.e. the fraction that the target covers.

    The weight is 1 where `core` is nonzero, and 0 where `around` is zero. In the band between them,
    it is (bg - I) / (bg - fg), where I is the grey level of the pixel in `image`. The weights are
    written to `weights` (rows, columns). Return bg and fg, the results of `_measure_levels`.
    """
    bg, fg = _measure_levels(image, around, core)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            weight = 0.0
            if core[row, column]:
                weight = 1.0
            elif around[row, column]:
                weight = (bg - float(image[row, column])) / (bg - fg)
            weights[row, column] = weight
    return bg, fg
