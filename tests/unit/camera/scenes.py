"""Small Bullet worlds whose pictures are known exactly."""

from __future__ import annotations

import numpy as np
import pybullet

from aras_sim_bridge.rendering import COLOURS, MaterialTable

SENSOR_R_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


class Bench:
    """A physics client with its colour table, closed at the end of the test."""

    def __init__(self) -> None:
        self.client = pybullet.connect(pybullet.DIRECT)
        self.materials = MaterialTable()

    def box(self, half, position, colour="Gazebo/White", mass=0.0, orientation=(0, 0, 0, 1)):
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half, physicsClientId=self.client
        )
        body = pybullet.createMultiBody(
            mass, shape, basePosition=position, baseOrientation=orientation,
            physicsClientId=self.client,
        )
        self.materials.set_body(body, {-1: COLOURS[colour]})
        return body

    def close(self) -> None:
        pybullet.disconnect(self.client)


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


TARGET_CORNERS = np.array([[x, y, z] for x in (-0.025, 0.025) for y in (-0.025, 0.025)
                           for z in (0.59, 0.5905)])


def table_and_target(bench: Bench) -> None:
    """The demo's white table and black square, the target standing 0.5 mm above the table."""
    bench.box([3.0, 3.0, 0.295], [0, 0, 0.295])
    bench.box([0.025, 0.025, 0.0005], [0, 0, 0.59], "Gazebo/Black")
