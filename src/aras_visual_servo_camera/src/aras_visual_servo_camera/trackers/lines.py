"""Tracker of the four outermost lines of a dark drawing."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..camera_model import CameraModel
from ..errors import VisionError
from ..segmented_target import find_touched_borders
from .base import TRACKERS, sort_by_angle
from .edge_tracker_base import EdgeTrackerBase

MIN_DRAWING_AREA = 400  # smallest area of a line drawing's bounding box, pixels
MAX_LINE_WIDTH = 0.2  # largest width of a drawn line, as a fraction of the drawing's size
SOLID_TARGET_REASON = "the dark drawing is not bounded by lines: use tracker 'outline'"
# Number of profiles across a drawn line, and smallest number of profiles that contain only this
# line.
PROFILE_COUNT, MIN_PROFILES = 48, 10


@TRACKERS.register("lines")
class LineTracker(EdgeTrackerBase):
    """The intersections of the four outermost lines of a dark drawing, such as a grid or a frame.

    Profiles of grey levels are sampled across each drawn line. On each profile, the middle of the
    drawn line is the mean of the samples' positions, weighted by darkness. A straight line is
    fitted to these middles. Profiles that contain another drawn line are not used. The error is a
    few hundredths of a pixel for any lens.
    """

    is_numbered = False

    def find_normalised(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """Find the intersections (4, 2) of the lines, normalised, sorted by angle about their mean.
        """
        scale = camera.pinhole.fx  # px of the undistorted image per normalised length of 1
        rough, width = self._find_rough_corners(grey, camera, scale)
        lines = []
        for start, end in zip(rough, np.roll(rough, -1, axis=0), strict=True):
            # The middle of a drawn line is searched half a line width inside its outer edge. In the
            # second round, the line is already known from the first, so the search range is
            # smaller.
            for reach in (1.5 * width + 3.0, width + 2.0):
                points, direction = self._fit_side(grey, camera, scale, (start, end), reach)
                along = (np.array([start, end]) - points) @ direction
                start, end = points + along[:, None] * direction
            lines.append((points, direction))
        return sort_by_angle(self._intersect_lines(lines)) / scale

    @staticmethod
    def _find_rough_corners(
        grey: np.ndarray, camera: CameraModel, scale: float
    ) -> tuple[np.ndarray, float]:
        """Return the corners (4, 2) of the drawing's outline, and the width of its lines.

        The corners are in px of the undistorted image, the width is in px of the image.
        """
        _, mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
        found, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
        sizes = stats[1:, cv2.CC_STAT_WIDTH] * stats[1:, cv2.CC_STAT_HEIGHT]
        if found < 2 or sizes.max() < MIN_DRAWING_AREA:
            raise VisionError("no dark drawing is in view; move the camera or improve the contrast")
        largest = 1 + int(np.argmax(sizes))
        if find_touched_borders(stats[largest, :4], grey.shape):
            raise VisionError(
                "the dark drawing touches the border of the image: move it completely into view"
            )
        drawing = np.where(labels == largest, mask, 0).astype(np.uint8)
        rim = max(cv2.findContours(drawing, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=len)
        x, y, valid = camera.normalise(*rim.reshape(-1, 2).T.astype(float))
        if not valid.all():
            raise VisionError(
                "the dark drawing extends beyond the range of the lens model; move it towards the "
                "middle of the image"
            )
        hull = cv2.convexHull((scale * np.column_stack([x, y])).astype(np.float32))
        for part in (0.01, 0.02, 0.03, 0.05, 0.08):
            corners = cv2.approxPolyDP(hull, part * cv2.arcLength(hull, True), True)
            if len(corners) <= 4:
                break
        if len(corners) != 4:
            raise VisionError(
                f"{len(corners)} lines bound the dark drawing, must be 4: use a frame or a grid "
                "with four sides"
            )
        line_width = 2.0 * float(cv2.distanceTransform(drawing, cv2.DIST_L2, 3).max())
        if line_width > MAX_LINE_WIDTH * np.sqrt(cv2.contourArea(hull)):
            raise VisionError(SOLID_TARGET_REASON)
        return corners.reshape(4, 2).astype(float), line_width

    def _fit_side(
        self, grey: np.ndarray, camera: CameraModel, scale: float,
        side: tuple[np.ndarray, np.ndarray], search_range: float,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Fit a line to one side of the drawing.

        Args:
            grey: (rows, columns) image.
            camera: intrinsics and distortion.
            scale: px of the undistorted image per normalised length of 1.
            side: rough start and end (2,) of the side, px of the undistorted image.
            search_range: largest distance of the line from the rough side, px.

        Returns:
            A point (2,) on the line, px of the undistorted image, and its direction (2,).
        """
        start, end = side
        direction = (end - start) / np.linalg.norm(end - start)
        across = np.arange(-search_range, search_range + 0.25, 0.5)
        stations = start + np.linspace(0.06, 0.94, PROFILE_COUNT)[:, None] * (end - start)
        normal = np.array([-direction[1], direction[0]])
        values = self._sample_profiles(grey, camera, scale, stations, normal, across)
        darkness = np.clip(np.percentile(values, 95) - values, 0.0, None)
        darkness[darkness < 0.1 * darkness.max()] = 0.0
        total = darkness.sum(axis=1)
        is_isolated = np.maximum(darkness[:, 0], darkness[:, -1]) < 0.3 * darkness.max()
        good = is_isolated & (total > 0.0)
        # Reject profiles whose darkness differs from the median, because they contain another line.
        if good.sum() >= MIN_PROFILES:
            typical = np.median(total[good])
            good &= np.abs(total - typical) < 0.25 * typical
        if good.sum() < MIN_PROFILES:
            raise VisionError(SOLID_TARGET_REASON)
        middle = (darkness[good] @ across) / total[good]
        return self._fit_robust_line(stations[good] + middle[:, None] * normal)
