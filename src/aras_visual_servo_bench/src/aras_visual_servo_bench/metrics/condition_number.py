"""Condition numbers of the interaction matrices of a run."""

from __future__ import annotations

import numpy as np


def compute_condition_numbers(singular: np.ndarray) -> np.ndarray:
    """Compute the condition number (n,) of the matrix L of each image.

    singular: singular values (n, p), largest first. The condition number of an image without
        singular values is NaN.
    """
    if not singular.shape[1]:
        return np.full(len(singular), np.nan)
    least = np.nanmin(np.where(np.isnan(singular), np.inf, singular), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.isfinite(least), singular[:, 0] / least, np.nan)
