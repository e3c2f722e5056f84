"""Comparison of the target's plane, predicted by kinematics, with its plane at the goal.

Offsets are scaled in this module: rotations are multiplied by the target's depth, so that all six
components are in m.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import skew

if TYPE_CHECKING:
    from aras_visual_servo_camera.camera_model import CameraModel

    from ..goals.goal import Goal

# When an offset is computed from the change of the target's plane, camera motions are ignored if
# they change the plane by less than this fraction of the most effective motion.
MIN_PLANE_CHANGE = 0.05


class GoalPlane:
    """Plane of the target at the goal, with the effect of the camera's motion on it.

    A camera motion v, w changes the plane p in the camera frame by (p . v) p + p x w, and its
    normal n by n x w.

    Attributes:
        goal: goal of the run.
        camera: camera of the run.
        is_goal_camera: whether the goal was taught with the camera of the run. The target may then
            have been moved since teaching, so only the direction of the plane's normal is compared,
            for camera directions that the features measure poorly.
    """

    def __init__(self, goal: Goal, camera: CameraModel) -> None:
        self.goal, self.camera = goal, camera
        self.is_goal_camera = goal.camera is not None and goal.camera == camera
        if goal.plane is None:
            return
        self._plane = p = goal.distance * np.array(goal.plane)
        moves = np.outer(p, p)
        if self.is_goal_camera:
            self._plane, moves = p / np.linalg.norm(p), np.zeros((3, 3))
        self._changes = np.hstack([moves, skew(self._plane)]) / goal.distance
        # Camera motion (6, 3) that explains a change of the plane.
        self._motions = np.linalg.pinv(self._changes, MIN_PLANE_CHANGE)

    def compute_offset(
        self, pose: np.ndarray | None, offset: np.ndarray, poor_directions: np.ndarray
    ) -> tuple[float, float]:
        """Compute how far the camera is from its goal according to the plane of the target.

        The result is the camera motion that explains, in addition to `offset`, how the plane that
        kinematics predict differs from the plane at the goal.

        Args:
            pose: `world_T_camera` (4, 4) by kinematics; None if it is unknown.
            offset: (6,) offset of the camera from the goal by features, m.
            poor_directions: (d, 6) camera directions that the features measure poorly.

        Returns:
            Distance, m, and angle, rad.
        """
        plane = None if pose is None else self.goal.compute_plane(pose)
        if plane is None or self.is_goal_camera and not len(poor_directions):
            return 0.0, 0.0
        now = self.goal.distance * np.array(plane)
        if self.is_goal_camera:
            now = now / np.linalg.norm(now)
        rest = now - self._plane - self._changes @ offset
        if self.is_goal_camera:
            changes = self._changes @ poor_directions.T
            motion = np.linalg.pinv(changes, MIN_PLANE_CHANGE) @ rest @ poor_directions
        else:
            motion = self._motions @ rest
        return (
            float(np.linalg.norm(motion[:3])),
            float(np.linalg.norm(motion[3:])) / self.goal.distance,
        )
