"""Draw random starts that the arm can reach and from which the complete target is in view."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from aras_visual_servo_base.poses import exponential, logarithm, relative_pose, rotation_from_rpy
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.errors import ServoError, UnreachableError
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.algebra import solve_least_squares

from ..errors import ExperimentError, OutOfViewError
from ..experiment.cameras import is_in_view
from ..experiment.experiment import RandomStart
from ..plants.base import CameraPlacement
from ..plants.free_camera_kinematics import FreeCameraKinematics
from ..targets.geometry import PlacedTarget

NEWTON_STEPS = 12  # maximum number of steps of Newton's method from one initial guess
INITIAL_GUESSES = 4
# Maximum random deviation of an initial guess from the given joint positions, rad or m.
GUESS_SPREAD = 0.5
# Newton's method stops after EARLY_STEPS steps if the error of the pose is then larger than
# EARLY_TOLERANCE, m and rad. For 67 reachable poses, the error was smaller after six steps, and no
# search needed more than ten steps.
EARLY_STEPS, EARLY_TOLERANCE = 6, 0.1
# Maximum error of the pose of the camera, m and rad. An arm that cannot roll its camera cannot
# reach a rotated start exactly if the goal is slightly tilted: with a tilt of 1 mrad, the error is
# 2e-5. Such starts are allowed.
POSE_TOLERANCE = 1e-4
# Weight of joint motions in the damped least squares; the error of the camera pose has the weight
# 1.
DAMPING = 1e-3


def draw_start(
    sampler: RandomStart,
    arm: Arm | FreeCameraKinematics,
    goal_pose: np.ndarray,
    goal_joints: np.ndarray,
    target: PlacedTarget,
    camera: CameraModel,
    seed: int,
    other_cameras: Sequence[tuple[CameraPlacement, CameraModel, PlacedTarget]] = (),
    find_collision: Callable[[np.ndarray], str] | None = None,
) -> np.ndarray:
    """Draw the joint positions (n,) of a random start with the target in view.

    Args:
        sampler: ranges of the start.
        arm: true kinematics of the control camera.
        goal_pose: world_T_camera (4, 4) at the goal; the orientation at the start is this
            orientation, rotated about the vertical.
        goal_joints: joint positions (n,) at the goal, from which the search for joints starts.
        target: target of the control camera.
        camera: true intrinsics of the control camera.
        seed: seed of the random numbers.
        other_cameras: placement, intrinsics and target of each other camera; their targets have to
            be in view, too.
        find_collision: function that describes a collision of the arm at joint positions (n,) and
            returns '' if there is none; None: collisions are not checked.

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
                raise OutOfViewError("cut off")
            for placement, model, own in other_cameras:
                outline = own.shape.outline(own.target_T_camera(placement.compute_pose(pose)))
                if not is_in_view(outline, model, sampler.margin):
                    raise OutOfViewError("cut off")
            near = goal_joints
            # `turn` rotates the camera about the vertical, so the initial guess rotates the last
            # joint by -turn.
            if isinstance(arm, Arm):
                near = goal_joints.copy()
                near[-1] = _wrap_into_limits(near[-1] - turn, arm.lower[-1], arm.upper[-1])
            joints = _find_joints(arm, pose, near, random)
        except OutOfViewError:
            failures["out of view"] += 1
        except ServoError:
            failures["out of reach"] += 1
        else:
            if find_collision is None or not find_collision(joints):
                return joints
            failures["in collision"] += 1
    counts = ", ".join(f"{count} {reason}" for reason, count in failures.items() if count)
    raise ExperimentError(
        f"no start found in {sampler.attempts} attempts ({counts}): reduce start.height, "
        "start.side, start.turn or start.tilt"
    )


def _wrap_into_limits(angle: float, lower: float, upper: float) -> float:
    """Return the angle, the angle + 2 pi or the angle - 2 pi: the one within the limits (rad).

    If none of them is within the limits, return the limit that is nearest to the angle."""
    for turns in (0.0, 2.0 * np.pi, -2.0 * np.pi):
        if lower <= angle + turns <= upper:
            return angle + turns
    return float(np.clip(angle, lower, upper))


def _find_joints(
    arm: Arm | FreeCameraKinematics, pose: np.ndarray, near: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Find joint positions (n,) that put the camera at `pose`, by Newton's method.

    Args:
        pose: world_T_camera (4, 4).
        near: joint positions (n,) around which the initial guesses are drawn.
        random: random generator of the guesses.

    Raises:
        UnreachableError: no joints within the limits were found.
    """
    count = len(near)
    # The lower rows of the least-squares matrix damp the joint motions, because the problem is
    # nearly singular if the elbow is almost stretched.
    rows, error = np.vstack([np.zeros((6, count)), DAMPING * np.eye(count)]), np.zeros(6 + count)
    for _ in range(INITIAL_GUESSES):
        # Newton's method fails at a stretched elbow, so the initial guess bends the elbow randomly.
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
    raise UnreachableError("the arm cannot reach this pose", float("nan"))


def draw_pose(
    sampler: RandomStart, goal_pose: np.ndarray, middle: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Draw a random camera pose within the sampler's ranges.

    Args:
        goal_pose: world_T_camera (4, 4) at the goal; its orientation is rotated about the vertical.
        middle: centre (3,) of the target in the world, m.

    Returns:
        world_T_camera (4, 4), and the angle of the rotation about the vertical, rad.
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
