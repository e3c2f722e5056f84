"""Least-squares fits of the features' motion by the motions of camera and target.

The motions are rows of a fit, each with k values, which are summed over groups of successive rows.
"""

from __future__ import annotations

import numpy as np


def sum_groups(values: np.ndarray, size: int) -> np.ndarray:
    """Sum values (m, ...) over groups of `size` successive rows, the last row included.

    The first two axes of the sums are joined to one.
    """
    count = len(values) // size * size
    sums = values[len(values) - count :].reshape(-1, size, *values.shape[1:]).sum(axis=1)
    return sums.reshape(-1, *sums.shape[2:])


def fit_depth(effect: np.ndarray, moved: np.ndarray) -> float:
    """Return the factor on the effect (n,) of the translations that best explains a motion (n,)."""
    square = float(effect @ effect)
    return effect @ moved / square if square > 0.0 else 1.0


def compute_mixed_effects(L: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return the feature motions (m, k, 18) due to camera motions along wrong axes.

    There is a column for each of the nine pairs of axes: the feature motion if the camera's
    translation along the first axis acted along the second axis. Nine more columns are for
    rotations.

    Args:
        L: (m, k, 6) interaction matrix of each row of the fit.
        motion: (m, 6) motion of the camera in each row.
    """
    effects = [
        L[:, :, part, None] * motion[:, None, None, part] for part in (slice(0, 3), slice(3, 6))
    ]
    return np.concatenate([effect.reshape(*L.shape[:2], 9) for effect in effects], axis=2)


def fit_camera(columns: np.ndarray, feature_motion: np.ndarray, min_factor: float) -> float:
    """Return the squared motion of the features that a wrong camera model does not explain.

    With a wrong camera model, a camera motion along one axis may act along any other axis. Such a
    motion has to move the features at least `min_factor` times as far as predicted. If the features
    move less, the camera follows a moving target.

    Args:
        columns: (n, 18) effects of the camera's motion, see `compute_mixed_effects`.
        feature_motion: (n,) measured motion of the features.
        min_factor: smallest accepted ratio of the fitted to the predicted effect of a translation
            or a rotation about any axis.
    """
    identity = np.vstack([np.eye(3)] * 2).ravel()
    _, factors = fit_columns(columns, feature_motion - columns @ identity)
    U, scale, Vt = np.linalg.svd((identity + factors).reshape(2, 3, 3))
    mixing = U * np.maximum(scale, min_factor)[:, None, :] @ Vt
    residual = feature_motion - columns @ mixing.ravel()
    return float(residual @ residual)


def fit_columns(columns: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Fit values (n,) by a linear combination of columns (n, m) in the least-squares sense.

    Returns:
        The squared residual, and the factors (m,) of the columns.
    """
    factors = _solve_normal(columns.T @ columns, (columns.T @ values)[:, None])[:, 0]
    rest = values - columns @ factors
    return float(rest @ rest), factors


def fit_oscillation(
    stamps: np.ndarray, columns: np.ndarray, values: np.ndarray, max_frequency: float
) -> tuple[float, float]:
    """Fit an oscillation of the target to the motion of the features.

    Args:
        stamps: (g,) time of each group of rows, s; the first is 0.
        columns: (n, m) effects that are fitted, too; those of a constant velocity of the target
            are the columns 1 to 3. Each group has n / g values.
        values: (n,) motion of the features.
        max_frequency: highest frequency that is fitted, Hz.

    Returns:
        The frequency, Hz, with the smallest squared residual, and this residual.
    """
    # The effects of a wrong depth and of a constant twist are the same at all frequencies. They
    # are therefore subtracted from the motion before oscillations are fitted.
    base = np.linalg.qr(columns)[0]
    values = values - base @ (base.T @ values)
    # The columns of the fit are those of a constant velocity times a cosine or a sine wave. A wave
    # has one value for each group, so products of the columns are added up in each group once for
    # all frequencies.
    groups, frequencies = len(stamps), np.arange(1.0 / stamps[-1], max_frequency, 0.25 / stamps[-1])
    velocity = columns[:, 1:4].reshape(groups, -1, 3)
    across = velocity.swapaxes(1, 2)
    squares = (across @ velocity).reshape(groups, 9)
    shared = (across @ base.reshape(groups, -1, base.shape[1])).reshape(groups, -1)
    right = (across @ values.reshape(groups, -1, 1)).reshape(groups, 3)
    phase, count = np.outer(2.0 * np.pi * frequencies, stamps), len(frequencies)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    # For each frequency: normal equations (6, 6) of the waves, minus the part that the other
    # columns explain, too.
    normal = (waves[:, :, None] * waves[:, None]) @ squares
    normal = normal.reshape(count, 2, 2, 3, 3).swapaxes(2, 3).reshape(count, 6, 6)
    shared = (waves @ shared).reshape(count, 6, -1)
    normal = normal - shared @ shared.swapaxes(1, 2)
    right = (waves @ right).reshape(count, 6, 1)
    factors = _solve_normal(normal, right)
    explained = (factors * (2.0 * right - normal @ factors)).sum(axis=(1, 2))
    best = int(explained.argmax())
    return frequencies[best], float(values @ values - explained[best])


def _solve_normal(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve normal equations with a matrix (..., m, m) and a right side (..., m, 1)."""
    # A small regularisation makes the solution unique if two columns are almost equal.
    traces = np.trace(normal, axis1=-2, axis2=-1)[..., None, None]
    return np.linalg.solve(normal + (1e-9 * traces + 1e-300) * np.eye(normal.shape[-1]), right)
