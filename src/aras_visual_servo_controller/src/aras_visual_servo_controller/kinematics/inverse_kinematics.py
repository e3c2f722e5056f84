"""Joints for a pose of the camera, found numerically: for starts and goals given as poses."""

from collections.abc import Callable

import numpy as np
import scipy

from aras_visual_servo_base.poses import rotation_vector, rotation_vector_rate, skew

from ..errors import UnreachableError

ROTATION_LENGTH = 0.1  # m that weigh as much as one radian
ATTEMPTS = 16  # beginnings tried, the given one first


# Pose (4, 4) and Jacobian (6, n) of the camera at joints (n,): Arm.view.
PoseAndJacobian = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
# What speaks against joints (n,), from 0, nothing, on.
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
    """Joints (n,) within the limits, see `Arm.inverse`; redundant joints stay near q0.

    Raises:
        UnreachableError: with the distance that is left at the best joints found.
        ValueError: the pose is not one.
    """
    goal = np.asarray(world_T_camera, float)
    rotation = goal[:3, :3] if goal.shape == (4, 4) else np.zeros((3, 3))
    if not (np.isfinite(goal).all() and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)):
        raise ValueError("a pose of the camera has to be a rigid (4, 4) array")
    q0 = np.asarray(q0, float)
    low = np.where(np.isfinite(lower), lower, q0 - 2.0 * np.pi)
    high = np.where(np.isfinite(upper), upper, q0 + 2.0 * np.pi)
    random = np.random.default_rng(0)
    best: tuple[float, np.ndarray] | None = None
    cheapest: tuple[float, np.ndarray] | None = None
    begin = q0
    for attempt in range(ATTEMPTS):
        begin = np.clip(begin, low, high)
        # From the given joints the steps are small where possible: they answer what is near.
        found = scipy.optimize.least_squares(
            _compute_residual,
            np.clip(begin, low + 1e-9, high - 1e-9),
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
        # A joint that may turn for ever is tried within a turn of where it was.
        reach = np.minimum(high - low, 2.0 * np.pi) * min(1.0, 0.2 + attempt / ATTEMPTS)
        begin = q0 + random.uniform(-0.5, 0.5, len(q0)) * reach
    if cheapest is not None:
        return cheapest[1]
    residual = _compute_residual(best[1], pose_and_jacobian, goal)
    distance = float(np.linalg.norm(residual[:3]))
    turn = float(np.linalg.norm(residual[3:])) / ROTATION_LENGTH
    x, y, z = goal[:3, 3]
    raise UnreachableError(
        f"camera position ({x:.4f}, {y:.4f}, {z:.4f}) m with its attitude is out of the arm's "
        f"reach: the nearest posture found is {distance * 1e3:.3g} mm and {np.degrees(turn):.3g} "
        "degrees away",
        distance=distance,
    )


def _compute_residual(
    q: np.ndarray, pose_and_jacobian: PoseAndJacobian, goal: np.ndarray
) -> np.ndarray:
    """What is left to the goal, in the camera's frame: place (m), then LENGTH x rotation."""
    pose, _ = pose_and_jacobian(q)
    place = pose[:3, :3].T @ (goal[:3, 3] - pose[:3, 3])
    turn = rotation_vector(pose[:3, :3].T @ goal[:3, :3])
    return np.concatenate([place, ROTATION_LENGTH * turn])


def _compute_residual_jacobian(
    q: np.ndarray, pose_and_jacobian: PoseAndJacobian, goal: np.ndarray
) -> np.ndarray:
    """Of the residual, (6, n)."""
    pose, jacobian = pose_and_jacobian(q)
    camera_R_goal = pose[:3, :3].T @ goal[:3, :3]
    place = pose[:3, :3].T @ (goal[:3, 3] - pose[:3, 3])
    turn = rotation_vector(camera_R_goal)
    rows = np.empty_like(jacobian)
    rows[:3] = -jacobian[:3] + skew(place) @ jacobian[3:]
    rows[3:] = -ROTATION_LENGTH * rotation_vector_rate(turn).T @ jacobian[3:]
    return rows
