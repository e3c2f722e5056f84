"""Hybrid control: the motion along and about the optical axis is decided apart from the rest."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_camera.polygons import signed_area

from ..arm.algebra import ROUNDING_PART, least_squares
from ..arm.task import Task
from ..errors import MeasurementError
from ..features.base import wrap
from ..features.corners import NumberedPoints
from ..goals.goal import Goal
from ..seeing.observation import Observation
from .base import SCHEMES, Decision
from .of_feature import OfFeature

ALONG = np.array([False, False, True, False, False, True])  # vz, wz


@SCHEMES.register("partitioned")
class Partitioned(OfFeature):
    """vz by the root of the points' area, wz by the angle of their first edge, the rest by L.

    With s = log(area) / 2 and theta the angle of the edge, vz = gain Z (s* - s) and wz = gain
    (theta - theta*); of the points' wanted rate what these two bring about is taken off before
    the other four are solved for. No camera retreat: a turn asks for no translation. Reference:
    P. Corke and S. Hutchinson, A new partitioned approach to image-based visual servo control,
    IEEE Transactions on Robotics and Automation 17(4), 2001.
    """

    made_of = NumberedPoints

    def compute(self, observation: Observation, goal: Goal, t: float) -> Decision:
        """See Scheme.compute."""
        measured = self.checked(self.feature.measure(self.visible(observation), goal))
        L, error = measured.L, measured.error
        points, desired = measured.s.reshape(-1, 2), measured.desired.reshape(-1, 2)
        rotated = least_squares(L, error, ROUNDING_PART)
        wanted = self.law.rate(error, L, rotated, t, observation.dt)
        size = float(np.linalg.norm(error))
        gain = -float(wanted @ error) / size**2 if size > 0.0 else 0.0
        depth = float(np.mean(-1.0 / L[0::2, 0]))
        twist = np.zeros(6)
        twist[2] = gain * depth * 0.5 * np.log(_area(desired) / _area(points))
        twist[5] = gain * float(wrap(_angle(points) - _angle(desired)))
        rest = wanted - measured.rate - L @ twist
        twist[~ALONG] = least_squares(np.ascontiguousarray(L[:, ~ALONG]), rest, ROUNDING_PART)
        return Decision(
            names=self.names, features=measured.s, desired=measured.desired, error=error,
            task=Task.of_twist(twist), L=L, up_to=measured.up_to, notes=measured.notes,
        )  # fmt: skip


def _area(points: np.ndarray) -> float:
    """Of a polygon (n, 2).

    Raises:
        MeasurementError: it has none.
    """
    area = abs(signed_area(points))
    if area < 1e-12:
        raise MeasurementError("the points of the target lie on one line: it has no area")
    return area


def _angle(points: np.ndarray) -> float:
    """Of the first edge, rad."""
    dx, dy = points[1] - points[0]
    return float(np.arctan2(dy, dx))
