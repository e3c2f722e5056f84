"""Features of one image in one array, for the checks that compare the motion of the features.

The array has one row for each of the k components of the error, and ten columns: the error, the
component's row of L (six columns, from FIRST_L on), the rate of the error due to the target's own
motion (per s), the tolerance, and whether the component is an angle, which may wrap (1 or 0).
"""

from __future__ import annotations

import numpy as np

ERROR, FIRST_L, DRIFT, TOLERANCE, IS_ANGLE = 0, 1, 7, 8, 9


def pack_features(
    error: np.ndarray,
    L: np.ndarray | None,
    error_drift: np.ndarray | float,
    tolerances: np.ndarray | float,
    is_angle: np.ndarray | bool,
) -> np.ndarray | None:
    """Return the array (k, 10) of one image, or None if there is no L of the error.

    Args:
        error: (k,) error s - s*.
        L: (k, 6) interaction matrix of the error; None, or of another shape, if it is unknown.
        error_drift: rate of the error due to the target's own motion, per s.
        tolerances: tolerance of each component.
        is_angle: whether each component is an angle, which may wrap.

    The last three are arrays (k,), or one value for all components.
    """
    if L is None or L.shape != (len(error), 6):
        return None
    rows = np.empty((len(error), 10))
    rows[:, ERROR], rows[:, FIRST_L:DRIFT], rows[:, DRIFT] = error, L, error_drift
    rows[:, TOLERANCE], rows[:, IS_ANGLE] = tolerances, is_angle
    return rows
