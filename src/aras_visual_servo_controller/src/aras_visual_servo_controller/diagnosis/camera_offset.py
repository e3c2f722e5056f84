"""Offset of the camera from its goal, averaged over several noisy images.

Near the goal the error is e = s - s* = L x, where x (6,) is the camera's offset from the goal. The
noise is averaged over several images. As the camera moves between these images, the offset L^+ e of
each image is transformed to the present camera pose by kinematics. If the target moves with the
camera, the offsets scatter less without this transformation. In this case they are averaged without
it.

The offsets of m images are the rows of an array (m, 22): the offset L^+ e (6,) in the camera's
frame, m and rad, and `world_T_camera` (16,), NaN if the pose is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..goals.goal import DEFAULT_DEPTH
from ..kinematics.algebra import (
    is_task_finite,
    multiply,
    multiply_vector,
    solve_least_squares,
    svd,
)

if TYPE_CHECKING:
    from ..schemes.base import SchemeOutput

# Largest offset from the goal of a camera that has arrived: translation as a fraction of the
# target's depth, rotation in rad. The limit is needed in addition to the tolerances of the
# features, because some directions of camera motion hardly change the features. Times the
# OFFSET_FACTORS of offset_statistics.py, it is below the NEGLIGIBLE_UNCERTAINTY of
# pose_uncertainty.py.
GOAL_TOLERANCE = (8e-4, 3.5e-3)
# After its arrival, the camera may exceed the tolerances of the features and GOAL_TOLERANCE by this
# factor.
HYSTERESIS = 1.5
# The uncertainty of a mean offset is estimated as this number of its standard deviations.
KNOWN_DEVIATIONS = 2.0
FEW_IMAGES = 5  # smallest number of images that are averaged, if there are so many
MAX_WINDOW = 120  # largest number of images that are averaged
# Largest difference between the camera's offset in the latest image and the mean offset, in
# standard deviations. A larger difference shows that kinematics do not describe the camera's
# motion.
OUTLIER_DEVIATIONS = 5.0
NOISE_STEPS = 8  # minimum number of images from which the noise is estimated
# If L has more rows than this, least-squares problems with L are solved by the normal equations.
MAX_ROWS = 64
# A direction of camera motion is not measured if its singular value of L is below this fraction of
# the largest one.
RANK_TOLERANCE = 1e-6
OFFSET_ROUNDING = 1e-9  # numerical tolerance of angles (rad) and lengths (m)
NO_POSE = np.full((4, 4), np.nan)


class PoseOffsets(NamedTuple):
    """Mean offset of the camera from its goal over several noisy images.

    Attributes:
        mean: (6,) mean offset, m and rad.
        scatter: (6, 6) covariance of the offset of a single image.
        count: number of images.
        speed: speed of the camera relative to its goal before the last image, m/s and rad/s.
    """

    mean: np.ndarray
    scatter: np.ndarray
    count: int
    speed: tuple[float, float]


def compute_mean_offset(
    stamps: np.ndarray,
    rows: np.ndarray,
    observable: np.ndarray,
    settled_images: int,
    was_reached: bool,
    depth: float = DEFAULT_DEPTH,
) -> tuple[PoseOffsets, str]:
    """Compute the mean offset of the camera from its goal, and describe why it is too large.

    Args:
        stamps: (m,) stamps of the images, s.
        rows: (m, 22) offset and pose of each image, see the module.
        observable: L^+ L (6, 6), which maps a camera motion to the change of the offset L^+ e.
        settled_images: number of images since the features settled.
        was_reached: whether the camera had arrived at the previous image.
        depth: depth of the target at the goal, m.

    Returns:
        The mean offset at the last image; a text that says why it is too large, empty if it is not.
    """
    near = GOAL_TOLERANCE[0] * depth, GOAL_TOLERANCE[1]
    mean, scatter, count, is_enough, noise, deviations = _average_latest(
        rows, observable, min(settled_images, FEW_IMAGES), near[0], near[1], depth
    )
    off = _compute_lengths(mean.tolist())
    unknown = _compute_lengths(deviations.tolist())
    offsets = PoseOffsets(mean, scatter, count, compute_speed(stamps, rows))
    if not (is_enough or was_reached) and len(rows) < MAX_WINDOW:
        return offsets, (
            "the features are within their tolerances, but they scatter: the pose of the camera is "
            f"known only to {1e3 * unknown[0]:.2f} mm and {np.degrees(unknown[1]):.2f} degrees"
        )
    limits = [HYSTERESIS * a + u if was_reached else max(a, u) for a, u in zip(
        near, unknown, strict=True
    )]  # fmt: skip
    if off[0] > limits[0] or off[1] > limits[1]:
        return offsets, (
            "the features are within their tolerances, but according to L the camera is "
            f"{1e3 * off[0]:.2f} mm and {np.degrees(off[1]):.2f} degrees from its goal"
        )
    # The mean over all settled images has less noise than that over the latest images. But while
    # the camera still approaches its goal, the older offsets are too large.
    if settled_images > count:
        is_better, mean, scatter, all_count = _average_all(
            rows, observable, settled_images, scatter, count, noise
        )
        if is_better:
            offsets = offsets._replace(mean=mean, scatter=scatter, count=all_count)
    return offsets, ""


def compute_speed(stamps: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """Return the camera's speed relative to its goal between the last two images, m/s and rad/s.

    The speed is estimated from kinematics and from the images, and the smaller estimate is
    returned. The first is too large if the target moves with the camera, the second if the images
    are noisy.

    Args:
        stamps, rows: see `compute_mean_offset`.
    """
    if len(rows) < 2 or stamps[-1] <= stamps[-2]:
        return 0.0, 0.0
    by_images = _compute_lengths((rows[-1, :6] - rows[-2, :6]).tolist())
    by_kinematics = _compute_lengths(_compute_motion_since(rows, len(rows) - 2).tolist())
    dt = float(stamps[-1] - stamps[-2])
    # If the camera poses are unknown, the estimate by kinematics is NaN, and `min` returns the
    # first argument, which is the estimate from the images.
    return min(by_images[0], by_kinematics[0]) / dt, min(by_images[1], by_kinematics[1]) / dt


def compute_offset(
    scheme_output: SchemeOutput, free: np.ndarray, depth: float, pose: np.ndarray | None
) -> np.ndarray | None:
    """Return the row (22,) of one image: the camera's offset L^+ e from the goal, and its pose.

    The offset has only components along the directions `free` (f, 6) in which the task moves the
    camera. Return None if the scheme gives no L for its error.
    """
    L = scheme_output.L
    error = scheme_output.error if scheme_output.residual is None else scheme_output.residual
    if L is None or L.shape != (len(error), 6):
        return None
    L, error = np.asarray(L, float), np.asarray(error, float)
    if len(L) > MAX_ROWS:
        if not is_task_finite(L, error):
            return None
        scale = np.array((1.0, 1.0, 1.0, depth, depth, depth))
        L_free = (L / scale) @ free.T
        found = solve_least_squares(L_free.T @ L_free, L_free.T @ error, RANK_TOLERANCE**2)
        return np.append(found @ free / scale, NO_POSE if pose is None else pose)
    row = np.empty(22)
    is_found = _solve_offset(L, error, free, depth, NO_POSE if pose is None else pose, row)
    return row if is_found else None


def compute_observable(scheme_output: SchemeOutput, free: np.ndarray, depth: float) -> np.ndarray:
    """Return the matrix L^+ L (6, 6), which maps a camera motion to the change of the offset L^+ e.

    See `compute_offset` for the arguments.
    """
    scale = np.array((1.0, 1.0, 1.0, depth, depth, depth))
    L = np.asarray(scheme_output.L, float) / scale
    L_free, tolerance = L @ free.T, RANK_TOLERANCE
    if len(L) > MAX_ROWS:
        L, L_free, tolerance = L_free.T @ L, L_free.T @ L_free, RANK_TOLERANCE**2
    u, s, vt = svd(L_free)
    is_measured = s > tolerance * s[0]
    inverse = vt[is_measured].T / s[is_measured] @ u[:, is_measured].T
    return free.T @ inverse @ L * scale / scale[:, None]


def _compute_lengths(offset: Sequence[float]) -> tuple[float, float]:
    """Return the lengths of an offset's translation and rotation, m and rad."""
    return hypot(*offset[:3]), hypot(*offset[3:])


@jit("f8[:,:], i8")
def _compute_motion_since(rows, i):
    """Return the camera's motion (6,) from image i to the last image, in the last camera frame.

    The motion is small, so the rotation vector is the skew-symmetric part of the rotation matrix.

    Args:
        rows: (m, 22) offset and pose of each image, see the module.
    """
    last, k = rows.shape[0] - 1, 6
    motion, rotation = np.empty(6), np.zeros((3, 3))
    for a in range(3):
        motion[a] = 0.0
        for c in range(3):
            motion[a] += rows[last, k + 4 * c + a] * (
                rows[last, k + 4 * c + 3] - rows[i, k + 4 * c + 3]
            )
        for b in range(3):
            for c in range(3):
                rotation[a, b] += rows[i, k + 4 * c + a] * rows[last, k + 4 * c + b]
    motion[3] = 0.5 * (rotation[2, 1] - rotation[1, 2])
    motion[4] = 0.5 * (rotation[0, 2] - rotation[2, 0])
    motion[5] = 0.5 * (rotation[1, 0] - rotation[0, 1])
    return motion


@jit("f8[:,:], f8[:,:], i8, f8[:]")
def _average_offsets(rows, observable, count, limit):
    """Compute the mean offset of the latest images, transformed to the present camera pose.

    Args:
        rows: (m, 22) offset and pose of each image, the present one last; see the module.
        observable: L^+ L (6, 6), which maps a camera motion to the change of the offset L^+ e.
        count: smallest number of images to average. The number is doubled until the standard
            deviation of the mean is within `limit`.
        limit: (2,) largest standard deviation of the mean, m and rad.

    Returns:
        The mean (6,); the covariance (6, 6) of the offsets; the number of averaged images; whether
        the standard deviation of the mean is within `limit`.
    """
    m = rows.shape[0]
    count = min(max(count, 1), m)
    while True:
        # Sums of the offsets as measured (index 0), and of the offsets transformed to the camera's
        # present pose (index 1).
        total, square = np.zeros((2, 6)), np.zeros((2, 6, 6))
        off = np.empty((2, 6))
        for i in range(m - count, m):
            motion = _compute_motion_since(rows, i)
            for a in range(6):
                off[0, a] = off[1, a] = rows[i, a]
                for b in range(6):
                    off[1, a] += observable[a, b] * motion[b]
            for n in range(2):
                for a in range(6):
                    total[n, a] += off[n, a]
                    for b in range(6):
                        square[n, a, b] += off[n, a] * off[n, b]
        scatter, variances = np.empty(2), np.zeros((2, 2))
        for n in range(2):
            for a in range(6):
                mean = total[n, a] / count
                variances[n, a // 3] += max(square[n, a, a] / count - mean * mean, 0.0) / count
            scatter[n] = variances[n, 0] / limit[0] ** 2 + variances[n, 1] / limit[1] ** 2
        # If camera poses are unknown, scatter[1] is NaN and n becomes 0.
        n = 1 if scatter[1] <= scatter[0] else 0
        is_enough = variances[n, 0] <= limit[0] ** 2 and variances[n, 1] <= limit[1] ** 2
        if is_enough or count == m:
            mean, scattered = total[n] / count, square[n] / count
            for a in range(6):
                for b in range(6):
                    scattered[a, b] -= mean[a] * mean[b]
            return mean, scattered, count, is_enough
        count = min(2 * count, m)


@jit("f8[:,:], i8, f8")
def _estimate_noise(rows, count, depth):
    """Estimate the standard deviation (6,) of the offset of one image from the last `count` rows.

    The estimate uses the differences of successive offsets. If there are enough images, it uses
    second differences, which a slow motion hardly changes.
    """
    m = len(rows)
    first = max(m - count, 0)
    order = 2 if m - first > 2 else 1
    steps, noise = max(m - first - order, 1), np.zeros(6)
    for a in range(6):
        for i in range(first + order, m):
            step = rows[i, a] - rows[i - 1, a]
            if order == 2:
                step -= rows[i - 1, a] - rows[i - 2, a]
            noise[a] += step * step
        noise[a] = np.sqrt(noise[a] / steps / (6.0 if order == 2 else 2.0))
        noise[a] += OFFSET_ROUNDING * depth / DEFAULT_DEPTH if a < 3 else OFFSET_ROUNDING
    return noise


@jit("f8[:,:], f8[:], f8[:]", allocates=False)
def _is_outlier(rows, mean, noise):
    """Return whether the last offset differs from a mean (6,) by more than the noise (6,)."""
    for a in range(6):
        if abs(rows[len(rows) - 1, a] - mean[a]) > OUTLIER_DEVIATIONS * noise[a]:
            return True
    return False


@jit("f8[:,:], f8[:,:], i8, f8, f8, f8")
def _average_latest(rows, observable, count, near_distance, near_angle, depth):
    """Average the offsets of the latest images, so many that the mean is known accurately enough.

    Args:
        rows, observable: see `_average_offsets`.
        count: smallest number of images to average.
        near_distance, near_angle: largest uncertainty of the mean, m and rad.
        depth: depth of the target at the goal, m.

    Returns:
        The mean (6,); the covariance (6, 6) of the offsets; the number of averaged images; whether
        the mean is known accurately enough; the standard deviation (6,) of the offset of one image;
        the uncertainty (6,) of the mean.
    """
    limit = np.empty(2)
    limit[0], limit[1] = near_distance / KNOWN_DEVIATIONS, near_angle / KNOWN_DEVIATIONS
    mean, scatter, count, is_enough = _average_offsets(rows, observable, count, limit)
    noise, unknown = _estimate_noise(rows, max(count, NOISE_STEPS), depth), np.empty(6)
    if _is_outlier(rows, mean, noise):
        count = 1
        for a in range(6):
            mean[a] = rows[len(rows) - 1, a]
            for b in range(6):
                scatter[a, b] = noise[a] * noise[a] if a == b else 0.0
    for a in range(6):
        # Negative variances, which rounding errors can cause, are set to 0.
        unknown[a] = KNOWN_DEVIATIONS * np.sqrt(max(scatter[a, a], 0.0) / count)
    return mean, scatter, count, is_enough, noise, unknown


@jit("f8[:,:], f8[:,:], i8, f8[:,:], i8, f8[:]")
def _average_all(rows, observable, count, latest_scatter, latest_count, noise):
    """Average the offsets of all settled images, and compare this mean with that of the latest.

    Args:
        rows, observable: see `_average_offsets`.
        count: number of settled images.
        latest_scatter, latest_count: covariance (6, 6) and number of the latest offsets.
        noise: (6,) standard deviation of the offset of one image, m and rad.

    Returns:
        Whether the mean of all offsets is more accurate; this mean (6,); the covariance (6, 6) of
        the offsets; their number.
    """
    mean, scatter, count, _ = _average_offsets(rows, observable, count, np.full(2, np.inf))
    is_better = count > latest_count and not _is_outlier(rows, mean, noise)
    for a in (0, 3):
        by_all, by_latest = 0.0, 0.0
        for i in range(a, a + 3):
            by_all += scatter[i, i] / count
            by_latest += latest_scatter[i, i] / latest_count
        is_better &= by_all < by_latest
    return is_better, mean, scatter, count


@jit("f8[:,:], f8[:], f8[:,:], f8, f8[:,:], f8[::1]")
def _solve_offset(L, error, free, depth, pose, row):
    """Write the row (22,) of `compute_offset` for L (k, 6), error (k,) and pose (4, 4).

    Return whether L and the error are finite.
    """
    if not is_task_finite(L, error):
        return False
    scaled, turned = L.copy(), free.copy()
    for j in range(3, 6):
        for i in range(len(L)):
            scaled[i, j] /= depth
        for i in range(len(free)):
            turned[i, j] /= depth
    found = solve_least_squares(multiply(scaled, free.T), error, RANK_TOLERANCE)
    offset = multiply_vector(turned.T, found)
    for a in range(6):
        row[a] = offset[a]
    for i in range(4):
        for j in range(4):
            row[6 + 4 * i + j] = pose[i, j]
    return True
