"""Tracker of dark round dots."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.settings import parameter

from ..errors import VisionError
from ..segmented_target import find_touched_borders
from .base import TRACKERS, Tracker, sort_by_angle

MIN_DOT_AREA = 4  # pixels; smaller dots have no reliable centre
# Roundness is a dot's area, divided by the area of the ellipse in its bounding box: 1 for an
# ellipse, 1.27 for an upright rectangle. A dot larger than COARSE_AREA (pixels) must have a
# roundness between MIN_ROUNDNESS and MAX_ROUNDNESS, a smaller dot one above MIN_COARSE_ROUNDNESS.
# The ratio of the bounding box's sides must not exceed MAX_ELONGATION.
MIN_ROUNDNESS, MAX_ROUNDNESS, COARSE_AREA, MIN_COARSE_ROUNDNESS = 0.8, 1.15, 60, 0.6
MAX_ELONGATION = 4.0
# Margin around a dot's bounding box in which the grey level of the background is measured, px.
GROUND_WIDTH = 3
EDGE_WIDTH = 1.5  # px; width of the blurred edge around a dot
# Number of times that the centre of a dot is computed, each time from the pixels in an ellipse
# about the previous centre.
DOT_ITERATIONS = 2


@TRACKERS.register("dots")
class DotTracker(Tracker):
    """The centres of dark, round dots on a lighter background, sorted by angle about their mean.

    A centre is the mean of a dot's pixels, weighted by their darkness. Its error is about a
    hundredth of a pixel. For a large, tilted dot, the centre of its image is not exactly the image
    of its centre.
    """

    is_numbered = False
    accuracy = 0.005

    count: int = parameter(4, least=1, help="number of dots")

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Return the centres (n, 2) of the `count` largest dots in an image, px (column, row)."""
        level, mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
        found, _, stats, _ = cv2.connectedComponentsWithStats(mask)
        dots = []
        for left, top, width, height, area in stats[1:found]:
            ellipse_area = np.pi / 4.0 * width * height
            is_long = max(width, height) > MAX_ELONGATION * min(width, height)
            if area > COARSE_AREA:
                is_round = MIN_ROUNDNESS * ellipse_area < area < MAX_ROUNDNESS * ellipse_area
            else:
                is_round = area >= MIN_DOT_AREA and area > MIN_COARSE_ROUNDNESS * ellipse_area
            is_cut_off = find_touched_borders((left, top, width, height), grey.shape)
            if is_round and not is_long and not is_cut_off:
                dots.append((int(area), left, top, width, height))
        if len(dots) < self.count:
            raise VisionError(
                f"only {len(dots)} of {self.count} dots are detected: move the camera, and make "
                "each dot dark, round and separate from the others"
            )
        dots.sort(reverse=True)
        centres = [self._compute_centre(grey, *dot[1:]) for dot in dots[: self.count]]
        return sort_by_angle(np.array(centres))

    @staticmethod
    def _compute_centre(grey: np.ndarray, left: int, top: int, width: int, height: int) -> tuple:
        low_u, low_v = max(left - GROUND_WIDTH, 0), max(top - GROUND_WIDTH, 0)
        high_u, high_v = left + width + GROUND_WIDTH, top + height + GROUND_WIDTH
        part = grey[low_v:high_v, low_u:high_u].astype(float)
        v, u = np.indices(part.shape)
        middle = left - low_u + 0.5 * (width - 1), top - low_v + 0.5 * (height - 1)
        for _ in range(DOT_ITERATIONS):
            across = (u - middle[0]) / (0.5 * width + EDGE_WIDTH)
            down = (v - middle[1]) / (0.5 * height + EDGE_WIDTH)
            distance = across**2 + down**2
            darkness = np.where(distance <= 1.0, np.median(part[distance > 1.0]) - part, 0.0)
            middle = (darkness * u).sum() / darkness.sum(), (darkness * v).sum() / darkness.sum()
        return low_u + float(middle[0]), low_v + float(middle[1])
