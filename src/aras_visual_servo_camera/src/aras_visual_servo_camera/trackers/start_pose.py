"""Where a solid is in the first picture: by a pose, by a marker, by places that were clicked."""

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
    """How a solid is found at first; made of what a parameter says.

    pose: of the solid in the arm's base (the world), m and rad.
    marker: an ArUco or AprilTag marker on the solid: size of its black square, m, and pose of its
        middle in the solid's frame, its x to the right and y up as it is read; number: see
        MarkerChoice, the largest in view where it is left out.
    clicks: places x, y, z of the solid, m, and the pixels u, v where the first picture has them;
        four at least.
    """

    def __init__(self, entry: Mapping[str, Any]) -> None:
        """`entry`: one of these by its name.

        Raises:
            ModelError: it is none of them.
        """
        if len(entry) != 1 or next(iter(entry)) not in ("pose", "marker", "clicks"):
            raise ModelError(f"model_start says where the model is at first: {START_FORMS}")
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
        """(4, 4) in the first picture.

        Raises:
            VisionError: the marker is not in view, or nobody knows where the camera is.
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
    """camera_T_solid (4, 4) of places (n, 3), m, seen at points (n, 2), normalised.

    Raises:
        ModelError: they give no pose.
    """
    good, turn, move = cv2.solvePnP(
        np.ascontiguousarray(object_points, float), np.ascontiguousarray(points, float), np.eye(3),
        None,
        flags=cv2.SOLVEPNP_SQPNP,
    )  # fmt: skip
    if not good or not (np.isfinite(turn).all() and np.isfinite(move).all()) or move[2] <= 0.0:
        raise ModelError("the points of the model give no pose: are they on one line?")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], move.ravel()
    return pose


def _read_pose(values: Sequence[float]) -> np.ndarray:
    numbers = [float(v) for v in values]
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise ValueError("six finite numbers are needed")
    return matrix_from_xyz_rpy(numbers[:3], numbers[3:])
