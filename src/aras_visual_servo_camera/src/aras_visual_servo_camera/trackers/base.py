"""Base class and registry of the trackers, which find the points of a target in an image.

By default, a tracker finds points in px, from which the lens distortion is then removed. Trackers
that fit lines remove the distortion before the fit, because a lens bends straight lines.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.registry import Registry
from aras_visual_servo_base.settings import check

from ..camera_model import CameraModel
from ..errors import VisionError
from ..interaction import Plane


class TrackedPoints(NamedTuple):
    """Points that a tracker finds in an image.

    Attributes:
        points: (n, 2) points, normalised.
        plane: plane of the target; None if the tracker does not determine it.
        accuracy: standard deviation of the points' error, a normalised length.
        repeatability: standard deviation of the part of the error that changes from image to image
            even if the camera is at rest, a normalised length.
        marker: `DICTIONARY:number` of the marker to which the points belong; '' for none.
        spread: (2n, m) array S, where S S^T is the covariance of the coordinates (x_0, y_0, x_1,
            ...), normalised; None if it is unknown.
    """

    points: np.ndarray
    plane: Plane | None
    accuracy: float
    repeatability: float = 0.0
    marker: str = ""
    spread: np.ndarray | None = None


class Tracker(ABC):
    """Base class of trackers, which find points of the target in an image.

    Schemes use these points as the target's corners. A subclass implements `find`. The user selects
    a subclass by 'package.module:Class'. Every tracker is a dataclass: its parameters are annotated
    attributes, or are declared with unit and bounds by `parameter`.

    Attributes:
        name: short name of the tracker.
        is_numbered: True if each point can be identified; False if only the cyclic order of the
            points is known.
        has_colour: True if images are passed as RGB (rows, columns, 3); False if they are passed as
            grey levels (rows, columns).
        accuracy: error of the points, px, measured in noise-free simulated images.
    """

    name: ClassVar[str] = ""
    is_numbered: ClassVar[bool] = True
    has_colour: ClassVar[bool] = False
    accuracy: ClassVar[float] = 0.01

    def __init_subclass__(cls, **options: Any) -> None:
        """Make the subclass a dataclass, and set its `name` to the name of the class."""
        super().__init_subclass__(**options)
        cls.name = cls.__name__
        dataclass(eq=False)(cls)

    def __post_init__(self) -> None:
        check(self, VisionError, f"tracker {self.name}: ")

    @abstractmethod
    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Find the points in an image.

        Args:
            grey: (rows, columns) image; (rows, columns, 3) RGB if `has_colour`.

        Returns:
            (n, 2) points, px (column, row).

        Raises:
            VisionError: the points are not visible.
        """

    def find_normalised(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """Find the points in an image and remove the lens distortion.

        Args:
            grey: (rows, columns) image; (rows, columns, 3) RGB if `has_colour`.
            camera: intrinsics and distortion.

        Returns:
            (n, 2) points, normalised.

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
            grey: (rows, columns) image; (rows, columns, 3) RGB if `has_colour`.
            camera: intrinsics and distortion.
            world_T_camera: (4, 4) pose of the camera; None if it is unknown.
            depth: (rows, columns) depth image, m; None if there is none.

        Raises:
            VisionError: the points are not visible.
        """
        return TrackedPoints(self.find_normalised(grey, camera), None, self.accuracy / camera.K[0])

    def reset(self) -> None:
        """Forget all earlier images."""


def sort_by_angle(points: np.ndarray) -> np.ndarray:
    """Return points (n, 2) sorted by their angle about their mean."""
    offset = points - points.mean(axis=0)
    return points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]


TRACKERS = Registry("tracker", __package__, (Tracker,), VisionError)
