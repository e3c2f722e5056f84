"""Dark round dots."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.settings import parameter

from ..errors import VisionError
from ..segmented_target import find_touched_borders
from .base import TRACKERS, Tracker, sort_by_angle

MIN_DOT_AREA = 4  # pixels: of less, no centre can be had
# Area of a dot over that of the ellipse in its box: least, most (an upright rectangle has 1.27),
# and least of one of so few pixels that they shape it; how long it may be for its width.
MIN_ROUNDNESS, MAX_ROUNDNESS, COARSE_AREA, MIN_COARSE_ROUNDNESS, MAX_ELONGATION = (
    0.8,
    1.15,
    60,
    0.6,
    4.0,
)
# pixels about a dot in which the ground is seen, and in which it fades
GROUND_WIDTH, EDGE_WIDTH = 3, 1.5
DOT_ITERATIONS = 2  # the ellipse about a dot is put about its centre


@TRACKERS.register("dots")
@dataclass(eq=False)
class DotTracker(Tracker):
    """Centres of dark round dots on a lighter ground, in order of angle about their middle.

    A centre is weighted by darkness, so it is found to a hundredth of a pixel; it is that of the
    dot's image, which for a large dot seen askew is not quite the image of its centre.
    """

    is_numbered = False
    accuracy = 0.005

    count: int = parameter(4, least=1, help="dots of the target")

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """See Tracker.find; the largest `count` dots."""
        level, mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
        found, _, stats, _ = cv2.connectedComponentsWithStats(mask)
        dots = []
        for left, top, width, height, area in stats[1:found]:
            full = np.pi / 4.0 * width * height
            long = max(width, height) > MAX_ELONGATION * min(width, height)
            if area > COARSE_AREA:
                dotlike = MIN_ROUNDNESS * full < area < MAX_ROUNDNESS * full
            else:
                dotlike = area >= MIN_DOT_AREA and area > MIN_COARSE_ROUNDNESS * full
            if dotlike and not (
                find_touched_borders((left, top, width, height), grey.shape) or long
            ):
                dots.append((int(area), left, top, width, height))
        if len(dots) < self.count:
            raise VisionError(
                f"{len(dots)} of {self.count} dots are in view: are they dark, round and apart?"
            )
        dots.sort(reverse=True)
        return sort_by_angle(
            np.array([self._compute_centre(grey, *dot[1:]) for dot in dots[: self.count]])
        )

    @staticmethod
    def _compute_centre(grey: np.ndarray, left: int, top: int, width: int, height: int) -> tuple:
        low_u, low_v = max(left - GROUND_WIDTH, 0), max(top - GROUND_WIDTH, 0)
        part = grey[
            low_v : top + height + GROUND_WIDTH, low_u : left + width + GROUND_WIDTH
        ].astype(float)
        v, u = np.indices(part.shape)
        middle = left - low_u + 0.5 * (width - 1), top - low_v + 0.5 * (height - 1)
        for _ in range(DOT_ITERATIONS):
            away = ((u - middle[0]) / (0.5 * width + EDGE_WIDTH)) ** 2 + (
                (v - middle[1]) / (0.5 * height + EDGE_WIDTH)
            ) ** 2
            dark = np.where(away <= 1.0, np.median(part[away > 1.0]) - part, 0.0)
            middle = (dark * u).sum() / dark.sum(), (dark * v).sum() / dark.sum()
        return low_u + float(middle[0]), low_v + float(middle[1])
