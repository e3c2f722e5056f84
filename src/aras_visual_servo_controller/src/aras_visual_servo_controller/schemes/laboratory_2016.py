"""The scheme of the laboratory's controller of 2016."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..features.moments import LEVEL_CAMERA, ImageMoments
from ..goals.goal import Goal
from ..kinematics.task import Task
from ..observation.observation import Observation
from .base import SCHEMES, SchemeOutput
from .feature_scheme import FeatureSchemeBase


@SCHEMES.register("moments_2016")
class Laboratory2016(FeatureSchemeBase):
    """Image moments with the inverse matrix and the ratio of gains of the laboratory's controller.

    v = Lambda L^-1 e_dot, where e_dot comes from the control law. v has the components vx, vy, vz
    and wz. L^-1 is -I with the last column (-yn, xn, 0, -1), for a target parallel to the image
    plane.

    The original controller has the gains Lambda = diag(140, 120, 60, 30) and stops the arm for each
    image; with a moving arm, these gains would overshoot. This scheme uses only their ratios:
    Lambda = diag(1, 120/140, 60/140, 30/140). The original controller also multiplies the angle by
    0.1, but then it would take minutes to converge here.
    """

    feature_class = ImageMoments
    ratio: ClassVar[tuple[float, ...]] = (1.0, 120.0 / 140.0, 60.0 / 140.0, 30.0 / 140.0)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Compute the features of an image and the camera task."""
        measured = self.check_measurement(
            self.feature.measure(self.require_visible(observation), goal)
        )
        modelled = np.array(LEVEL_CAMERA)
        inverse = -np.eye(4)
        inverse[:2, 3] = -measured.s[1], measured.s[0]
        L = np.zeros((4, 6))
        L[:, modelled] = np.linalg.inv(inverse)
        camera_error = np.zeros(6)
        camera_error[modelled] = inverse @ measured.error
        desired_rate = self.law.desired_error_rate(
            measured.error, L, camera_error, t, observation.dt
        )
        twist = np.zeros(6)
        twist[modelled] = np.array(self.ratio) * (inverse @ desired_rate)
        return SchemeOutput(
            names=self.names,
            features=measured.s,
            desired=measured.desired,
            error=measured.error,
            task=Task.from_twist(twist, modelled),
            L=L,
            ambiguity=measured.ambiguity,
            notes=measured.notes,
        )
