"""Features of one image in one array, for the checks that compare the motion of the features.

The array has one row for each of the k components of the error, and ten columns: the error, the
component's row of L (six columns, from FIRST_L on), the rate of the error due to the target's own
motion (per s), the tolerance, and whether the component is an angle, which may wrap (1 or 0).
"""

from __future__ import annotations

import numpy as np

from ..observation.observation import Observation

ERROR, FIRST_L, DRIFT, TOLERANCE, IS_ANGLE = 0, 1, 7, 8, 9


class FeatureHistory:
    """Features of the latest image and of the one before it, for all checks that compare them.

    Attributes:
        now: (k, 10) features of the latest image; None if there is no L.
        before: (k, 10) features of the image before it. None if they cannot be compared with `now`:
            if that image was not added, if the camera's motion between the two is unknown, or if
            the number of features has changed.
    """

    # Largest difference of two stamps of the same image that rounding explains, s.
    SAME_STAMP = 1e-6

    def __init__(self, now: np.ndarray | None = None, before: np.ndarray | None = None) -> None:
        self.now, self.before, self._stamp = now, before, 0.0

    def add(
        self,
        observation: Observation,
        error: np.ndarray,
        L: np.ndarray | None,
        error_drift: np.ndarray | float,
        tolerances: np.ndarray | float,
        is_angle: np.ndarray | bool,
    ) -> None:
        """Add the features of one image.

        Args:
            observation: observation of the image.
            error: (k,) error s - s*.
            L: (k, 6) interaction matrix of the error; None, or of another shape, if it is unknown.
            error_drift: rate of the error due to the target's own motion, per s.
            tolerances: tolerance of each component.
            is_angle: whether each component is an angle, which may wrap.

        The last three are arrays (k,), or one value for all components.
        """
        before, now, stamp = self.now, None, observation.stamp
        if L is not None and L.shape == (error.size, 6):
            now = np.empty((error.size, 10))
            now[:, ERROR], now[:, FIRST_L:DRIFT], now[:, DRIFT] = error, L, error_drift
            now[:, TOLERANCE], now[:, IS_ANGLE] = tolerances, is_angle
        if (
            before is None or now is None or before.shape != now.shape
            # The motion and `dt` of an observation start at the image before it. The features of an
            # image are not added if an earlier diagnosis reports an outcome.
            or stamp - observation.dt > self._stamp + self.SAME_STAMP
            or observation.motion is None
        ):  # fmt: skip
            before = None
        self.before, self.now, self._stamp = before, now, stamp
