"""Statistics of the camera's offset: accuracy of the features, and bounds of noisy offsets."""

from __future__ import annotations

from math import sqrt

import numpy as np

from aras_visual_servo_base.compiled import jit

from .camera_offset import RANK_TOLERANCE

# Safety factors on translation and rotation for the part of an offset that exceeds the noise. They
# are large enough for an L computed with 0.6 times the true depth, and for a mounting that is wrong
# by 8 degrees.
OFFSET_FACTORS = 1.7, 1.4
Z_997 = 2.748  # 99.7 % quantile of a normal distribution
# Noise does not explain an error of more than this many standard deviations.
NOISE_DEVIATIONS = 3.0


def estimate_residual_accuracy(
    L: np.ndarray, error: np.ndarray, noise: np.ndarray | float
) -> np.ndarray | None:
    """Estimate the accuracy (k, k) of features that do not define their own accuracy.

    The accuracy is estimated from the part of the error (k,) that, according to L (k, 6), no camera
    motion explains. The squared noise (k,) is subtracted from the square of this part. Return None
    if L and the noise explain the whole error.
    """
    lengths = np.linalg.norm(L, axis=1)
    weights = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
    u, s, _ = np.linalg.svd(weights[:, None] * L)
    rest = u[:, int((s > RANK_TOLERANCE * s[0]).sum()) :].T
    if not len(rest):
        return None
    noise = NOISE_DEVIATIONS * np.linalg.norm(rest * (weights * noise))
    left = np.linalg.norm(rest @ (weights * error)) ** 2 - noise**2
    return np.diag(lengths * sqrt(left / len(rest))) if left > 0.0 else None


def compute_unexplained_ratio(
    L: np.ndarray, error: np.ndarray, accuracy: np.ndarray, noise: np.ndarray | float = 0.0
) -> float:
    """Return the ratio of the unexplained part of an error (k,) to its expected size.

    The unexplained part is the error minus the effects of noise (k,) and of the best camera motion
    by L (k, 6). Its expected size follows from the accuracy (k, m) of both the goal and the image.
    Return 0 if k does not exceed the rank of L.
    """
    u, s, _ = np.linalg.svd(L)
    rest = u[:, int((s > RANK_TOLERANCE * s[0]).sum()) :].T
    expected = 2.0 * float(((rest @ accuracy) ** 2).sum())
    found = float(((rest @ error) ** 2).sum() - ((rest * noise) ** 2).sum())
    return sqrt(found / expected) if expected > 0.0 and found > 0.0 else 0.0


@jit("f8[:], f8[:,:]")
def compute_confidence_length(mean, covariance):
    """Return the length that 99.7 % of normally distributed vectors in R^3 do not exceed.

    The squared length is approximated by a scaled chi-square variable with the same mean and
    variance (P. Patnaik, Biometrika 36, 1949). The quantile of this variable is approximated
    according to E. Wilson and M. Hilferty, 1931.

    Args:
        mean: (3,) mean of the vectors.
        covariance: (3, 3) covariance of the vectors.
    """
    square, variance = 0.0, 0.0
    for i in range(3):
        square += mean[i] * mean[i] + covariance[i, i]
        for j in range(3):
            variance += 2.0 * covariance[i, j] ** 2 + 4.0 * mean[i] * covariance[i, j] * mean[j]
    if variance <= 0.0 or square <= 0.0:
        return np.sqrt(max(square, 0.0))
    # `inverse` is 2 / (9 n) in the Wilson-Hilferty formula, with n degrees of freedom.
    inverse = variance / (9.0 * square * square)
    return np.sqrt(square * (1.0 - inverse + Z_997 * np.sqrt(inverse)) ** 3)


@jit("f8[:], f8[:,:], f8[:,:], f8, f8[:,:], f8[:], f8[:]")
def compute_bounds(mean, scatter, measured, scatter_part, coupling, held_offset, scale):
    """Return 99.7 % bounds of an offset's translation and rotation, the latter times the depth, m.

    Args:
        mean: (6,) mean offset that the images show, m and rad.
        scatter: (6, 6) covariance of the offset of a single image, m and rad.
        measured: (6, 6) covariance due to the accuracy of the features, scaled by `scale`.
        scatter_part: fraction of `scatter` that remains in the mean.
        coupling: (6, 6) matrix that maps `held_offset` to its contribution to the offset of the
            camera.
        held_offset: (6,) offset along the directions that kinematics hold constant, scaled by
            `scale`.
        scale: (6,) factors 1 for translations, and the target's depth for rotations.
    """
    known, covariance, factors = np.empty(6), np.empty((6, 6)), np.empty(2)
    for block in range(2):
        square, noise = 0.0, 0.0
        for i in range(3 * block, 3 * block + 3):
            square += mean[i] ** 2
            noise += scatter_part * scatter[i, i]
        # OFFSET_FACTORS apply only to the part of the offset that exceeds the noise.
        certainty = 1.0 - noise / square if noise < square else 0.0
        factors[block] = 1.0 + (OFFSET_FACTORS[block] - 1.0) * certainty
    for i in range(6):
        known[i] = factors[i // 3] * mean[i] * scale[i]
        for j in range(6):
            known[i] += coupling[i, j] * held_offset[j]
            covariance[i, j] = scatter_part * scale[i] * scale[j] * scatter[i, j] + measured[i, j]
    return compute_confidence_length(known[:3], covariance[:3, :3]), compute_confidence_length(
        known[3:], covariance[3:, 3:]
    )
