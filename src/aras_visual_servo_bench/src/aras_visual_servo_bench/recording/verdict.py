"""Result of a run according to the true poses of the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_controller.diagnosis.pose_uncertainty import NEGLIGIBLE_UNCERTAINTY

REACHED, MISSED = "goal_reached", "goal_missed"


@dataclass(frozen=True)
class Verdict:
    """Result of a run according to the true poses.

    name: 'goal_reached' or 'goal_missed'; '' if the poses are unknown.
    distance: distance of the camera from its goal, m.
    angle: angle between the orientations of the camera and of its goal, rad.
    tolerance: maximum distance (m) and angle (rad) at which the goal is reached; NaN if unknown.
    """

    name: str
    distance: float
    angle: float
    tolerance: tuple[float, float] = (float("nan"), float("nan"))

    @property
    def is_reached(self) -> bool:
        """True if the camera has reached its goal."""
        return self.name == REACHED

    @classmethod
    def compare(
        cls, goal: np.ndarray, pose: np.ndarray, depth: float,
        tolerance: tuple[float, float] | None = None,
    ) -> Verdict:
        """Compare the pose of the camera with the goal pose, both world_T_camera (4, 4).

        Args:
            depth: depth of the target at the goal, m.
            tolerance: maximum distance (m) and angle (rad) at which the goal is reached; None: the
                tolerances of the outcome 'converged', of which the distance is proportional to the
                depth.
        """
        distance, angle = pose_difference(goal, pose)
        if tolerance is None:
            tolerance = (NEGLIGIBLE_UNCERTAINTY[0] * depth, NEGLIGIBLE_UNCERTAINTY[1])
        is_reached = distance <= tolerance[0] and angle <= tolerance[1]
        return cls(REACHED if is_reached else MISSED, distance, angle, tuple(tolerance))
