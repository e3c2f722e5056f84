"""Tracker of the pose of a solid, which returns four points of the solid instead of the pose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.poses import inverse
from aras_visual_servo_base.settings import parameter

from ..camera_model import CameraModel
from ..errors import TrackingModelError, VisionError
from ..interaction import Plane
from ..model_tracker.solid import Solid, read_solid
from ..model_tracker.solid_tracking import SolidTracking
from .base import TRACKERS, TrackedPoints, Tracker
from .initial_pose import InitialPose

# Error of the points, px, added to the error that follows from the covariance of the pose.
BEST_ACCURACY = 0.01


@TRACKERS.register("model")
class ModelTracker(Tracker):
    """The corners of the horizontal rectangle through a solid's middle, from the solid's pose.

    With these points, control schemes for flat targets can be used with a solid. The method
    `Solid.compute_section_corners` returns the points in the solid's frame.

    Attributes:
        tracking: tracker of the pose; its `tracked_pose` is the pose in the last image.
    """

    model: str | Solid = parameter("", help="mesh file (STL, OBJ, DAE) of the target")
    model_start: Mapping[str, Any] | InitialPose = parameter({}, help="start pose of the target")
    model_scale: float = parameter(
        1.0, above=0.0, help="factor on the file's lengths, e.g. 0.001 for mm"
    )

    def __post_init__(self) -> None:
        start, solid = self.model_start, self.model
        self._start_pose = start if isinstance(start, InitialPose) else InitialPose(start)
        if not solid:
            raise TrackingModelError(
                "tracker 'model' needs the mesh of the target: set the parameter model to a file"
            )
        if not isinstance(solid, Solid):
            solid = read_solid(solid, self.model_scale)
        self.tracking = SolidTracking(solid)
        self.reset()

    def reset(self) -> None:
        """Forget all earlier images, so that the next image needs the start pose."""
        self.tracking.start(None)
        self._world_T_solid: np.ndarray | None = None

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Raise VisionError, because the pose depends on the calibration; use `track` instead."""
        raise VisionError("tracker 'model' needs the camera's calibration: call `track` instead of "
                          "`find`")

    def track(
        self, grey: NDArray[np.uint8], camera: CameraModel,
        world_T_camera: np.ndarray | None = None, depth: NDArray[np.float32] | None = None,
    ) -> TrackedPoints:  # fmt: skip
        """Find the points in the next image, as `Tracker.track` does.

        Raises:
            VisionError: the solid is lost, or its start pose cannot be computed.
        """
        tracking, expected = self.tracking, None
        if not tracking.is_started:
            tracking.start(self._start_pose.compute_camera_T_solid(grey, camera, world_T_camera))
        elif world_T_camera is not None and self._world_T_solid is not None:
            expected = inverse(world_T_camera) @ self._world_T_solid
        found = tracking.track(grey, camera, expected, depth)
        if found.loss_reason:
            if self._world_T_solid is None or self._start_pose.kind == "marker":
                tracking.start(None)  # so that the next image is tracked from the start pose
            raise VisionError(found.loss_reason)
        pose = found.camera_T_solid
        if world_T_camera is not None:
            self._world_T_solid = world_T_camera @ pose
        places = tracking.solid.compute_section_corners() @ pose[:3, :3].T + pose[:3, 3]
        deviation = math.sqrt(np.trace(found.covariance[:3, :3]) / 3.0) / pose[2, 3]
        return TrackedPoints(
            places[:, :2] / places[:, 2:], _compute_plane(pose, places),
            math.hypot(BEST_ACCURACY / camera.K[0], deviation),
            deviation * found.unrepeatable_part,
        )  # fmt: skip


def _compute_plane(pose: np.ndarray, points: np.ndarray) -> Plane | None:
    """Return the plane of the rectangle, whose normal is the z axis of the solid.

    Args:
        pose: (4, 4) camera_T_solid.
        points: (4, 3) corners of the rectangle in the camera's frame, m.

    Returns:
        The plane in the camera's frame; None if the camera is in this plane.
    """
    distance = float(pose[:3, 2] @ points[0])
    return Plane(*(pose[:3, 2] / distance).tolist()) if distance else None
