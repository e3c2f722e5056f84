"""Draw random starts from which the whole target is in view and that the arm can reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from aras_visual_servo_base.poses import exponential, logarithm, relative_pose, rotation_from_rpy
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.errors import ServoError, UnreachableError
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.algebra import solve_least_squares

from ..errors import ExperimentError, ViewError
from ..experiment.cameras import is_in_view
from ..experiment.experiment import Sampler
from ..plants.base import CameraPlacement
from ..plants.free_body import FreeBody
from ..targets.geometry import PlacedTarget

NEWTON_STEPS, INITIAL_GUESSES, GUESS_SPREAD = 12, 4, 0.5  # GUESS_SPREAD in rad or m
# Newton's method stops early if the error after EARLY_STEPS exceeds EARLY_TOLERANCE (m, rad). Of 67
# poses that were found, none needed more than ten steps, and none had a larger error after six.
EARLY_STEPS, EARLY_TOLERANCE = 6, 0.1
# m and rad. A goal that is tilted by a milliradian and rotated about the vertical needs a small
# roll. An arm that cannot roll then keeps an error of 2e-5; a narrower tolerance would leave only
# two reachable headings.
POSE_TOLERANCE = 1e-4
DAMPING = 1e-3  # of the least squares; m or rad of the camera per unit of joint


def draw_start(
    sampler: Sampler,
    arm: Arm | FreeBody,
    goal_pose: np.ndarray,
    goal_joints: np.ndarray,
    target: PlacedTarget,
    camera: CameraModel,
    seed: int,
    other_cameras: Sequence[tuple[CameraPlacement, CameraModel, PlacedTarget]] = (),
    find_collision: Callable[[np.ndarray], str] | None = None,
) -> np.ndarray:
    """Draw the joints (n,) of a start with the camera above the target and the target in view.

    Args:
        goal_pose: world_T_camera (4, 4) of the goal, whose orientation is rotated about the
            vertical.
        goal_joints: (n,) from which the search for joints starts.
        other_cameras: placement, model and target of further cameras, which also have to see their
            target.
        find_collision: describes a collision of the arm at joints (n,); '' without collision.

    Raises:
        ExperimentError: no start was found in `sampler.attempts` attempts.
    """
    random = np.random.default_rng(seed)
    world_T_target = target.world_T_target(0.0)
    vertices = target.shape.vertices() @ world_T_target[:3, :3].T + world_T_target[:3, 3]
    middle = vertices.mean(axis=0)
    failures = dict.fromkeys(("out of reach", "out of view", "in collision"), 0)
    for _ in range(sampler.attempts):
        pose, turn = draw_pose(sampler, goal_pose, middle, random)
        try:
            if not is_in_view(
                target.shape.outline(target.target_T_camera(pose)), camera, sampler.margin
            ):
                raise ViewError("cut off")
            for placement, model, own in other_cameras:
                outline = own.shape.outline(own.target_T_camera(placement.compute_pose(pose)))
                if not is_in_view(outline, model, sampler.margin):
                    raise ViewError("cut off")
            near = goal_joints
            if isinstance(arm, Arm):  # start with the drawn rotation, which the last joint makes
                near = goal_joints.copy()
                near[-1] = _wrap_into_limits(near[-1] - turn, arm.lower[-1], arm.upper[-1])
            joints = _find_joints(arm, pose, near, random)
        except ViewError:
            failures["out of view"] += 1
        except ServoError:
            failures["out of reach"] += 1
        else:
            if find_collision is None or not find_collision(joints):
                return joints
            failures["in collision"] += 1
    counts = ", ".join(f"{count} {reason}" for reason, count in failures.items() if count)
    raise ExperimentError(
        f"no start found in {sampler.attempts} attempts ({counts}): make start.height, side, turn "
        "or tilt smaller"
    )


def _wrap_into_limits(angle: float, lower: float, upper: float) -> float:
    """Return the angle, or the angle plus or minus 2 pi, whichever is within the limits (rad)."""
    for turns in (0.0, 2.0 * np.pi, -2.0 * np.pi):
        if lower <= angle + turns <= upper:
            return angle + turns
    return float(np.clip(angle, lower, upper))


def _find_joints(
    arm: Arm | FreeBody, pose: np.ndarray, near: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Find joints (n,) of a pose with Newton's method from a few initial guesses.

    Raises:
        UnreachableError: no joints were found, or they are beyond a limit.
    """
    count = len(near)
    # The lower rows damp the least squares, because the elbow may be nearly stretched.
    rows, error = np.vstack([np.zeros((6, count)), DAMPING * np.eye(count)]), np.zeros(6 + count)
    for _ in range(INITIAL_GUESSES):
        # Newton's method fails at a stretched elbow: bend it at random.
        q = near + random.uniform(-GUESS_SPREAD, GUESS_SPREAD, len(near)) * (
            arm.upper - arm.lower < np.inf
        )
        q[-1] = near[-1]
        for step in range(NEWTON_STEPS):
            current, rows[:6] = arm.pose_and_jacobian(q)
            error[:6] = logarithm(relative_pose(current, pose))
            largest = max(map(abs, error.tolist()))
            if step >= EARLY_STEPS and largest > EARLY_TOLERANCE:
                break
            if largest < POSE_TOLERANCE:
                if ((q < arm.lower) | (q > arm.upper)).any():
                    break
                return q
            correction = solve_least_squares(rows, error, 0.0)
            q = q + np.minimum(np.maximum(correction, -0.5), 0.5)
    raise UnreachableError("no joints of the arm give this pose", float("nan"))


def draw_pose(
    sampler: Sampler, goal_pose: np.ndarray, middle: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Draw a camera pose (4, 4) in the sampler's ranges; also return its rotation about z, rad.

    Args:
        goal_pose: world_T_camera (4, 4) at the goal, whose orientation is rotated.
        middle: (3,) centre of the target in the world, m.
    """
    x, y = random.uniform(-sampler.side, sampler.side, 2)
    height = random.uniform(*sampler.height)
    turn = random.uniform(-sampler.turn, sampler.turn)
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_rpy(0.0, 0.0, turn) @ goal_pose[:3, :3]
    pose[:3, 3] = middle + (x, y, height)
    if sampler.tilt:
        tilt, azimuth = random.uniform(0.0, sampler.tilt), random.uniform(-np.pi, np.pi)
        axis = tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        pose = pose @ exponential((0.0, 0.0, 0.0, *axis))
    return pose, turn
