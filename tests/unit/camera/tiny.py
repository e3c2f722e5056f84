"""Renderer based on PyBullet's TinyRenderer: slow, for comparison with the simulator's own."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from scenes import BRIGHT

from aras_sim_bridge import rendering
from aras_sim_bridge.errors import RenderingError
from aras_sim_bridge.rendering import Lighting, View
from aras_sim_bridge.rendering.scene import Scene, VisualMesh
from aras_sim_bridge.world import World
from aras_sim_bridge.world.bullet import pybullet
from aras_visual_servo_base.poses import quaternion_from_matrix

FINE = 3  # samples along a pixel's side
# face_R_optical of the forward, right, left, lower, upper and backward faces of a cube.
CUBE = np.array([
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
], dtype=float)


def create_renderer(name: str, world: World):
    """'tiny', or the simulator's own renderer."""
    if name == "tiny":
        return TinyRenderer(world, BRIGHT)
    return rendering.create_renderer(name, world, BRIGHT)


class TinyRenderer:
    """Draws with getCameraImage.

    The shapes are copied to a Bullet client of its own, each visual as a fixed body.
    """

    def __init__(self, world: World, light: Lighting) -> None:
        self.scene = Scene(world)
        self.light = light
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        self._copies: list[tuple[int, VisualMesh]] = []
        self._row_of = np.zeros(1, np.float32)
        self._drawn_version = -1

    def snapshot(self) -> None:
        self.scene.snapshot()

    def close(self) -> None:
        if self._client is not None:
            pybullet.disconnect(self._client)
            self._client = None

    def prepare(self, view: View) -> None:
        view.get_tiles()

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        self._prepare(blend)
        if view.lens is None:
            return self._fine(view)
        picture = np.zeros((view.height, view.width, 3), np.uint8)
        for part, own, at in _faces(view):
            face = self._fine(part)
            picture[own] = cv2.remap(face, at, None, cv2.INTER_LINEAR)[own]
        return picture

    def measure(self, view: View, blend: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        self._prepare(blend)
        if view.lens is None:
            _, depth, row = self._image(view, 1)
        else:
            depth, row = (np.zeros((view.height, view.width), np.float32) for _ in range(2))
            rays = view.lens.compute_rays()
            for part, own, at in _faces(view):
                _, face_depth, face_row = self._image(part, 1)
                axis = view.world_T_optical[:3, :3].T @ part.world_T_optical[:3, 2]
                # From along the face's axis to along the optical axis, or along the ray.
                scale = (rays[own][:, 2] if view.lens.forward else 1.0) / (rays[own] @ axis)
                depth[own] = scale * cv2.remap(face_depth, at, None, cv2.INTER_NEAREST)[own]
                row[own] = cv2.remap(face_row, at, None, cv2.INTER_NEAREST)[own]
        labels = np.concatenate([[-1], self.scene.compute_labels()]).astype(np.int32)
        return np.where(row > 0, depth, np.float32(np.inf)), labels[row.astype(int)]

    def find_bodies_around(self, point: np.ndarray) -> list[str]:
        return self.scene.find_bodies_around(point)

    def _prepare(self, blend: float) -> None:
        if self._client is None:
            raise RenderingError("the renderer is closed")
        self.scene.refresh()
        if self.scene.version != self._drawn_version:
            self._drawn_version = self.scene.version
            self._copy()
        self._place(self.scene.interpolate_poses(blend))

    def _fine(self, view: View) -> np.ndarray:
        """Picture of a pinhole, (height, width, 3), with FINE x FINE samples a pixel."""
        size = (view.width, view.height)
        return cv2.resize(self._image(view, FINE)[0], size, interpolation=cv2.INTER_AREA)

    def _image(self, view: View, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Picture k times as wide and high, depths along the axis, m, and link rows plus one."""
        w, h = view.width * k, view.height * k
        K = view.K * np.array([[k], [k], [1.0]])
        K[:2, 2] += (k - 1) / 2
        # Bullet's eye looks along -z with y up.
        eye = np.diag([1.0, -1.0, -1.0, 1.0]) @ view.optical_T_world
        near, far = view.near, view.far
        # TinyRenderer samples pixel (u, v) at ndc (2 u / w - 1, (h - 2 - 2 v) / h).
        projection = np.array([
            [2 * K[0, 0] / w, 0, 1 - 2 * K[0, 2] / w, 0],
            [0, 2 * K[1, 1] / h, 2 * (K[1, 2] + 1) / h - 1, 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ])
        _, _, rgba, depth, bodies = pybullet.getCameraImage(
            w, h, eye.T.reshape(-1).tolist(), projection.T.reshape(-1).tolist(),
            lightDirection=self.light.to_sun.tolist(), lightColor=[1, 1, 1], lightDistance=1.0,
            shadow=0, lightAmbientCoeff=self.light.ambient, lightDiffuseCoeff=self.light.diffuse,
            lightSpecularCoeff=0.0, renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        image = np.ascontiguousarray(np.asarray(rgba, np.uint8).reshape(h, w, 4)[..., :3])
        body = np.asarray(bodies).reshape(h, w)
        image[body < 0] = np.round(np.array(self.light.background[:3]) * 255).astype(np.uint8)
        d = np.asarray(depth, np.float32).reshape(h, w)
        return image, far * near / (far - (far - near) * d), self._row_of[body + 1]

    def _copy(self) -> None:
        pybullet.resetSimulation(physicsClientId=self._client)
        self._copies = []
        for part in self.scene.visuals:
            for vertices, normals, indices in _slices(part):
                shape = pybullet.createVisualShape(
                    pybullet.GEOM_MESH, vertices=vertices, indices=indices, normals=normals,
                    rgbaColor=part.rgba, physicsClientId=self._client,
                )
                body = pybullet.createMultiBody(
                    0, -1, shape, physicsClientId=self._client
                )
                self._copies.append((body, part))
        # Body ids count up from 0 after a reset; body -1 is the background.
        highest = max((body for body, _ in self._copies), default=-1)
        self._row_of = np.zeros(highest + 2, np.float32)
        for body, part in self._copies:
            self._row_of[body + 1] = part.row + 1

    def _place(self, world_T_link: np.ndarray) -> None:
        quaternions = [quaternion_from_matrix(T[:3, :3]) for T in world_T_link]
        for body, part in self._copies:
            pybullet.resetBasePositionAndOrientation(
                body, world_T_link[part.row, :3, 3], quaternions[part.row],
                physicsClientId=self._client,
            )


def _faces(view: View) -> Iterator[tuple[View, np.ndarray, np.ndarray]]:
    """Pinhole views in the six directions that together see what a lens does; of each the pixels of
    the picture that lie nearest to its axis, (height, width) bool, and where in it each pixel is,
    (height, width, 2) float32 px."""
    rays = view.lens.compute_rays()
    ahead = np.isfinite(rays[..., 0])
    nearest = np.where(ahead[..., None], rays @ CUBE[:, 2].T, -np.inf).argmax(axis=2)
    apart = np.linalg.norm(np.diff(rays, axis=1), axis=2)
    focal = 1.2 / max(np.nanpercentile(apart, 30), 1e-4)
    for number, rotation in enumerate(CUBE):
        own = ahead & (nearest == number)
        if not own.any():
            continue
        p = rays @ rotation.T
        at = focal * p[..., :2] / np.where(own, p[..., 2], 1.0)[..., None]
        low, high = np.floor(at[own].min(axis=0)) - 2, np.ceil(at[own].max(axis=0)) + 2
        pose = view.world_T_optical.copy()
        pose[:3, :3] = pose[:3, :3] @ rotation.T
        K = np.array([[focal, 0, -low[0]], [0, focal, -low[1]], [0, 0, 1.0]])
        width, height = (high - low + 1).astype(int)
        part = View(int(width), int(height), pose, K, view.near, view.far)
        yield part, own, np.nan_to_num(at - low).astype(np.float32)


def _slices(part: VisualMesh, limit: int = 10000):
    """(vertices, normals, indices) lists; a client takes a bounded number of vertices at once."""
    triangles = part.mesh.triangles
    step = limit // 3
    for start in range(0, len(triangles), step):
        chunk = triangles[start:start + step]
        used, inverse = np.unique(chunk, return_inverse=True)
        yield (part.mesh.positions[used].tolist(), part.mesh.normals[used].tolist(),
               inverse.reshape(-1).tolist())
