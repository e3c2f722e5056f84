"""Rendered sequences of three moving solids, for tests and for the comparison with ViSP."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from aras_sim_bridge.description import Geometry, Link, RobotDescription, Visual
from aras_sim_bridge.rendering import Lighting, View, create_renderer
from aras_sim_bridge.world import Model, World
from aras_visual_servo_base.poses import Pose, exponential, inverse, matrix_from_xyz_rpy
from aras_visual_servo_camera.camera_model import CameraModel

SIZE = (640, 480)
# fx != fy, the principal point off the middle.
CAMERA = CameraModel(*SIZE, (610.0, 0, 331.3, 0, 598.0, 228.7, 0, 0, 1))
SOLIDS = ("box", "cylinder", "bracket")
CONDITIONS = ("clean", "cluttered", "occluded", "noisy")
BOX = (0.08, 0.05, 0.06)  # m
RADIUS, HEIGHT, ROUND = 0.03, 0.08, 256  # m; sides of the cylinder's prism
# The bracket's profile (x, z), m, and its depth along y.
PROFILE = ((0.0, 0.0), (0.08, 0.0), (0.08, 0.015), (0.02, 0.015), (0.02, 0.06), (0.0, 0.06))
DEEP = 0.04
GREYS = {"box": 0.78, "cylinder": 0.75, "bracket": 0.8}
SUN = Lighting(direction=(-0.25, 0.5, -0.75), ambient=0.35, diffuse=0.65,
          background=(0.25, 0.25, 0.25, 1.0))  # fmt: skip
FLOOR = 0.15
DISTANCE = 0.4  # m
HIDDEN = 0.2  # part of the solid that the card hides
SIGMA = 5.0  # grey levels


def prism(outline: np.ndarray, low: float, high: float) -> np.ndarray:
    """Triangles (n, 3, 3) of a prism along z over an outline (n, 2), star-shaped about its first
    corner, counter-clockwise."""
    n = len(outline)
    ground, top = (np.column_stack([outline, np.full(n, z)]) for z in (low, high))
    triangles = []
    for i in range(1, n - 1):
        triangles += [(top[0], top[i], top[i + 1]), (ground[0], ground[i + 1], ground[i])]
    for i in range(n):
        j = (i + 1) % n
        triangles += [(ground[i], ground[j], top[j]), (ground[i], top[j], top[i])]
    return np.array(triangles)


def corners_of(name: str) -> np.ndarray:
    """Return the triangles (n, 3, 3) of one of SOLIDS, m; it stands on z = 0."""
    if name == "box":
        x, y, z = BOX
        sides = np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2.0
        return prism(sides, 0.0, z)
    if name == "cylinder":
        around = 2.0 * np.pi * np.arange(ROUND) / ROUND
        return prism(RADIUS * np.column_stack([np.cos(around), np.sin(around)]), 0.0, HEIGHT)
    # Its inner corner sees all of an L: the profile begins there.
    profile = np.roll(np.array(PROFILE), -3, axis=0)
    standing = prism(profile, -DEEP / 2.0, DEEP / 2.0)
    turned = standing[:, :, [0, 2, 1]] * (1.0, -1.0, 1.0)
    return turned - (0.03, 0.0, 0.0)


def write_obj(path: Path, parts: list[tuple[np.ndarray, float]]) -> Path:
    """Write an OBJ file of parts: triangles (n, 3, 3), and their grey level, 0 to 1."""
    lines, colours, first = [f"mtllib {path.stem}.mtl"], [], 1
    for k, (triangles, grey) in enumerate(parts):
        points, number = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
        lines.append(f"usemtl m{k}")
        lines += [f"f {a} {b} {c}" for a, b, c in number.reshape(-1, 3) + first]
        first += len(points)
        colours.append(f"newmtl m{k}\nKd {grey:.3f} {grey:.3f} {grey:.3f}")
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".mtl").write_text("\n".join(colours) + "\n")
    return path


def block(middle: tuple[float, float], size: tuple[float, float], turn: float, low: float,
          high: float) -> np.ndarray:  # fmt: skip
    """Return the triangles of a block that is rotated about the vertical, rad."""
    a, b = 0.5 * size[0], 0.5 * size[1]
    sides = np.array([(-a, -b), (a, -b), (a, b), (-a, b)])
    c, s = np.cos(turn), np.sin(turn)
    return prism(sides @ np.array([(c, s), (-s, c)]) + middle, low, high)


def spawn(world: World, name: str, folder: Path, parts: list[tuple[np.ndarray, float]]) -> Model:
    """Spawn a body that hangs where it is put, made of parts as in write_obj."""
    mesh = write_obj(folder / f"{name}.obj", parts)
    visual = Visual("visual", (0, 0, 0), (0, 0, 0), Geometry("mesh", filename=str(mesh)))
    return world.spawn(
        RobotDescription(name, name, {name: Link(name, None, (visual,))}, {}, static=True), name)


def _clutter(random: np.random.Generator) -> list[tuple[np.ndarray, float]]:
    """Return tiles and blocks of other grey levels around and behind the solid."""
    parts = []
    for _ in range(90):
        away, angle = random.uniform(0.06, 0.45), random.uniform(0.0, 2.0 * np.pi)
        middle = (away * np.cos(angle), away * np.sin(angle))
        high = 0.001 + (random.uniform(0.0, 0.03) if away > 0.12 else 0.0)
        turned = block(middle, tuple(random.uniform(0.01, 0.05, 2)), random.uniform(0.0, 3.0),
                       -0.001, high)  # fmt: skip
        parts.append((turned, float(random.uniform(0.05, 1.0))))
    return parts


class Sequence:
    """Images of one solid under one condition, from a camera that flies around it."""

    def __init__(self, solid: str, condition: str, folder: Path, count: int = 500) -> None:
        self.solid, self.condition, self.count = solid, condition, count
        self.random = np.random.default_rng((SOLIDS.index(solid), CONDITIONS.index(condition)))
        self.triangles = corners_of(solid)
        floor = [(block((0.0, 0.0), (3.0, 3.0), 0.0, -0.02, -0.0005), FLOOR)]
        if condition == "cluttered":
            floor += _clutter(self.random)
        world = World()
        self.target = spawn(world, solid, folder, [(self.triangles, GREYS[solid])])
        spawn(world, "floor", folder, floor)
        self.card = None
        if condition == "occluded":
            card = block((0.0, 0.0), (0.16, 0.16), 0.0, 0.0, 0.001)
            self.card = spawn(world, "card", folder, [(card, 0.5)])
        self._renderer = create_renderer("exact", world, SUN)

    def pose(self, i: int) -> np.ndarray:
        """Return camera_T_solid (4, 4) of image i."""
        s = i / 30.0
        lean = 0.75 + 0.25 * np.sin(0.9 * s + 0.5)
        turn = 0.6 + 1.1 * np.sin(0.45 * s)
        far = DISTANCE + 0.05 * np.sin(0.7 * s + 1.0)
        middle = matrix_from_xyz_rpy((0.0, 0.0, 0.03), (0.0, 0.0, turn))
        # z towards the solid, seen from above at `lean` from the vertical.
        away = matrix_from_xyz_rpy((0.0, 0.0, 0.0), (lean - np.pi, 0.0, 0.0))
        away[:3, 3] = -far * away[:3, 2]
        shake = (
            0.03 * np.sin(1.7 * s), 0.02 * np.sin(2.3 * s + 0.4), 0.0,
            0.02 * np.sin(1.3 * s), 0.03 * np.sin(0.8 * s), 0.25 * np.sin(0.6 * s),
        )  # fmt: skip
        return inverse(middle @ away @ exponential(shake))

    def view(self, i: int) -> View:
        """Return the view of image i."""
        K = np.reshape(CAMERA.K, (3, 3))
        return View(*SIZE, inverse(self.pose(i)), K, 0.02, 20.0)

    def pictures(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield grey images (rows, columns), uint8, each with its camera_T_solid (4, 4)."""
        for i in range(self.count):
            yield self.picture(i), self.pose(i)

    def picture(self, i: int) -> np.ndarray:
        """Return image i (rows, columns), uint8."""
        view = self.view(i)
        if self.card is not None:
            self._hide(view, i)
        grey = self._renderer.render(view)[..., 1]
        if self.condition == "noisy":
            draw = np.random.default_rng((SOLIDS.index(self.solid), i))
            noisy = grey + draw.normal(0.0, SIGMA, grey.shape)
            return np.clip(np.round(noisy), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(grey)

    def depth(self, i: int) -> np.ndarray:
        """Return the depth image i (rows, columns), m."""
        return self._renderer.measure(self.view(i))[0]

    def _hide(self, view: View, i: int) -> None:
        """Place the card where it hides HIDDEN of the solid, from a slowly rotating side."""
        side = 0.01 * i
        out = np.array([np.cos(side), np.sin(side), 0.0])
        middle = (self.pose(i) @ (0.0, 0.0, 0.03, 1.0))[:3]

        def hidden(away: float) -> float:
            camera_T_card = matrix_from_xyz_rpy(0.75 * middle + away * out, (0.0, 0.0, side))
            self.card.set_pose(Pose.from_matrix(view.world_T_optical @ camera_T_card))
            return float((self._renderer.measure(view)[1] == self.target.body_id).sum())

        whole = hidden(1.0)
        low, high = 0.04, 0.2
        for _ in range(9):
            between = 0.5 * (low + high)
            if hidden(between) < (1.0 - HIDDEN) * whole:
                low = between
            else:
                high = between
        hidden(0.5 * (low + high))


def error_of(solid: str, found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """How far a pose (4, 4) is from the true one: m of the solid's middle, and rad; of a cylinder
    the turn about its axis does not count."""
    low, high = corners_of(solid).reshape(-1, 3).min(axis=0), corners_of(solid).reshape(
        -1, 3).max(axis=0)  # fmt: skip
    middle = np.append(0.5 * (low + high), 1.0)
    away = float(np.linalg.norm(((found - true) @ middle)[:3]))
    if solid == "cylinder":
        sine = np.linalg.norm(np.cross(found[:3, 2], true[:3, 2]))
        return away, float(np.arctan2(sine, found[:3, 2] @ true[:3, 2]))
    turned = found[:3, :3].T @ true[:3, :3]
    axis = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0],
                     turned[1, 0] - turned[0, 1]])  # fmt: skip
    return away, float(np.arctan2(np.linalg.norm(axis), np.trace(turned) - 1.0))


def lens(camera: CameraModel, D: tuple[float, ...]) -> CameraModel:
    """Return the camera with this distortion."""
    return replace(camera, D=D)
