"""ArUco and AprilTag markers, and boards of them."""

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

MIN_CONTRAST = 20.0  # grey levels between a marker's rim and what is around it
# Of a marker's rim: how often its edges are fitted, and the profiles across one: how many, px
# between two, px and cells that they reach to either side (beyond half a cell, so that black and
# white are seen, and not to the next cell), px between their samples.
RIM_FITS, RIM_STATIONS, RIM_SPACING = 2, (24, 64), 0.5
RIM_PART = 0.8  # of a side that profiles cross
RIM_REACH, RIM_MAX_REACH, RIM_STEP = (1.5, 0.6), 8.0, 0.4


@TRACKERS.register("marker")
@dataclass(eq=False)
class MarkerTracker(EdgeTracker):
    """The four corners of an ArUco or AprilTag marker, from its own first one, clockwise.

    OpenCV finds and reads it; its corners are then where lines through the edges of its black rim
    meet, for OpenCV's own refinements are off by half a pixel where a cell has three.
    """

    # In pictures whose white is not brighter than white 0.005; where it is, edges of black move by
    # some hundredths of a pixel, each by where it lies on the texture's texels.
    accuracy = 0.025

    marker: str | Mapping[str, Any] | MarkerChoice = parameter(
        "", help="which marker, or a board of several; empty: the largest in view"
    )

    def __post_init__(self) -> None:
        given = self.marker
        chosen = isinstance(given, MarkerChoice)
        self.choice = given if chosen else MarkerChoice.read(given, "parameter ~marker")

    def find_normalised(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """See Tracker.places; of a board the corners of the rectangle about its markers."""
        return self.track(grey, camera).points

    def track(
        self, grey: NDArray[np.uint8], camera: CameraModel,
        world_T_camera: np.ndarray | None = None, depth: NDArray[np.float32] | None = None,
    ) -> TrackedPoints:  # fmt: skip
        """See Tracker.look."""
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
            raise VisionError(f"{self.choice}: its markers in view lie on no plane")
        # Corners that lie far beyond the visible markers are as much less accurate.
        beyond = np.ptp(rectangle, axis=0).max() / np.ptp(places, axis=0).max()
        points = cv2.perspectiveTransform(rectangle[None], H)[0]
        return TrackedPoints(points, None, accuracy * max(beyond, 1.0))

    def _fit_corners(
        self, grey: np.ndarray, camera: CameraModel, scale: float, corners: np.ndarray, cells: int
    ) -> tuple[np.ndarray, list[FittedLine]]:
        """Corners (4, 2) of the black rim, from rough ones, px of the picture without the lens; and
        its sides, each of which begins at its corner."""
        for _ in range(RIM_FITS):
            lines, sides = [], []
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                length = float(np.linalg.norm(end - start))
                way = (end - start) / length
                out = np.array([way[1], -way[0]])
                if (start - corners.mean(axis=0)) @ out < 0.0:
                    out = -out
                reach = min(max(RIM_REACH[0], RIM_REACH[1] * length / cells), RIM_MAX_REACH)
                across = np.linspace(-reach, reach, 2 * round(reach / RIM_STEP) + 1)
                count = int(np.clip(RIM_PART * length / RIM_SPACING, *RIM_STATIONS))
                stations = start + np.linspace(0.1, 0.9, count)[:, None] * (end - start)
                values = self._sample_profiles(grey, camera, scale, stations, out, across)
                ends = max(len(across) // 8, 1)
                black, white = values[:, :ends].mean(), values[:, -ends:].mean()
                if white - black < MIN_CONTRAST:
                    raise VisionError("the marker has no contrast to what is around it")
                # What is black of a profile ends at the edge, however soft that is.
                dark = (white - values) / (white - black)
                covered = np.trapezoid(dark, across, axis=1) - reach
                edge = stations + covered[:, None] * out
                place, (dx, dy) = self._fit_robust_line(edge)
                lines.append((place, np.array([dx, dy])))
                near = edge[self._near(edge, *place, dx, dy)]
                # Profiles less than a pixel apart err alike.
                count = min(float(len(near)), RIM_PART * length)
                sides.append(FittedLine.fit(near, np.array([-dy, dx]), count))
            corners = self._intersect_lines(lines)
        return corners, sides
