"""Pose of a solid in the first image: from a pose, a marker, or clicked points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy

from ..errors import ModelError, VisionError
from ..markers import MarkerChoice
from ..undistortion import CameraModel
from .marker import MarkerTracker

START_FORMS = (
    "pose: [x, y, z, roll, pitch, yaw], marker: {size, pose}, or clicks: [[x, y, z, u, v], ...]"
)


class StartPose:
    """Start pose of a solid, as defined by a parameter with one of three keys.

    pose: pose of the solid in the arm's base (the world), m and rad.
    marker: an ArUco or AprilTag marker on the solid: `size` of its black square, m; `pose` of its
    middle
        in the solid's frame, with x to the right and y up as the marker is read; `number` as in
        MarkerChoice, by default the largest marker in view.
    clicks: at least four points x, y, z of the solid, m, with their pixels u, v in the first image.
    """

    def __init__(self, entry: Mapping[str, Any]) -> None:
        """Parse the parameter, a mapping with one of the three keys.

        Raises:
            ModelError: the parameter is invalid.
        """
        if len(entry) != 1 or next(iter(entry)) not in ("pose", "marker", "clicks"):
            raise ModelError(f"model_start must define the start pose of the model: {START_FORMS}")
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
                    raise ValueError("four rows of five numbers at least")
        except (TypeError, ValueError, KeyError, IndexError, VisionError) as error:
            raise ModelError(f"model_start: {self.kind} {value}: {error}: {START_FORMS}") from None

    def compute_camera_T_solid(
        self, grey: NDArray[np.uint8], camera: CameraModel, world_T_camera: np.ndarray | None
    ) -> np.ndarray:
        """Compute the pose camera_T_solid (4, 4) in the first image.

        Raises:
            VisionError: the marker is not in view, or the pose of the camera is needed and unknown.
        """
        if self.kind == "pose":
            if world_T_camera is None:
                raise ModelError("model_start: a pose in the world needs the camera's pose")
            return inverse(world_T_camera) @ self._pose
        if self.kind == "marker":
            half = 0.5 * self._marker_size
            square = np.array([(-half, half), (half, half), (half, -half), (-half, -half)])
            places = np.column_stack([square, np.zeros(4)]) @ self._pose[:3, :3].T
            return solve_pnp(places + self._pose[:3, 3], self._marker.find_normalised(grey, camera))
        x, y, _ = camera.normalise(*self._clicks[:, 3:].T)
        return solve_pnp(self._clicks[:, :3], np.column_stack([x, y]))


def solve_pnp(object_points: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Compute camera_T_solid (4, 4) from points of the solid and their image points.

    Args:
        object_points: (n, 3) m, in the solid's frame.
        points: (n, 2) normalised.

    Raises:
        ModelError: the points do not determine a pose.
    """
    is_solved, rotation_vector, translation = cv2.solvePnP(
        np.ascontiguousarray(object_points, float), np.ascontiguousarray(points, float), np.eye(3),
        None,
        flags=cv2.SOLVEPNP_SQPNP,
    )  # fmt: skip
    if (
        not is_solved
        or not (np.isfinite(rotation_vector).all() and np.isfinite(translation).all())
        or translation[2] <= 0.0
    ):
        raise ModelError("the points of the model give no pose: are they on one line?")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotation_vector)[0], translation.ravel()
    return pose


def _read_pose(values: Sequence[float]) -> np.ndarray:
    numbers = [float(v) for v in values]
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise ValueError("six finite numbers are needed")
    return matrix_from_xyz_rpy(numbers[:3], numbers[3:])
