"""Points of special targets in a picture: dots, corners of markers, crossings of lines. By OpenCV.

Points are found as pixels, and the lens is taken off afterwards; lines are bent by a lens, so it is
taken off before they are fitted. `numbered` says whether a point is known by itself (a marker's
corners) or by its place in the ring alone (dots, crossings).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import VisionError
from .interaction import Plane
from .markers import MarkerChoice
from .segmentation import borders
from .undistortion import CameraModel

SMALLEST_DOT = 4  # pixels: of less, no centre can be had
# Area of a dot over that of the ellipse in its box: least, most (an upright rectangle has 1.27),
# and least of one of so few pixels that they shape it; how long it may be for its width.
ROUND, SQUARE, COARSE, COARSELY, LONG = 0.8, 1.15, 60, 0.6, 4.0
RIM, FADED = 3, 1.5  # pixels about a dot in which the ground is seen, and in which it fades
LEAST_CONTRAST = 20.0  # grey levels between a marker's rim and what is around it
DOT_FITS = 2  # the ellipse about a dot is put about its centre
SMALLEST_DRAWING = 400  # pixels of the rectangle about a drawing of lines
THICKEST = 0.2  # of a line's width over the size of the drawing
SOLID = "what bounds the dark drawing is no line: use tracker 'outline'"
STATIONS, FEWEST = 48, 10  # profiles across a line, and of them those that must show it alone
# Of a marker's rim: how often its edges are fitted, and the profiles across one: how many, px
# between two, px and cells that they reach to either side (beyond half a cell, so that black and
# white are seen, and not to the next cell), px between their samples.
RIM_FITS, RIM_STATIONS, RIM_SPACED = 2, (24, 64), 0.5
RIM_REACH, RIM_FURTHEST, RIM_STEP = (1.5, 0.6), 8.0, 0.4
OUTLYING = 1.0  # px from a line beyond which a point is none of it


class TrackedPoints(NamedTuple):
    """What a tracker finds in a picture.

    points: (n, 2) normalised. plane: of the target, where it tells that. accuracy: normalised
    length to which the points are found. unshared: the part of it in which another picture from the
    same place, as the goal's, may differ. marker: `DICTIONARY:number` of the marker that they are.
    """

    points: np.ndarray
    plane: Plane | None
    accuracy: float
    unshared: float = 0.0
    marker: str = ""


class Tracker(ABC):
    """Base: give `find`.

    Attributes:
        numbered: whether a point is known by itself.
        accuracy: px to which points are found in the arm's pictures without noise.
    """

    numbered: ClassVar[bool] = True
    accuracy: ClassVar[float] = 0.01

    @abstractmethod
    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Points (n, 2) in a picture (rows, columns), px (column, row).

        Raises:
            VisionError: they are not to be seen.
        """

    def places(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """The same points (n, 2), normalised and without the lens; VisionError as `find`."""
        x, y, _ = camera.normalise(*self.find(grey).T)
        return np.column_stack([x, y])

    def look(
        self, grey: NDArray[np.uint8], camera: CameraModel,
        world_T_camera: np.ndarray | None = None, depth: NDArray[np.float32] | None = None,
    ) -> TrackedPoints:  # fmt: skip
        """All that is found in the next picture of a loop; VisionError as `find`.

        Args:
            world_T_camera: (4, 4), where it is known. depth: (rows, columns) m, where there is one.
        """
        return TrackedPoints(self.places(grey, camera), None, self.accuracy / camera.K[0])

    def reset(self) -> None:
        """Forget earlier pictures."""


class DotTracker(Tracker):
    """Centres of dark round dots on a lighter ground, in order of angle about their middle.

    A centre is weighted by darkness, so it is found to a hundredth of a pixel; it is that of the
    dot's image, which for a large dot seen askew is not quite the image of its centre.
    """

    numbered = False
    accuracy = 0.005

    def __init__(self, count: int = 4) -> None:
        self.count = count

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """See Tracker.find; the largest `count` dots."""
        level, mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
        found, _, stats, _ = cv2.connectedComponentsWithStats(mask)
        dots = []
        for left, top, width, height, area in stats[1:found]:
            full = np.pi / 4.0 * width * height
            long = max(width, height) > LONG * min(width, height)
            if area > COARSE:
                dotlike = ROUND * full < area < SQUARE * full
            else:
                dotlike = area >= SMALLEST_DOT and area > COARSELY * full
            if dotlike and not (borders((left, top, width, height), grey.shape) or long):
                dots.append((int(area), left, top, width, height))
        if len(dots) < self.count:
            raise VisionError(
                f"{len(dots)} of {self.count} dots are in view: are they dark, round and apart?"
            )
        dots.sort(reverse=True)
        return _ring(np.array([self._centre(grey, *dot[1:]) for dot in dots[: self.count]]))

    @staticmethod
    def _centre(grey: np.ndarray, left: int, top: int, width: int, height: int) -> tuple:
        low_u, low_v = max(left - RIM, 0), max(top - RIM, 0)
        part = grey[low_v : top + height + RIM, low_u : left + width + RIM].astype(float)
        v, u = np.indices(part.shape)
        middle = left - low_u + 0.5 * (width - 1), top - low_v + 0.5 * (height - 1)
        for _ in range(DOT_FITS):
            away = ((u - middle[0]) / (0.5 * width + FADED)) ** 2 + (
                (v - middle[1]) / (0.5 * height + FADED)
            ) ** 2
            dark = np.where(away <= 1.0, np.median(part[away > 1.0]) - part, 0.0)
            middle = (dark * u).sum() / dark.sum(), (dark * v).sum() / dark.sum()
        return low_u + float(middle[0]), low_v + float(middle[1])


class EdgeTracker(Tracker):
    """Base of trackers that fit straight lines, which a lens bends: give `places`."""

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """See Tracker.find; of a picture without a lens, or with the lens taken off."""
        rows, columns = grey.shape
        return self.places(grey, CameraModel(columns, rows, (1, 0, 0, 0, 1, 0, 0, 0, 1)))

    @staticmethod
    def _profiles(
        grey: np.ndarray, camera: CameraModel, scale: float, stations: np.ndarray,
        normal: np.ndarray, across: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Grey levels (n, m) at `across` (m,) along the normal (2,) from stations (n, 2); px of the
        picture without the lens, `scale` of them to a normalised length of 1."""
        places = stations[:, None] + across[:, None] * normal
        u, v = camera.project(*(places.reshape(-1, 2).T / scale))
        return _between(grey, u, v).reshape(places.shape[:2])

    @staticmethod
    def _line(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A point (2,) and the direction (2,) of the line through points (n, 2), px, but for those
        that lie off it."""
        middle = points.mean(axis=0)
        dx, dy, x, y = _fit_line(points - middle, cv2.DIST_HUBER)
        near = np.abs((points - middle - (x, y)) @ (-dy, dx)) < OUTLYING
        if near.sum() > 1:  # Huber's fit ends some hundredths of a pixel early
            dx, dy, x, y = _fit_line((points - middle)[near], cv2.DIST_L2)
        return middle + (x, y), np.array([dx, dy])

    @staticmethod
    def _crossings(lines: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Where each line (point, direction) meets the one before it (n, 2)."""
        whole = np.array([(-dy, dx, x * dy - y * dx) for (x, y), (dx, dy) in lines])
        crossings = np.cross(np.roll(whole, 1, axis=0), whole)
        return crossings[:, :2] / crossings[:, 2:]


class MarkerTracker(EdgeTracker):
    """The four corners of an ArUco or AprilTag marker, from its own first one, clockwise.

    OpenCV finds and reads it; its corners are then where lines through the edges of its black rim
    meet, for OpenCV's own refinements are off by half a pixel where a cell has three.
    """

    # In pictures whose white is not brighter than white 0.005; where it is, edges of black move by
    # some hundredths of a pixel, each by where it lies on the texture's texels.
    accuracy = 0.025

    def __init__(self, choice: MarkerChoice | None = None) -> None:
        """`choice`: which marker, or a board of several; None: the largest in view."""
        self.choice = choice if choice is not None else MarkerChoice()

    def places(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """See Tracker.places; of a board the corners of the rectangle about its markers."""
        return self.look(grey, camera).points

    def look(
        self, grey: NDArray[np.uint8], camera: CameraModel,
        world_T_camera: np.ndarray | None = None, depth: NDArray[np.float32] | None = None,
    ) -> TrackedPoints:  # fmt: skip
        """See Tracker.look."""
        found, scale = self.choice.find(grey), camera.pinhole.fx
        corners = []
        for one in found:
            x, y, _ = camera.normalise(*one.corners.T.astype(float))
            rough = scale * np.column_stack([x, y])
            corners.append(self._fitted(grey, camera, scale, rough, one.cells) / scale)
        accuracy = self.accuracy / camera.K[0]
        if self.choice.board is None:
            return TrackedPoints(corners[0], None, accuracy, marker=found[0].name)
        places = np.concatenate([self.choice.corners_on_board(one.name) for one in found])
        rectangle = self.choice.board_corners()
        H, _ = cv2.findHomography(places, np.concatenate(corners))
        if H is None:
            raise VisionError(f"{self.choice}: its markers in view lie on no plane")
        # Corners that lie far beyond the visible markers are as much less accurate.
        beyond = np.ptp(rectangle, axis=0).max() / np.ptp(places, axis=0).max()
        points = cv2.perspectiveTransform(rectangle[None], H)[0]
        return TrackedPoints(points, None, accuracy * max(beyond, 1.0))

    def _fitted(
        self, grey: np.ndarray, camera: CameraModel, scale: float, corners: np.ndarray, cells: int
    ) -> np.ndarray:
        """Corners (4, 2) of the black rim, from rough ones; px of the picture without the lens."""
        for _ in range(RIM_FITS):
            lines = []
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                length = float(np.linalg.norm(end - start))
                way = (end - start) / length
                out = np.array([way[1], -way[0]])
                if (start - corners.mean(axis=0)) @ out < 0.0:
                    out = -out
                reach = min(max(RIM_REACH[0], RIM_REACH[1] * length / cells), RIM_FURTHEST)
                across = np.linspace(-reach, reach, 2 * round(reach / RIM_STEP) + 1)
                count = int(np.clip(0.8 * length / RIM_SPACED, *RIM_STATIONS))
                stations = start + np.linspace(0.1, 0.9, count)[:, None] * (end - start)
                values = self._profiles(grey, camera, scale, stations, out, across)
                ends = max(len(across) // 8, 1)
                black, white = values[:, :ends].mean(), values[:, -ends:].mean()
                if white - black < LEAST_CONTRAST:
                    raise VisionError("the marker has no contrast to what is around it")
                # What is black of a profile ends at the edge, however soft that is.
                dark = (white - values) / (white - black)
                covered = np.trapezoid(dark, across, axis=1) - reach
                lines.append(self._line(stations + covered[:, None] * out))
            corners = self._crossings(lines)
        return corners


class LineTracker(EdgeTracker):
    """The four outermost lines of a dark drawing (a grid, a frame), as the crossings of neighbours.

    Each line is fitted to the middles of profiles across it, weighted by darkness, where no other
    line crosses; to a few hundredths of a pixel, through any lens.
    """

    numbered = False

    def places(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """See Tracker.places; in order of angle about their middle."""
        scale = camera.pinhole.fx  # a pixel of the picture without a lens: 1 / fx
        rough, width = self._rough(grey, camera, scale)
        lines = []
        for start, end in zip(rough, np.roll(rough, -1, axis=0), strict=True):
            # The rough side is the drawing's rim, half a line's width outside of its middle.
            for reach in (1.5 * width + 3.0, width + 2.0):
                points, direction = self._fitted(grey, camera, scale, (start, end), reach)
                along = (np.array([start, end]) - points) @ direction
                start, end = points + along[:, None] * direction
            lines.append((points, direction))
        return _ring(self._crossings(lines)) / scale

    @staticmethod
    def _rough(grey: np.ndarray, camera: CameraModel, scale: float) -> tuple[np.ndarray, float]:
        """Corners (4, 2) of the drawing's rim, and its lines' width, px without the lens."""
        _, mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
        found, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
        sizes = stats[1:, cv2.CC_STAT_WIDTH] * stats[1:, cv2.CC_STAT_HEIGHT]
        if found < 2 or sizes.max() < SMALLEST_DRAWING:
            raise VisionError("no dark lines are in view")
        largest = 1 + int(np.argmax(sizes))
        if borders(stats[largest, :4], grey.shape):
            raise VisionError("the lines touch the picture's border: not all of them are in view")
        drawn = np.where(labels == largest, mask, 0).astype(np.uint8)
        rim = max(cv2.findContours(drawn, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=len)
        x, y, valid = camera.normalise(*rim.reshape(-1, 2).T.astype(float))
        if not valid.all():
            raise VisionError("the lines reach beyond the lens's model")
        hull = cv2.convexHull((scale * np.column_stack([x, y])).astype(np.float32))
        for part in (0.01, 0.02, 0.03, 0.05, 0.08):
            corners = cv2.approxPolyDP(hull, part * cv2.arcLength(hull, True), True)
            if len(corners) <= 4:
                break
        if len(corners) != 4:
            raise VisionError(f"{len(corners)} lines, not four, bound what is dark in view")
        thick = 2.0 * float(cv2.distanceTransform(drawn, cv2.DIST_L2, 3).max())
        if thick > THICKEST * np.sqrt(cv2.contourArea(hull)):
            raise VisionError(SOLID)
        return corners.reshape(4, 2).astype(float), thick

    def _fitted(
        self, grey: np.ndarray, camera: CameraModel, scale: float,
        side: tuple[np.ndarray, np.ndarray], reach: float,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """A point (2,) of the line and its direction (2,), from profiles `reach` px either side."""
        start, end = side
        way = (end - start) / np.linalg.norm(end - start)
        across = np.arange(-reach, reach + 0.25, 0.5)
        stations = start + np.linspace(0.06, 0.94, STATIONS)[:, None] * (end - start)
        normal = np.array([-way[1], way[0]])
        values = self._profiles(grey, camera, scale, stations, normal, across)
        dark = np.clip(np.percentile(values, 95) - values, 0.0, None)
        dark[dark < 0.1 * dark.max()] = 0.0
        total = dark.sum(axis=1)
        ends = np.maximum(dark[:, 0], dark[:, -1]) < 0.3 * dark.max()
        good = ends & (total > 0.0)
        if good.sum() >= FEWEST:  # a profile along a crossing line holds more than the others
            usual = np.median(total[good])
            good &= np.abs(total - usual) < 0.25 * usual
        if good.sum() < FEWEST:
            raise VisionError(SOLID)
        middle = (dark[good] @ across) / total[good]
        return self._line(stations[good] + middle[:, None] * normal)


def _between(grey: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Grey levels (n,) at pixels (u, v) (n,), bilinear; OpenCV knows only 32nds of a pixel."""
    rows, columns = grey.shape
    u, v = np.clip(u, 0.0, columns - 1.0), np.clip(v, 0.0, rows - 1.0)
    i, j = np.minimum(u.astype(int), columns - 2), np.minimum(v.astype(int), rows - 2)
    right, down = u - i, v - j
    above = grey[j, i] * (1.0 - right) + grey[j, i + 1] * right
    below = grey[j + 1, i] * (1.0 - right) + grey[j + 1, i + 1] * right
    return above * (1.0 - down) + below * down


def _fit_line(points: np.ndarray, kind: int) -> np.ndarray:
    """dx, dy, x, y of OpenCV's line through points (n, 2)."""
    return cv2.fitLine(points.astype(np.float32), kind, 0.0, 1e-4, 1e-4).ravel().astype(float)


def _ring(points: np.ndarray) -> np.ndarray:
    """Points (n, 2) in order of angle about their middle."""
    offset = points - points.mean(axis=0)
    return points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]


TRACKERS: dict[str, type[Tracker] | None] = {
    "outline": None, "dots": DotTracker, "marker": MarkerTracker, "lines": LineTracker,
}  # fmt: skip
