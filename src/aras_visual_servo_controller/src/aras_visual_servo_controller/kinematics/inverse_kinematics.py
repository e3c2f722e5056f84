"""Numerical inverse kinematics, for starts and goals that are given as camera poses."""

from collections.abc import Callable

import numpy as np
import scipy

from aras_visual_servo_base.poses import rotation_vector, rotation_vector_rate, skew

from ..errors import UnreachableError

ROTATION_LENGTH = 0.1  # length that counts as much as a rotation by 1 rad, m
ATTEMPTS = 16  # number of initial guesses; the first one is given by the caller


# Function that computes the pose (4, 4) and the Jacobian (6, n) of the camera for joints (n,), such
# as `Arm.pose_and_jacobian`.
PoseAndJacobian = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
# Function that returns the cost >= 0 of joints (n,); 0 is the best.
Cost = Callable[[np.ndarray], float]


def solve_inverse_kinematics(
    pose_and_jacobian: PoseAndJacobian,
    lower: np.ndarray,
    upper: np.ndarray,
    world_T_camera: np.ndarray,
    q0: np.ndarray,
    tolerance: float,
    cost: Cost | None = None,
) -> np.ndarray:
    """Find joints (n,) within the limits for a camera pose; redundant joints stay near q0.

    See `Arm.inverse_kinematics` for the arguments.

    Raises:
        UnreachableError: no solution was found. The error contains the smallest remaining distance.
        ValueError: `world_T_camera` is not a rigid transform.
    """
    goal = np.asarray(world_T_camera, float)
    rotation = goal[:3, :3] if goal.shape == (4, 4) else np.zeros((3, 3))
    if not (np.isfinite(goal).all() and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)):
        raise ValueError("a camera pose must be a rigid transform, an array (4, 4)")
    q0 = np.asarray(q0, float)
    low = np.where(np.isfinite(lower), lower, q0 - 2.0 * np.pi)
    high = np.where(np.isfinite(upper), upper, q0 + 2.0 * np.pi)
    random = np.random.default_rng(0)
    best: tuple[float, np.ndarray] | None = None
    cheapest: tuple[float, np.ndarray] | None = None
    guess = q0
    for attempt in range(ATTEMPTS):
        guess = np.clip(guess, low, high)
        # least_squares takes small steps, so it finds a solution near the initial guess.
        found = scipy.optimize.least_squares(
            _compute_residual,
            np.clip(guess, low + 1e-9, high - 1e-9),
            _compute_residual_jacobian,
            bounds=(low, high),
            args=(pose_and_jacobian, goal),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            max_nfev=80,
        )
        left = float(np.linalg.norm(found.fun))
        if best is None or left < best[0]:
            best = left, found.x
        if left < tolerance:
            costs = 0.0 if cost is None else cost(found.x)
            if costs <= 0.0:
                return found.x
            if cheapest is None or costs < cheapest[0]:
                cheapest = costs, found.x
        # The range of random guesses around q0 grows with each attempt. It is at most half a turn
        # to each side, or half of the joint's range.
        reach = np.minimum(high - low, 2.0 * np.pi) * min(1.0, 0.2 + attempt / ATTEMPTS)
        guess = q0 + random.uniform(-0.5, 0.5, len(q0)) * reach
    if cheapest is not None:
        return cheapest[1]
    residual = _compute_residual(best[1], pose_and_jacobian, goal)
    distance = float(np.linalg.norm(residual[:3]))
    turn = float(np.linalg.norm(residual[3:])) / ROTATION_LENGTH
    x, y, z = goal[:3, 3]
    raise UnreachableError(
        f"camera position ({x:.4f}, {y:.4f}, {z:.4f}) m with its orientation is out of the arm's "
        f"reach: the nearest posture found is {distance * 1e3:.3g} mm and {np.degrees(turn):.3g} "
        "degrees away",
        distance=distance,
    )


def _compute_residual(
    q: np.ndarray, pose_and_jacobian: PoseAndJacobian, goal: np.ndarray
) -> np.ndarray:
    """Compute the pose error (6,) in the camera frame.

    It consists of the translation and of the rotation times ROTATION_LENGTH.
    """
    pose, _ = pose_and_jacobian(q)
    place = pose[:3, :3].T @ (goal[:3, 3] - pose[:3, 3])
    turn = rotation_vector(pose[:3, :3].T @ goal[:3, :3])
    return np.concatenate([place, ROTATION_LENGTH * turn])


def _compute_residual_jacobian(
    q: np.ndarray, pose_and_jacobian: PoseAndJacobian, goal: np.ndarray
) -> np.ndarray:
    """Compute the Jacobian (6, n) of the pose error that `_compute_residual` returns."""
    pose, jacobian = pose_and_jacobian(q)
    camera_R_goal = pose[:3, :3].T @ goal[:3, :3]
    place = pose[:3, :3].T @ (goal[:3, 3] - pose[:3, 3])
    turn = rotation_vector(camera_R_goal)
    rows = np.empty_like(jacobian)
    rows[:3] = -jacobian[:3] + skew(place) @ jacobian[3:]
    rows[3:] = -ROTATION_LENGTH * rotation_vector_rate(turn).T @ jacobian[3:]
    return rows
