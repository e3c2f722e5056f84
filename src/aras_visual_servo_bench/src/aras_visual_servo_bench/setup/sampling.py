"""Starts: named poses, and poses drawn at random from which the target is wholly in view."""

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

NEWTON_STEPS, INITIAL_GUESSES, GUESS_SPREAD = 12, 4, 0.5  # the last in rad or m
# Of 67 poses that were found ten steps were the most, and after six none was farther than this
# (m, rad): what is still away is out of reach, as most poses drawn are.
EARLY_STEPS, EARLY_TOLERANCE = 6, 0.1
# m and rad. A goal that leans by a milliradian, turned, asks for a roll: an arm that has none comes
# as near as 2e-5, and what is asked for more narrowly can be reached from two headings alone.
POSE_TOLERANCE = 1e-4
DAMPING = 1e-3  # m or rad of the camera per unit of joint


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
    """Joints (n,) of a start: the camera above the target, turned, the target wholly in view.

    Args:
        goal_pose: world_T_camera (4, 4) of the goal, whose attitude is turned about the vertical.
        goal_joints: (n,) from which the joints of a pose are looked for.
        others: further cameras, and what they have to see.
        touched: what the arm at joints (n,) runs into; '': nothing.

    Raises:
        ExperimentError: none was found in `sampler.attempts`.
    """
    random = np.random.default_rng(seed)
    placed = target.world_T_target(0.0)
    vertices = target.shape.vertices() @ placed[:3, :3].T + placed[:3, 3]
    middle = vertices.mean(axis=0)
    why = dict.fromkeys(("out of reach", "out of view", "in something's way"), 0)
    for _ in range(sampler.attempts):
        pose, turn = draw_pose(sampler, goal_pose, middle, random)
        try:
            if not is_in_view(
                target.shape.outline(target.target_T_camera(pose)), camera, sampler.margin
            ):
                raise ViewError("cut off")
            for place, other, own in other_cameras:
                outline = own.shape.outline(own.target_T_camera(place.compute_pose(pose)))
                if not is_in_view(outline, other, sampler.margin):
                    raise ViewError("cut off")
            near = goal_joints
            if isinstance(arm, Arm):  # the last joint turns the camera: begin at the turn drawn
                near = goal_joints.copy()
                near[-1] = _wrap_into_limits(near[-1] - turn, arm.lower[-1], arm.upper[-1])
            joints = _find_joints(arm, pose, near, random)
        except ViewError:
            why["out of view"] += 1
        except ServoError:
            why["out of reach"] += 1
        else:
            if find_collision is None or not find_collision(joints):
                return joints
            why["in something's way"] += 1
    told = ", ".join(f"{count} {what}" for what, count in why.items() if count)
    raise ExperimentError(
        f"no start found in {sampler.attempts} attempts ({told}): make start.height, side, turn "
        "or tilt smaller"
    )


def _wrap_into_limits(angle: float, lower: float, upper: float) -> float:
    """The angle, a turn more or a turn less, rad, whichever is within the limits first."""
    for turns in (0.0, 2.0 * np.pi, -2.0 * np.pi):
        if lower <= angle + turns <= upper:
            return angle + turns
    return float(np.clip(angle, lower, upper))


def _find_joints(
    arm: Arm | FreeBody, pose: np.ndarray, near: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Joints (n,) of a pose by Newton's method alone: what is hard to find is no start.

    Raises:
        UnreachableError: they are not found, or beyond a limit.
    """
    count = len(near)
    # Least squares of these rows are damped: the elbow may come near to stretched.
    rows, error = np.vstack([np.zeros((6, count)), DAMPING * np.eye(count)]), np.zeros(6 + count)
    for _ in range(INITIAL_GUESSES):
        # From a stretched elbow the method finds no way: hence the bends.
        q = near + random.uniform(-GUESS_SPREAD, GUESS_SPREAD, len(near)) * (
            arm.upper - arm.lower < np.inf
        )
        q[-1] = near[-1]
        for step in range(NEWTON_STEPS):
            now, rows[:6] = arm.pose_and_jacobian(q)
            error[:6] = logarithm(relative_pose(now, pose))
            left = max(map(abs, error.tolist()))
            if step >= EARLY_STEPS and left > EARLY_TOLERANCE:
                break
            if left < POSE_TOLERANCE:
                if ((q < arm.lower) | (q > arm.upper)).any():
                    break
                return q
            moved = solve_least_squares(rows, error, 0.0)
            q = q + np.minimum(np.maximum(moved, -0.5), 0.5)
    raise UnreachableError("no joints of the arm give this pose", float("nan"))


def draw_pose(
    sampler: Sampler, goal_pose: np.ndarray, middle: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, float]:
    """A pose (4, 4) of the sampler's ranges, and its turn about the vertical, rad."""
    x, y = random.uniform(-sampler.side, sampler.side, 2)
    height = random.uniform(*sampler.height)
    turn = random.uniform(-sampler.turn, sampler.turn)
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_rpy(0.0, 0.0, turn) @ goal_pose[:3, :3]
    pose[:3, 3] = middle + (x, y, height)
    if sampler.tilt:
        lean, towards = random.uniform(0.0, sampler.tilt), random.uniform(-np.pi, np.pi)
        axis = lean * np.array([np.cos(towards), np.sin(towards), 0.0])
        pose = pose @ exponential((0.0, 0.0, 0.0, *axis))
    return pose, turn
