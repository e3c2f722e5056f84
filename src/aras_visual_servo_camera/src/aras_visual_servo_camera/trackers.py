"""Points of special targets in a picture: centres of dots, corners of markers. By OpenCV.

Each finds pixels; the lens is taken off by the camera model afterwards. `numbered` says whether
a point is known by itself (a marker's corners) or by its place in the ring alone (dots).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import VisionError

MARKERS = ("DICT_4X4_50", "DICT_APRILTAG_36h11")
SMALLEST_DOT = 6  # pixels: of less, no centre can be had
ROUND = 0.8  # least area of a dot over that of its bounding ellipse
RIM = 3  # pixels about a dot in which it fades


class Tracker(ABC):
    """Base: give `find`."""

    numbered: ClassVar[bool] = True

    @abstractmethod
    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Points (n, 2) in a picture (rows, columns), px (column, row).

        Raises:
            VisionError: they are not to be seen.
        """


class DotTracker(Tracker):
    """Centres of dark round dots on a lighter ground, in order of angle about their middle.

    A centre is weighted by darkness, so it is found to a few hundredths of a pixel; it is that
    of the dot's image, which for a large dot seen askew is not quite the image of its centre.
    """

    numbered = False

    def __init__(self, count: int = 4) -> None:
        self.count = count

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """See Tracker.find; the largest `count` dots."""
        level, mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
        found, _, stats, _ = cv2.connectedComponentsWithStats(mask)
        dots = []
        for left, top, width, height, area in stats[1:found]:
            full = np.pi / 4.0 * width * height
            edge = left == 0 or top == 0 or left + width == grey.shape[1] or (
                top + height == grey.shape[0]
            )
            if area >= SMALLEST_DOT and area > ROUND * full and not edge:
                dots.append((int(area), left, top, width, height))
        if len(dots) < self.count:
            raise VisionError(
                f"{len(dots)} of {self.count} dots are in view: are they dark, round and apart?"
            )
        dots.sort(reverse=True)
        points = np.array([self._centre(grey, *dot[1:]) for dot in dots[: self.count]])
        offset = points - points.mean(axis=0)
        return points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]

    @staticmethod
    def _centre(grey: np.ndarray, left: int, top: int, width: int, height: int) -> tuple:
        low_u, low_v = max(left - RIM, 0), max(top - RIM, 0)
        part = grey[low_v : top + height + RIM, low_u : left + width + RIM].astype(float)
        ground = float(np.percentile(part, 95))
        dark = np.clip(ground - part, 0.0, None)
        dark[dark < 0.1 * dark.max()] = 0.0
        v, u = np.indices(part.shape)
        return (low_u + float((dark * u).sum() / dark.sum()),
                low_v + float((dark * v).sum() / dark.sum()))  # fmt: skip


class MarkerTracker(Tracker):
    """The four corners of an ArUco or AprilTag marker, from its own first one, clockwise."""

    def __init__(self) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._detectors = [
            cv2.aruco.ArucoDetector(
                cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)), parameters
            )
            for name in MARKERS
        ]

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """See Tracker.find; of the largest marker."""
        for detector in self._detectors:
            corners, _, _ = detector.detectMarkers(np.ascontiguousarray(grey))
            if len(corners):
                largest = max(corners, key=lambda c: cv2.contourArea(c.reshape(-1, 2)))
                return largest.reshape(-1, 2).astype(float)
        raise VisionError(f"no marker of {' or '.join(MARKERS)} is in view")


TRACKERS: dict[str, type[Tracker] | None] = {
    "outline": None, "dots": DotTracker, "marker": MarkerTracker,
}  # fmt: skip
