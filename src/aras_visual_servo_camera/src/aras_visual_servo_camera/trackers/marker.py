"""Tracker of an ArUco or AprilTag marker, or of a board of markers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.settings import parameter

from ..camera_model import CameraModel
from ..errors import VisionError
from ..intersection_accuracy import FittedLine, compute_crossing_spread
from ..markers import MarkerChoice
from .base import TRACKERS, TrackedPoints
from .edge_tracker_base import EdgeTrackerBase

# Smallest difference between the grey levels of a marker's surroundings and of its black rim.
MIN_CONTRAST = 20.0
RIM_FITS = 2  # number of times that lines are fitted to the edges of the black rim
RIM_STATIONS = (24, 64)  # smallest and largest number of profiles across an edge of the rim
RIM_SPACING = 0.5  # distance between two profiles along an edge of the rim, px
RIM_PART = 0.8  # profiles are taken from this fraction of an edge's length, around its middle
# Half length of a profile: the larger of 1.5 px and 0.6 cells, but at most RIM_MAX_REACH. With 0.6
# cells, a profile across the outer edge of the rim, which is one cell wide, does not reach its
# inner edge.
RIM_REACH = (1.5, 0.6)
RIM_MAX_REACH = 8.0  # px
RIM_STEP = 0.4  # approximate distance between two samples of a profile, px


@TRACKERS.register("marker")
class MarkerTracker(EdgeTrackerBase):
    """The four corners of an ArUco or AprilTag marker, clockwise from its first corner.

    For a board of markers, they are the corners of the rectangle around it. OpenCV detects and
    decodes the markers. Lines are then fitted to the edges of the black rim, and the corners of a
    marker are their intersections. OpenCV's own corners have errors of half a pixel if a cell is
    only three pixels wide.
    """

    # Error of a corner, px, in images in which white is overexposed. Overexposure displaces edges
    # by some hundredths of a pixel. Without it, the error is 0.005 px.
    accuracy = 0.025

    marker: str | Mapping[str, Any] | MarkerChoice = parameter(
        "", help="marker or board of markers; if empty, the largest marker in view"
    )

    def __post_init__(self) -> None:
        marker = self.marker
        is_choice = isinstance(marker, MarkerChoice)
        self.choice = marker if is_choice else MarkerChoice.read(marker, "parameter ~marker")

    def find_normalised(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """Find the corners (4, 2), normalised, of the marker or of the rectangle around the board.
        """
        return self.track(grey, camera).points

    def track(
        self, grey: NDArray[np.uint8], camera: CameraModel,
        world_T_camera: np.ndarray | None = None, depth: NDArray[np.float32] | None = None,
    ) -> TrackedPoints:  # fmt: skip
        """Find the corners in the next image, as `Tracker.track` does."""
        found, scale = self.choice.detect(grey), camera.pinhole.fx
        corners, spreads = [], []
        for one in found:
            x, y, _ = camera.normalise(*one.corners.T.astype(float))
            rough = scale * np.column_stack([x, y])
            fitted, sides = self._fit_corners(grey, camera, scale, rough, one.cells)
            corners.append(fitted / scale)
            spreads.append(compute_crossing_spread(sides) / scale)
        accuracy = self.accuracy / camera.K[0]
        if self.choice.board is None:
            return TrackedPoints(corners[0], None, accuracy, 0.0, found[0].name, spreads[0])
        places = np.concatenate([self.choice.compute_marker_corners(one.name) for one in found])
        rectangle = self.choice.compute_board_corners()
        H, _ = cv2.findHomography(places, np.concatenate(corners))
        if H is None:
            raise VisionError(
                f"{self.choice}: the visible markers do not determine its plane; check the "
                "markers' positions on the board"
            )
        # Ratio of the board's size to the size of the visible part. If markers are hidden, the
        # corners of the board are extrapolated, which increases their error by this factor.
        beyond = np.ptp(rectangle, axis=0).max() / np.ptp(places, axis=0).max()
        points = cv2.perspectiveTransform(rectangle[None], H)[0]
        return TrackedPoints(points, None, accuracy * max(beyond, 1.0))

    def _fit_corners(
        self, grey: np.ndarray, camera: CameraModel, scale: float, corners: np.ndarray, cells: int
    ) -> tuple[np.ndarray, list[FittedLine]]:
        """Fit lines to the edges of a marker's black rim and intersect them.

        Args:
            grey: (rows, columns) image.
            camera: intrinsics and distortion.
            scale: px of the undistorted image per normalised length of 1.
            corners: (4, 2) rough corners of the rim, px of the undistorted image.
            cells: number of cells across the marker.

        Returns:
            The corners (4, 2), px of the undistorted image; and the four lines. Line k leads from
            corner k to the next corner.
        """
        for _ in range(RIM_FITS):
            lines, sides = [], []
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                length = float(np.linalg.norm(end - start))
                direction = (end - start) / length
                normal = np.array([direction[1], -direction[0]])
                if (start - corners.mean(axis=0)) @ normal < 0.0:
                    normal = -normal
                reach = min(max(RIM_REACH[0], RIM_REACH[1] * length / cells), RIM_MAX_REACH)
                across = np.linspace(-reach, reach, 2 * round(reach / RIM_STEP) + 1)
                count = int(np.clip(RIM_PART * length / RIM_SPACING, *RIM_STATIONS))
                stations = start + np.linspace(0.1, 0.9, count)[:, None] * (end - start)
                values = self._sample_profiles(grey, camera, scale, stations, normal, across)
                ends = max(len(across) // 8, 1)
                black, white = values[:, :ends].mean(), values[:, -ends:].mean()
                if white - black < MIN_CONTRAST:
                    raise VisionError(
                        f"the surroundings of the marker are only {white - black:.0f} grey levels "
                        f"brighter than its black rim, must be {MIN_CONTRAST:.0f} levels brighter; "
                        "use more light or a white margin"
                    )
                # The sum of the darkness along a profile is the length of its black part, which
                # determines the position of the edge even if the edge is blurred.
                darkness = (white - values) / (white - black)
                edge_offset = np.trapezoid(darkness, across, axis=1) - reach
                edge = stations + edge_offset[:, None] * normal
                place, (dx, dy) = line = self._fit_robust_line(edge)
                lines.append(line)
                near = edge[self._is_near(edge, *place, dx, dy)]
                # Profiles less than one pixel apart have correlated errors, so they do not count as
                # separate points.
                count = min(float(len(near)), RIM_PART * length)
                sides.append(FittedLine.fit(near, np.array([-dy, dx]), count))
            corners = self._intersect_lines(lines)
        return corners, sides
