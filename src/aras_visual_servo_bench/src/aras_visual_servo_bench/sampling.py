"""Starts: named poses, and poses drawn at random from which the target is wholly in view."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.arm.poses import rotation_rpy
from aras_visual_servo_controller.errors import ServoError

from . import rigid
from .cameras import in_view
from .errors import ExperimentError, ViewError
from .experiment import Sampler
from .plants.free_body import FreeBody
from .targets import PlacedTarget


def draw_start(
    sampler: Sampler,
    arm: Arm | FreeBody,
    goal_pose: np.ndarray,
    goal_joints: np.ndarray,
    target: PlacedTarget,
    camera: CameraModel,
    seed: int,
) -> np.ndarray:
    """Joints (n,) of a start: the camera above the target, turned, the target wholly in view.

    Args:
        goal_pose: world_T_camera (4, 4) of the goal, whose attitude is turned about the vertical.
        goal_joints: (n,) from which the joints of a pose are looked for.

    Raises:
        ExperimentError: none was found in `sampler.attempts`.
    """
    random = np.random.default_rng(seed)
    placed = target.world_T_target(0.0)
    vertices = target.shape.vertices() @ placed[:3, :3].T + placed[:3, 3]
    middle = vertices.mean(axis=0)
    why = dict.fromkeys(("out of reach", "out of view"), 0)
    for _ in range(sampler.attempts):
        pose, turn = _drawn(sampler, goal_pose, middle, random)
        try:
            if not in_view(target.shape.outline(target.seen_from(pose)), camera, sampler.margin):
                raise ViewError("cut off")
            near = goal_joints
            if isinstance(arm, Arm):  # the last joint turns the camera: begin at the turn drawn
                near = goal_joints.copy()
                near[-1] = np.clip(near[-1] - turn, arm.lower[-1], arm.upper[-1])
            joints = arm.inverse(pose, near)
        except ViewError:
            why["out of view"] += 1
        except ServoError:
            why["out of reach"] += 1
        else:
            return joints
    told = ", ".join(f"{count} {what}" for what, count in why.items() if count)
    raise ExperimentError(
        f"no start found in {sampler.attempts} attempts ({told}): make start.height, side, turn "
        "or tilt smaller"
    )


def _drawn(
    sampler: Sampler, goal_pose: np.ndarray, middle: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, float]:
    """A pose (4, 4) of the sampler's ranges, and its turn about the vertical, rad."""
    x, y = random.uniform(-sampler.side, sampler.side, 2)
    height = random.uniform(*sampler.height)
    turn = random.uniform(-sampler.turn, sampler.turn)
    pose = np.eye(4)
    pose[:3, :3] = rotation_rpy(0.0, 0.0, turn) @ goal_pose[:3, :3]
    pose[:3, 3] = middle + (x, y, height)
    if sampler.tilt:
        lean, towards = random.uniform(0.0, sampler.tilt), random.uniform(-np.pi, np.pi)
        axis = lean * np.array([np.cos(towards), np.sin(towards), 0.0])
        pose = pose @ rigid.exponential((0.0, 0.0, 0.0, *axis))
    return pose, turn
