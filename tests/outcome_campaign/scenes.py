"""Random scenes that the project does not ship: targets, lenses, starts at any attitude, and arms
of four builds."""

from __future__ import annotations

import functools
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aras_visual_servo_base.poses import exponential, inverse, xyz_rpy_from_matrix
from aras_visual_servo_controller.kinematics import Arm

Draw = np.random.Generator
Changes = dict[str, Any]
BORDER = 0.94  # part of the half image within which the target has to be
ATTEMPTS = 400


@dataclass(frozen=True)
class Lens:
    """A camera that is drawn: its experiment's keys, and which directions it sees.

    tangents: of the half image, x and y; None: a fisheye that sees up to `angle` from its axis.
    """

    keys: Changes
    tangents: tuple[float, float] | None
    angle: float = 0.0

    @property
    def focal(self) -> float:
        half = self.keys["width"] / 2.0
        return half / (self.tangents[0] if self.tangents else self.keys["horizontal_fov"] / 2.0)

    def sees(self, points: np.ndarray) -> bool:
        if (points[:, 2] <= 1e-6).any():
            return False
        if self.tangents is not None:
            return bool((np.abs(points[:, :2] / points[:, 2:]) < BORDER * np.array(self.tangents))
                        .all())  # fmt: skip
        off_axis = np.hypot(points[:, 0], points[:, 1])
        return bool((np.arctan2(off_axis, points[:, 2]) < BORDER * self.angle).all())


def lens(random: Draw, fov: tuple[float, float] = (0.5, 1.4), fisheye: bool = False) -> Lens:
    """A camera of 320 or 640 px with 15 to 60 images a second."""
    width = int(random.choice([320, 640]))
    height = 3 * width // 4
    angle = float(random.uniform(*fov))
    keys: Changes = {"width": width, "height": height, "horizontal_fov": round(angle, 4),
                     "update_rate": round(float(random.uniform(15.0, 60.0)), 1)}  # fmt: skip
    if fisheye:
        keys["lens"] = "equidistant"
        return Lens(keys, None, 0.375 * angle)
    tangent = np.tan(angle / 2.0)
    return Lens(keys, (tangent, tangent * height / width))


def outline(random: Draw, corners: int = 4) -> np.ndarray:
    """Corners (k, 2) of an outline without symmetry that is about one wide."""
    while True:
        turns = np.sort(random.uniform(0.0, 2.0 * np.pi, corners))
        gaps = np.diff(np.append(turns, turns[0] + 2.0 * np.pi))
        radii = random.uniform(0.35, 0.6, corners)
        sides = np.hypot(*np.diff(np.vstack([polar(radii, turns), polar(radii, turns)[:1]]),
                                  axis=0).T)  # fmt: skip
        if gaps.min() > 0.6 and gaps.max() < 2.6 and np.diff(np.sort(sides)).min() > 0.04:
            points = polar(radii, turns)
            return points - points.mean(axis=0)


def polar(radii: np.ndarray, turns: np.ndarray) -> np.ndarray:
    return np.stack([radii * np.cos(turns), radii * np.sin(turns)], axis=1)


def rotation(random: Draw, largest: float) -> np.ndarray:
    """A rotation vector (3,) of up to so many rad about a random axis."""
    axis = random.normal(size=3)
    return axis / np.linalg.norm(axis) * random.uniform(0.0, largest)


def moved(pose: np.ndarray, offset: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A pose (4, 4) displaced in its own frame by offset (3,) and a rotation vector (3,)."""
    step = exponential([0.0, 0.0, 0.0, *turn])
    step[:3, 3] = offset
    return pose @ step


def facing(random: Draw, distance: float, lean: float) -> np.ndarray:
    """camera_T_target (4, 4) of a target on the optical axis, whose normal leans by up to `lean`
    rad from it, turned at random about its normal."""
    away = np.eye(4)
    away[2, 3] = distance
    tilt = np.append(rotation(random, lean)[:2], 0.0)
    leaning = moved(away, np.zeros(3), tilt)
    return moved(leaning, np.zeros(3), np.array([0.0, 0.0, random.uniform(-np.pi, np.pi)]))


def six(pose: np.ndarray) -> list[float]:
    """x, y, z (m), roll, pitch, yaw (rad) of a pose (4, 4)."""
    return [round(float(value), 9) for value in np.concatenate(xyz_rpy_from_matrix(pose))]


def in_view(camera: Lens, shape: np.ndarray, target: np.ndarray, poses: tuple) -> bool:
    """Whether the corners (k, 2) of a target at world_T_target (4, 4) are in the image at all poses
    (4, 4), and the same side of it, not too flat."""
    points = np.column_stack([shape, np.zeros(len(shape)), np.ones(len(shape))])
    sides = []
    for pose in poses:
        view = inverse(pose) @ target
        seen = (view @ points.T).T[:, :3]
        sides.append(view[:3, 2] @ seen.mean(axis=0) / np.linalg.norm(seen.mean(axis=0)))
        if not camera.sees(seen):
            return False
    return min(map(abs, sides)) > 0.5 and sides[0] * sides[1] > 0.0


def flying(
    random: Draw, camera: Lens, corners: int = 4, lean: float = 0.8, pixels: tuple = (50, 110),
    thickness: float | None = None,
) -> Changes:
    """Target, goal and start of a free camera: anywhere, at any attitude.

    Args:
        lean: greatest angle between the target's normal and the optical axis at the goal, rad.
        pixels: size of the target in the goal's image, of 320 px of width.
        thickness: part of its size that the target is thick, a box; None: it is flat.
    """
    distance = float(random.uniform(0.25, 1.5))
    size = distance * random.uniform(*pixels) * camera.keys["width"] / 320.0 / camera.focal
    shape = size * outline(random, corners)
    world_T_target = moved(np.eye(4), random.uniform(-1, 1, 3), rotation(random, np.pi))
    for _ in range(ATTEMPTS):
        goal = world_T_target @ inverse(facing(random, distance, lean))
        start = moved(goal, distance * random.uniform(-0.25, 0.25, 3), rotation(random, 0.5))
        if in_view(camera, shape, world_T_target, (goal, start)):
            break
    else:
        raise RuntimeError("no start from which the target is in view")
    target: Changes = {"shape": shape.round(6).tolist()} if thickness is None else {
        "shape": "box", "size": [float(size), float(0.7 * size), float(thickness * size)]}
    return {
        "plant": "free", "camera": camera.keys, "target": {**target, "pose": six(world_T_target)},
        "goal": {"pose": six(goal)}, "start": {"pose": six(start)},
    }  # fmt: skip


# -- arms ----------------------------------------------------------------------------------------


# Of each joint: kind, x, y, z (m), roll, pitch, yaw (rad) in its parent, axis, least, greatest.
ARMS: dict[str, tuple[tuple, ...]] = {
    "scara": (
        ("revolute", (0, 0, 0.4), (0, 0, 0), (0, 0, 1), -2.6, 2.6),
        ("revolute", (0.35, 0, 0), (0, 0, 0), (0, 0, 1), -2.4, 2.4),
        ("prismatic", (0.3, 0, 0), (0, 0, 0), (0, 0, -1), -0.1, 0.25),
        ("revolute", (0, 0, -0.05), (np.pi, 0, 0), (0, 0, 1), -3.1, 3.1),
    ),
    "offset_6r": (
        ("revolute", (0, 0, 0.3), (0, 0, 0), (0, 0, 1), -2.9, 2.9),
        ("revolute", (0.12, 0.08, 0.1), (0, 0, 0), (0, 1, 0), -1.8, 1.8),
        ("revolute", (0, -0.05, 0.4), (0, 0, 0), (0, 1, 0), -0.6, 2.6),
        ("revolute", (0.1, 0, 0.15), (0, 0, 0), (1, 0, 0), -3.0, 3.0),
        ("revolute", (0.25, 0.03, 0), (0, 0, 0), (0, 1, 0), -2.0, 2.0),
        ("revolute", (0.08, 0, 0), (0, np.pi / 2.0, 0), (0, 0, 1), -3.1, 3.1),
    ),
    "redundant_7r": (
        ("revolute", (0, 0, 0.3), (0, 0, 0), (0, 0, 1), -2.9, 2.9),
        ("revolute", (0, 0, 0), (0, 0, 0), (0, 1, 0), -1.9, 1.9),
        ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1), -2.9, 2.9),
        ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 1, 0), 0.2, 2.3),
        ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1), -2.9, 2.9),
        ("revolute", (0, 0, 0.19), (0, 0, 0), (0, 1, 0), -2.1, 2.1),
        ("revolute", (0, 0, 0.08), (0, 0, 0), (0, 0, 1), -3.0, 3.0),
    ),
    "gantry_6": (
        ("prismatic", (0, 0, 1.0), (0, 0, 0), (1, 0, 0), -0.8, 0.8),
        ("prismatic", (0, 0, 0), (0, 0, 0), (0, 1, 0), -0.8, 0.8),
        ("prismatic", (0, 0, 0), (0, 0, 0), (0, 0, 1), -0.5, 0.5),
        ("revolute", (0, 0, -0.1), (np.pi, 0, 0), (0, 0, 1), -3.1, 3.1),
        ("revolute", (0, 0, 0.05), (0, 0, 0), (0, 1, 0), -1.4, 1.4),
        ("revolute", (0, 0, 0.05), (0, 0, 0), (1, 0, 0), -1.4, 1.4),
    ),
}  # fmt: skip


def description(name: str) -> str:
    links, joints, parent = ['<link name="base"/>'], [], "base"
    for i, (kind, xyz, rpy, axis, least, most) in enumerate(ARMS[name], 1):
        links.append(f'<link name="link{i}"/>')
        joints.append(
            f'<joint name="q{i}" type="{kind}"><parent link="{parent}"/><child link="link{i}"/>'
            f'<origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/><axis xyz="{_words(axis)}"/>'
            f'<limit lower="{least}" upper="{most}" effort="100" velocity="2"/></joint>'
        )
        parent = f"link{i}"
    joints.append(f'<joint name="tool" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
                  '<origin xyz="0 0 0.05"/></joint>')  # fmt: skip
    return f'<robot name="{name}">{"".join(links)}<link name="tool0"/>{"".join(joints)}</robot>'


def _words(numbers: tuple) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


@functools.cache
def arm(name: str) -> tuple[str, Arm]:
    """Path of an arm's URDF file, and its kinematics."""
    path = Path(tempfile.gettempdir()) / "aras_outcome_arms" / f"{name}.urdf"
    path.parent.mkdir(exist_ok=True)
    text = description(name)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
    return str(path), Arm.from_urdf(text, "tool0")


def on_arm(
    random: Draw, name: str, camera: Lens, lean: float = 0.6, way: float = 0.22,
    pixels: tuple = (60, 120),
) -> Changes:
    """Target, goal and start, as joints, of an arm that carries the camera.

    Args:
        way: greatest change of a joint from goal to start, part of its range.
        lean, pixels: see `flying`.
    """
    path, kinematics = arm(name)
    lower, upper = (np.array([joint[i] for joint in ARMS[name]]) for i in (4, 5))
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    for _ in range(ATTEMPTS):
        distance = float(random.uniform(0.25, 0.7))
        wide = random.uniform(*pixels) * camera.keys["width"] / 320.0
        shape = float(distance * wide / camera.focal) * outline(random)
        q_goal = middle + half * random.uniform(-0.6, 0.6, len(middle))
        q_start = q_goal + way * half * random.uniform(-1.0, 1.0, len(middle))
        scaled = kinematics.jacobian(q_goal) * np.repeat([1.0, distance], 3)[:, None]
        if np.linalg.svd(scaled)[1][-1] < 0.08:
            continue
        goal, start = kinematics.pose(q_goal), kinematics.pose(q_start)
        world_T_target = goal @ facing(random, distance, lean)
        if in_view(camera, shape, world_T_target, (goal, start)):
            break
    else:
        raise RuntimeError(f"no start of {name} from which the target is in view")
    return {
        "plant": "chain", "camera": camera.keys,
        "robot": {"urdf": path, "camera_frame": "tool0"},
        "target": {"shape": shape.round(6).tolist(), "pose": six(world_T_target)},
        "goal": q_goal.round(9).tolist(), "start": q_start.round(9).tolist(),
    }  # fmt: skip
