"""Partitioned control: motion along and about the optical axis has a control law of its own."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_camera.polygons import signed_area

from ..errors import MeasurementError
from ..features.base import wrap
from ..features.corners import NumberedPoints
from ..goals.goal import Goal
from ..kinematics.algebra import ROUNDING_TOLERANCE, solve_least_squares
from ..kinematics.task import Task
from ..observation.observation import Observation
from .base import SCHEMES, SchemeOutput
from .feature_scheme import FeatureSchemeBase

AXIAL_DIRECTIONS = np.array([False, False, True, False, False, True])  # vz, wz


@SCHEMES.register("partitioned")
class Partitioned(FeatureSchemeBase):
    """Partitioned scheme: the area of the target controls vz, the angle of one edge controls wz.

    Let area be that of the polygon of the points, s = log(area) / 2, theta the angle of the edge
    from the first to the second point, and Z the depth. Then vz = gain Z (s* - s) and wz = gain
    (theta - theta*). The effect of vz and wz is subtracted from the desired rate of the points.
    Then the other four components of the twist are computed from L. The camera does not retreat,
    because a rotation about the optical axis causes no translation.

    Reference: P. Corke and S. Hutchinson, A new partitioned approach to image-based visual servo
    control, IEEE Transactions on Robotics and Automation 17(4), 2001.
    """

    feature_class = NumberedPoints

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Compute the features of an image and the camera task."""
        measured = self.check_measurement(
            self.feature.measure(self.require_visible(observation), goal)
        )
        L, error = measured.L, measured.error
        points, desired = measured.s.reshape(-1, 2), measured.desired.reshape(-1, 2)
        camera_error = solve_least_squares(L, error, ROUNDING_TOLERANCE)
        desired_rate = self.law.desired_error_rate(error, L, camera_error, t, observation.dt)
        size = float(np.linalg.norm(error))
        gain = -float(desired_rate @ error) / size**2 if size > 0.0 else 0.0
        depth = float(np.mean(-1.0 / L[0::2, 0]))
        twist = np.zeros(6)
        twist[2] = gain * depth * 0.5 * np.log(_compute_area(desired) / _compute_area(points))
        twist[5] = gain * float(wrap(_compute_angle(points) - _compute_angle(desired)))
        rest = desired_rate - measured.error_drift - L @ twist
        twist[~AXIAL_DIRECTIONS] = solve_least_squares(
            np.ascontiguousarray(L[:, ~AXIAL_DIRECTIONS]), rest, ROUNDING_TOLERANCE
        )
        return SchemeOutput(
            names=self.names, features=measured.s, desired=measured.desired, error=error,
            task=Task.from_twist(twist), L=L, ambiguity=measured.ambiguity, notes=measured.notes,
        )  # fmt: skip


def _compute_area(points: np.ndarray) -> float:
    """Return the area of a polygon (n, 2).

    Raises:
        MeasurementError: the area is zero.
    """
    area = abs(signed_area(points))
    if area < 1e-12:
        raise MeasurementError(
            "the points of the target lie on one line, so that its area is zero: use points that "
            "are not on one line"
        )
    return area


def _compute_angle(points: np.ndarray) -> float:
    """Return the angle of the edge from the first to the second point in the image, rad."""
    dx, dy = points[1] - points[0]
    return float(np.arctan2(dy, dx))
