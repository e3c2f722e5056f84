"""Estimation of the interaction matrix L from measured motion, without camera model or depth.

With gain = 1, Broyden's rule makes the smallest change of L that explains the change de of the
features by the last camera motion v:

    L <- L + gain (de - L v) v^T W / (floor^2 + v^T W v)

Here W makes rotations comparable to translations, and floor reduces the change if the motion is so
small that noise dominates.

Reference: J. A. Piepmeier, G. V. McMurray and H. Lipkin, Uncalibrated dynamic visual servoing, IEEE
Transactions on Robotics and Automation 20(1), 2004.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.poses import logarithm

from ..features.base import FeatureMeasurement
from ..observation.observation import Observation

# Let d be the translation, in m, that changes the features as much as a rotation by 1 rad. In
# Broyden's rule, a rotation by 1 rad has the weight of a translation by ROTATION_WEIGHT d.
ROTATION_WEIGHT = 0.5
# Default of `floor` as a fraction of d: for this camera motion, half of the change of the features
# is noise.
MIN_STEP = 1 / 600
# value of d (see ROTATION_WEIGHT) in m, if the first L is zero and d cannot be computed
UNKNOWN_MOTION = 0.6
# L is not updated if a component of the error has changed by more than this since the last image,
# because an angle has probably jumped by a turn.
LONGEST_JUMP = 1.0


class BroydenEstimator:
    """Estimator of L (k, 6) for a FeatureScheme with interaction 'estimated'.

    The estimate starts from the feature's own L in the first image, or from `start`.
    """

    def __init__(
        self, gain: float = 0.5, floor: float | None = None, start: np.ndarray | None = None
    ) -> None:
        """Set the parameters of the estimator.

        Args:
            gain: fraction of the prediction error that one update corrects, in (0, 1].
            floor: camera motion, m, for which the change of the features is half noise; None to
                compute it from L.
            start: initial L (k, 6); None for the feature's own L in the first image.
        """
        self.gain, self.floor = float(gain), floor
        self.start = None if start is None else np.array(start, float)
        self.reset()

    def reset(self) -> None:
        """Discard the estimate and the last image."""
        self._L: np.ndarray | None = None
        # Weights W and floor of Broyden's rule (see the module's docstring), computed from the
        # first L.
        self._weights, self._floor = np.ones(6), 0.0
        # Stamp (s) and error of the last image.
        self._last_measurement: tuple[float, np.ndarray] | None = None

    def __call__(self, observation: Observation, measured: FeatureMeasurement) -> np.ndarray:
        """Update L (k, 6) with this image and return it."""
        error = np.asarray(measured.error, float)
        before, self._last_measurement = self._last_measurement, (observation.stamp, error)
        if self._L is None or len(self._L) != len(error):
            known = self.start if self.start is not None else measured.L
            self._L = np.array(known, float)
            # The ratio of the two norms is the translation, in m, that changes the features as much
            # as a rotation by 1 rad. For image points it is about their depth.
            moving, turning = (np.linalg.norm(part) for part in np.hsplit(self._L, 2))
            length = turning / moving if moving > 0.0 and turning > 0.0 else UNKNOWN_MOTION
            self._weights = np.repeat((1.0, (ROTATION_WEIGHT * length) ** 2), 3)
            self._floor = MIN_STEP * length if self.floor is None else self.floor
        moved = observation.previous_T_camera
        # L is updated only if the camera motion since the last image was measured.
        if before is None or moved is None or len(before[1]) != len(error):
            return self._L
        if abs(observation.stamp - observation.dt - before[0]) > 1e-6:
            return self._L
        change = error - before[1] - np.asarray(measured.error_drift) * observation.dt
        if np.abs(change).max() > LONGEST_JUMP:
            return self._L
        v = logarithm(moved)
        weighted = self._weights * v
        misfit = change - self._L @ v
        scale = self.gain / (self._floor**2 + float(v @ weighted))
        self._L = self._L + np.outer(misfit, scale * weighted)
        return self._L
