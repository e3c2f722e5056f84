"""Tracker of ArUco and AprilTag markers and of boards of markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.settings import parameter

from ..errors import VisionError
from ..line_fits import FittedLine, compute_crossing_spread
from ..markers import MarkerChoice
from ..undistortion import CameraModel
from .base import TRACKERS, TrackedPoints
from .edge_tracker import EdgeTracker

MIN_CONTRAST = 20.0  # grey levels between a marker's black rim and its surroundings
# Fit of the black rim: number of iterations; minimum and maximum number of profiles per edge;
# distance between two profiles, px.
RIM_FITS, RIM_STATIONS, RIM_SPACING = 2, (24, 64), 0.5
RIM_PART = 0.8  # fraction of a side that has profiles
# Half length of a profile: the larger of the two values of RIM_REACH (px, cells), but at most
# RIM_MAX_REACH (px). It is more than half a cell, to include black and white, and less than a cell.
# RIM_STEP is the distance between the samples, px.
RIM_REACH, RIM_MAX_REACH, RIM_STEP = (1.5, 0.6), 8.0, 0.4


@TRACKERS.register("marker")
@dataclass(eq=False)
class MarkerTracker(EdgeTracker):
    """The four corners of an ArUco or AprilTag marker, clockwise from the marker's first corner.

    OpenCV detects and decodes the marker. Its corners are then the intersections of lines that are
    fitted to the edges of the black rim, because OpenCV's refinement has errors of half a pixel if
    a cell is only three pixels wide.
    """

    # The error is 0.005 px in images without overexposed white. With overexposed white, black edges
    # move by some hundredths of a pixel, depending on their position on the texels of the texture.
    accuracy = 0.025

    marker: str | Mapping[str, Any] | MarkerChoice = parameter(
        "", help="marker, or board of markers; empty: the largest marker in view"
    )

    def __post_init__(self) -> None:
        marker = self.marker
        is_choice = isinstance(marker, MarkerChoice)
        self.choice = marker if is_choice else MarkerChoice.read(marker, "parameter ~marker")

    def find_normalised(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """Return the normalised corners of the marker, or of the rectangle around the board."""
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
            return TrackedPoints(
                corners[0], None, accuracy, marker=found[0].name, spread=spreads[0]
            )
        places = np.concatenate([self.choice.compute_marker_corners(one.name) for one in found])
        rectangle = self.choice.compute_board_corners()
        H, _ = cv2.findHomography(places, np.concatenate(corners))
        if H is None:
            raise VisionError(f"{self.choice}: its markers in view do not fit a plane")
        # The error of corners outside the visible markers grows with the extrapolation.
        beyond = np.ptp(rectangle, axis=0).max() / np.ptp(places, axis=0).max()
        points = cv2.perspectiveTransform(rectangle[None], H)[0]
        return TrackedPoints(points, None, accuracy * max(beyond, 1.0))

    def _fit_corners(
        self, grey: np.ndarray, camera: CameraModel, scale: float, corners: np.ndarray, cells: int
    ) -> tuple[np.ndarray, list[FittedLine]]:
        """Fit the corners (4, 2) of the black rim, starting from rough ones.

        Positions are in px of the undistorted image.

        Returns:
            The corners, and the four sides, each of which starts at its corner.
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
                    raise VisionError("the marker has no contrast to its surroundings")
                # The length of the black part of a profile gives the edge, even if it is blurred.
                darkness = (white - values) / (white - black)
                edge_offset = np.trapezoid(darkness, across, axis=1) - reach
                edge = stations + edge_offset[:, None] * normal
                place, (dx, dy) = self._fit_robust_line(edge)
                lines.append((place, np.array([dx, dy])))
                near = edge[self._is_near(edge, *place, dx, dy)]
                # Profiles less than a pixel apart have the same errors.
                count = min(float(len(near)), RIM_PART * length)
                sides.append(FittedLine.fit(near, np.array([-dy, dx]), count))
            corners = self._intersect_lines(lines)
        return corners, sides
