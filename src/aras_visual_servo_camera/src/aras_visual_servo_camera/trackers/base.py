"""Base class and registry of the trackers, which find the points of a target in an image.

Points are found in pixels, and lens distortion is removed afterwards. A lens bends straight lines,
so distortion is removed before lines are fitted. `is_numbered` states if a point is identified by
itself (corners of a marker) or only by its place in the ring of points (dots, line crossings).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.registry import Registry

from ..errors import VisionError
from ..interaction import Plane
from ..undistortion import CameraModel


class TrackedPoints(NamedTuple):
    """Points that a tracker finds in an image.

    points: (n, 2) normalised.
    plane: plane of the target, if the tracker determines it.
    accuracy: error of the points, a normalised length.
    repeatability: the part of this error that can differ in another image from the same place.
    marker: `DICTIONARY:number` of the marker that the points belong to.
    spread: (2n, m) effects of independent errors, each of one standard deviation, on x_0, y_0, x_1,
    ...,
        from the scatter of edges about their lines; None if unknown.
    """

    points: np.ndarray
    plane: Plane | None
    accuracy: float
    repeatability: float = 0.0
    marker: str = ""
    spread: np.ndarray | None = None


class Tracker(ABC):
    """Base class of trackers, which find points of the target in an image.

    The points are treated as the target's corners. A subclass implements `find` and is selected by
    'package.module:Class'. If it has parameters, it is a dataclass, and they are its fields.

    Attributes:
        name: short name.
        is_numbered: True if each point is identified by itself.
        accuracy: error of the points in noise-free images of the simulated arm, px.
    """

    name: ClassVar[str] = ""
    is_numbered: ClassVar[bool] = True
    accuracy: ClassVar[float] = 0.01

    @abstractmethod
    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Find the points (n, 2), px (column, row), in an image (rows, columns).

        Raises:
            VisionError: the points are not visible.
        """

    def find_normalised(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """Find the points (n, 2) and return them normalised, without lens distortion.

        Raises:
            VisionError: the points are not visible.
        """
        x, y, _ = camera.normalise(*self.find(grey).T)
        return np.column_stack([x, y])

    def track(
        self, grey: NDArray[np.uint8], camera: CameraModel,
        world_T_camera: np.ndarray | None = None, depth: NDArray[np.float32] | None = None,
    ) -> TrackedPoints:  # fmt: skip
        """Find the points in the next image of a servo loop.

        Args:
            grey: (rows, columns) image.
            camera: intrinsics and distortion.
            world_T_camera: (4, 4) pose of the camera, if known.
            depth: (rows, columns) depth image, m, if there is one.

        Raises:
            VisionError: the points are not visible.
        """
        return TrackedPoints(self.find_normalised(grey, camera), None, self.accuracy / camera.K[0])

    def reset(self) -> None:
        """Forget earlier images."""


def sort_by_angle(points: np.ndarray) -> np.ndarray:
    """Sort points (n, 2) by their angle about their middle."""
    offset = points - points.mean(axis=0)
    return points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]


TRACKERS = Registry("tracker", __package__, (Tracker,), VisionError)
