"""The 2016 schemes: image moments of the target (the paper's features).

Features, with xg, yg the centre of gravity in normalised coordinates and a = m00 the area:

    an = Z* sqrt(a*/a),   xn = an xg,   yn = an yg,   alpha = 1/2 atan2(2 mu11, mu20 - mu02)

xn, yn and an are metres: the place of the target before a camera parallel to it. The camera is
kept level by the pitch regulation of the loop, so the twist has the four components vx, vy, vz
and wz, and L their four columns. L takes the target to lie level, seen at the tilt that the
camera's mounting and the goal's pitch give, at the depth that its area tells.

Reference: O. Tahri and F. Chaumette, Point-based and region-based image moments for visual
servoing of planar objects, IEEE Transactions on Robotics 21(6), 2005.
"""

from typing import ClassVar

import numpy as np

from aras_visual_servo_camera import features as camera_features
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ...desired import Desired
from ...errors import ConfigurationError, MeasurementError
from ..laws import Diagonal, Law
from .base import Measurement, Scheme, SchemeResult, wrap

LEVEL_CAMERA = [0, 1, 2, 5]  # vx, vy, vz, wz
EDGE_ON = 0.05  # sine of the angle between line of sight and table


class MomentsScheme(Scheme):
    """Image moments with their interaction matrix at the current view, v = -L^+ gain e."""

    feature_names: ClassVar[tuple[str, ...]] = camera_features.PAPER
    thresholds: ClassVar[tuple[float, ...]] = (0.001, 0.003, 0.005, 0.01)
    # An image of a square carries some anisotropy from its pixels: below this it is one.
    anisotropy: ClassVar[float] = 1e-2

    def __init__(self, desired: Desired, law: Law) -> None:
        super().__init__(desired, law)
        try:
            moments = Moments.from_arrays(desired.m, desired.mu, desired.order)
            self._reference = camera_features.Reference.from_moments(moments, desired.depth)
            self._plane = self._plane_at_goal()
            self._target = self._features(moments).values
        except (VisionError, MeasurementError) as error:
            raise ConfigurationError(f"{desired.name}: {error}") from error

    def compute(self, measurement: Measurement, elapsed: float) -> SchemeResult:
        """See Scheme.compute."""
        if measurement.moments is None:
            raise MeasurementError("no moments in this measurement: is it ImageMoments?")
        found = self._features(measurement.moments)
        error = found.values - self._target
        error[3] = wrap(error[3], np.pi)
        error = self.smoothed(error, measurement.stamp)
        twist = np.zeros(6)
        twist[LEVEL_CAMERA] = self._velocity(found.L[:, LEVEL_CAMERA], found.values, error, elapsed)
        return SchemeResult(self.feature_names, found.values, self._target, error, twist)

    def _plane_at_goal(self) -> np.ndarray:
        """(A, B, C), 1/m, of the level target in the optical frame: 1/Z = A x + B y + C."""
        up = self.desired.camera_pose[2, :3]
        if abs(up[2]) < EDGE_ON:
            raise ConfigurationError(
                f"{self.desired.name}: at the goal the camera looks along the table, not on it: "
                "mount it more upright"
            )
        return up / (self.desired.depth * up[2])

    def _features(self, moments: Moments) -> camera_features.FeatureSet:
        try:
            plane = self._plane * np.sqrt(moments.area / self._reference.area)
            found = camera_features.compute(
                moments,
                self.feature_names,
                plane=Plane(*plane.tolist()),
                reference=self._reference,
                tolerance=self.anisotropy,
            )
        except VisionError as error:
            raise MeasurementError(str(error)) from error
        if found.degenerate:
            name, reason = next(iter(found.degenerate.items()))
            raise MeasurementError(f"feature {name} is undefined: {reason}")
        return found

    def _velocity(
        self, L: np.ndarray, values: np.ndarray, error: np.ndarray, elapsed: float
    ) -> np.ndarray:
        return self.law.velocity(L, error, elapsed)


class Moments2016Scheme(MomentsScheme):
    """The same features with the law of the laboratory's own controller.

    v = -Lambda L^-1 e, where L^-1 = -I with the last column (-yn, xn, 0, -1): that of a target
    parallel to the image, at the current view. Lambda = diag(140, 120, 60, 30) in the original,
    on an angle scaled by 0.1 and integrated over 0.01 s once an image, each after the arm had
    arrived. At 30 images/s, with the arm moving on, gains of 42/s overshoot; here their ratio is
    kept and the law's gain is that of the first feature. The angle is not scaled, or it
    would take minutes.
    """

    RATIO: ClassVar[tuple[float, ...]] = (140.0, 120.0, 60.0, 30.0)

    def __init__(self, desired: Desired, law: Law) -> None:
        super().__init__(desired, law)
        first = float(law.gain(np.zeros(4), elapsed=1e9)[0])
        self._lambda = Diagonal([first * ratio / self.RATIO[0] for ratio in self.RATIO])

    def _velocity(
        self, L: np.ndarray, values: np.ndarray, error: np.ndarray, elapsed: float
    ) -> np.ndarray:
        inverse = -np.eye(4)
        inverse[:2, 3] = -values[1], values[0]
        return -self._lambda.gain(error, elapsed) * (inverse @ error)
