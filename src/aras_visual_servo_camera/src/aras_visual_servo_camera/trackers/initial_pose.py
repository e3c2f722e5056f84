"""Pose of a solid in the first image, from a pose in the world, a marker, or clicked points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy

from ..camera_model import CameraModel
from ..errors import TrackingModelError, VisionError
from ..markers import MarkerChoice, make_square
from .marker import MarkerTracker

START_FORMS = (
    "pose: [x, y, z, roll, pitch, yaw], marker: {size, pose}, or clicks: [[x, y, z, u, v], ...]"
)


class InitialPose:
    """Start pose of a solid, from a parameter with one of three keys.

    - `pose`: x, y, z, roll, pitch, yaw of the solid in the frame of the arm's base (the world), m
      and rad.
    - `marker`: an ArUco or AprilTag marker on the solid. `size` is the side of its black square, m.
      `pose` is the pose of its middle in the solid's frame; x is to the right and y is up when the
      marker is upright. `number` is a choice as in MarkerChoice, by default the largest visible
      marker.
    - `clicks`: at least four rows x, y, z, u, v: a point of the solid, m, and its pixel in the
      first image.
    """

    def __init__(self, entry: Mapping[str, Any]) -> None:
        """Parse the parameter, a mapping with one of the three keys.

        Raises:
            TrackingModelError: the parameter is invalid.
        """
        if len(entry) != 1 or next(iter(entry)) not in ("pose", "marker", "clicks"):
            raise TrackingModelError(
                "model_start must define the start pose of the model by exactly one key: "
                f"{START_FORMS}"
            )
        ((self.kind, value),) = entry.items()
        try:
            if self.kind == "pose":
                self._pose = _read_pose(value)
            elif self.kind == "marker":
                self._marker_size, self._pose = float(value["size"]), _read_pose(value["pose"])
                self._marker = MarkerTracker(MarkerChoice.read(str(value.get("number", ""))))
            else:
                self._clicks = np.array(value, float)
                if self._clicks.ndim != 2 or self._clicks.shape[1] != 5 or len(self._clicks) < 4:
                    raise ValueError("give at least four clicks of five numbers each")
        except (TypeError, ValueError, KeyError, IndexError, VisionError) as error:
            raise TrackingModelError(
                f"model_start: {self.kind} is {value}, which is invalid ({error}); set one of "
                f"{START_FORMS}"
            ) from None

    def compute_camera_T_solid(
        self, grey: NDArray[np.uint8], camera: CameraModel, world_T_camera: np.ndarray | None
    ) -> np.ndarray:
        """Compute the pose camera_T_solid (4, 4) in the first image.

        Args:
            grey: (rows, columns) image.
            camera: intrinsics and distortion.
            world_T_camera: (4, 4) pose of the camera, which the key `pose` needs.

        Raises:
            VisionError: the marker is not visible, the pose of the camera is missing, or the clicks
                do not determine a pose.
        """
        if self.kind == "pose":
            if world_T_camera is None:
                raise TrackingModelError(
                    "model_start: pose needs the pose of the camera, which is unknown; use marker "
                    "or clicks"
                )
            return inverse(world_T_camera) @ self._pose
        if self.kind == "marker":
            square = make_square(self._marker_size)
            places = np.column_stack([square, np.zeros(4)]) @ self._pose[:3, :3].T
            return solve_pnp(places + self._pose[:3, 3], self._marker.find_normalised(grey, camera))
        x, y, _ = camera.normalise(*self._clicks[:, 3:].T)
        return solve_pnp(self._clicks[:, :3], np.column_stack([x, y]))


def solve_pnp(object_points: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Compute the pose camera_T_solid (4, 4) from points of a solid and their images.

    Args:
        object_points: (n, 3) points in the solid's frame, m.
        points: (n, 2) images of these points, normalised.

    Raises:
        TrackingModelError: the points do not determine a pose.
    """
    is_solved, rotation_vector, translation = cv2.solvePnP(
        np.ascontiguousarray(object_points, float), np.ascontiguousarray(points, float), np.eye(3),
        None, flags=cv2.SOLVEPNP_SQPNP,
    )  # fmt: skip
    numbers = np.append(rotation_vector, translation)
    if not is_solved or not np.isfinite(numbers).all() or translation[2] <= 0.0:
        raise TrackingModelError(
            "the points do not determine the pose of the model; use at least four points that are "
            "not on one line, and check their pixels"
        )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotation_vector)[0], translation.ravel()
    return pose


def _read_pose(values: Sequence[float]) -> np.ndarray:
    numbers = [float(v) for v in values]
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise ValueError("a pose needs six finite numbers")
    return matrix_from_xyz_rpy(numbers[:3], numbers[3:])
