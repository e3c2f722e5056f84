"""Small worlds whose images are known exactly."""

from __future__ import annotations

import numpy as np

from aras_sim_bridge.description import Geometry, Inertial, Link, RobotDescription, Visual
from aras_sim_bridge.description.gazebo_materials import COLOURS
from aras_sim_bridge.rendering import Lighting, create_renderer
from aras_sim_bridge.world import Model, Pose, World

BRIGHT = Lighting(exposure="gazebo")  # white that faces up is 255, the background less
SENSOR_R_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


class Bench:
    """A World of single bodies; at: added to their places, m."""

    def __init__(self, world: World | None = None, at=(0.0, 0.0, 0.0)) -> None:
        self.world = World() if world is None else world
        self.at = at
        self._count = 0

    def body(self, geometry, position=(0, 0, 0), colour="Gazebo/White",
             orientation=(0, 0, 0, 1), com=None) -> Model:
        """A fixed shape, or a free body with its mass at `com`; None: the mesh file's colour."""
        visual = Visual("visual", (0, 0, 0), (0, 0, 0), geometry)
        mass = None if com is None else Inertial(1.0, com, (0.1, 0.2, 0.3), (1, 0, 0, 1, 0, 1))
        colours = {} if colour is None else {"link": COLOURS[colour]}
        self._count += 1
        return self.world.spawn(
            RobotDescription(f"body{self._count}", "link", {"link": Link("link", mass, (visual,))},
                             {}, static=com is None, colours=colours),
            f"body{self._count}", Pose(tuple(np.add(position, self.at)), tuple(orientation)))

    def box(self, half, position, colour="Gazebo/White", orientation=(0, 0, 0, 1)) -> Model:
        """A box of half these side lengths, m."""
        size = tuple(2.0 * float(side) for side in half)
        return self.body(Geometry("box", size=size), position, colour, orientation)

    def close(self) -> None:
        self.world.close()


def bright_renderer(world: World):
    return create_renderer("exact", world, BRIGHT)


def looking(eye, at, up=(0.0, 0.0, 1.0)) -> np.ndarray:
    """world_T_optical (4, 4) of an eye that looks at a point."""
    z = np.asarray(at, float) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    T[:3, 3] = eye
    return T


def link_pose(world_T_optical: np.ndarray) -> np.ndarray:
    """Pose of a link (x forward) whose camera has this optical frame."""
    T = world_T_optical.copy()
    T[:3, :3] = T[:3, :3] @ SENSOR_R_OPTICAL.T
    return T


def to_camera(world_T_optical: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 3) in the optical frame."""
    return (np.asarray(points) - world_T_optical[:3, 3]) @ world_T_optical[:3, :3]


def chessboard(bench: Bench, columns=7, rows=6, square=0.04) -> np.ndarray:
    """A board at z = 0, facing up; its inner corners (N, 3)."""
    bench.box([(columns + 2) * square / 2, (rows + 2) * square / 2, 0.005], [0, 0, -0.005])
    height = 1e-5
    for i in range(columns):
        for j in range(rows):
            if (i + j) % 2 == 0:
                at = [(i - columns / 2 + 0.5) * square, (j - rows / 2 + 0.5) * square, height]
                bench.box([square / 2, square / 2, height], at, "Gazebo/Black")
    return np.array([[(i - (columns - 2) / 2) * square, (j - (rows - 2) / 2) * square, 2 * height]
                     for j in range(rows - 1) for i in range(columns - 1)])


def table_and_target(bench: Bench) -> None:
    """The demo's white table and black square, the target standing 0.5 mm above the table."""
    bench.box([3.0, 3.0, 0.295], [0, 0, 0.295])
    bench.box([0.025, 0.025, 0.0005], [0, 0, 0.59], "Gazebo/Black")
