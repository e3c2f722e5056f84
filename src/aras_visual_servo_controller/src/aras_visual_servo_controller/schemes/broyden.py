"""L estimated from what was seen: no camera model, no depth, only how the features moved.

Broyden's rule changes L no more than the last motion of the camera v demands,

    L <- L + gain (de - L v) v^T W / (floor^2 + v^T W v)

with de the features' change in that motion, and W making rotations comparable to translations.

Reference: J. A. Piepmeier, G. V. McMurray and H. Lipkin, Uncalibrated dynamic visual servoing,
IEEE Transactions on Robotics and Automation 20(1), 2004.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.poses import logarithm

from ..features.base import FeatureMeasurement
from ..observation.observation import Observation

# One radian weighs as much as this part of the translation that moves the features as far.
ROTATION_WEIGHT = 0.5
MIN_STEP = 1 / 600  # part of that translation: of a motion so small is half noise
UNKNOWN_MOTION = 0.6  # m: that translation where L is zero
LONGEST_JUMP = 1.0  # of an error: more is an angle that wrapped round


class Broyden:
    """Estimator of L (k, 6) for a Composed with interaction 'estimated'.

    It begins with the feature's own L at the first view, or with `start`.
    """

    def __init__(
        self, gain: float = 0.5, floor: float | None = None, start: np.ndarray | None = None
    ) -> None:
        """Args:
            gain: part of the misfit that is corrected at once, in (0, 1].
            floor: m, of a motion so small that its features' change is half noise; None: by L.
            start: L (k, 6) to begin with; None: the feature's own at the first view.
        """
        self.gain, self.floor = float(gain), floor
        self.start = None if start is None else np.array(start, float)
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._L: np.ndarray | None = None
        self._weights, self._floor = np.ones(6), 0.0  # W and floor; with the first L
        self._last_measurement: tuple[float, np.ndarray] | None = None  # stamp, error

    def __call__(self, observation: Observation, measured: FeatureMeasurement) -> np.ndarray:
        """L (k, 6) at this view, after what this image adds."""
        error = np.asarray(measured.error, float)
        before, self._last_measurement = self._last_measurement, (observation.stamp, error)
        if self._L is None or len(self._L) != len(error):
            known = self.start if self.start is not None else measured.L
            self._L = np.array(known, float)
            # m that move the features as far as one radian: the distance, of points.
            moving, turning = (np.linalg.norm(part) for part in np.hsplit(self._L, 2))
            length = turning / moving if moving > 0.0 and turning > 0.0 else UNKNOWN_MOTION
            self._weights = np.repeat((1.0, (ROTATION_WEIGHT * length) ** 2), 3)
            self._floor = MIN_STEP * length if self.floor is None else self.floor
        moved = observation.previous_T_camera
        # The motion is that since the last image; where that was not measured, nothing is learnt.
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
