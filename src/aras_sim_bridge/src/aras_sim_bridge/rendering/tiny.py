"""Renderer on PyBullet's TinyRenderer: plain software, slow, works everywhere."""

from __future__ import annotations

import cv2
import numpy as np

from aras_sim_bridge.world.bullet import pybullet

from ..errors import RenderingError
from ..poses import quaternion_from_matrix
from ..world import World
from .scene import Part, Scene
from .view import Sun, View


class TinyRenderer:
    """Draws with getCameraImage.

    The shapes are copied to a Bullet client of its own, each visual as a fixed body.
    """

    name = "tiny"

    def __init__(
        self, world: World, light: Sun, antialiasing: str = "none"
    ) -> None:
        if antialiasing not in ("none", "edges"):
            raise RenderingError(
                f"'tiny' has no anti-aliasing '{antialiasing}'; choose edges or none"
            )
        self.reason = ""
        self.scene = Scene(world)
        self.light = light
        self._factor = 3 if antialiasing == "edges" else 1
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        self._copies: list[tuple[int, Part]] = []
        self._row_of = np.zeros(1, np.float32)
        self._drawn_version = -1

    def snapshot(self) -> None:
        self.scene.snapshot()

    def close(self) -> None:
        if self._client is not None:
            pybullet.disconnect(self._client)
            self._client = None

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        self._prepare(blend)
        if view.lens is None:
            return self._flat(view)
        k = self._factor
        w, h = view.lens.atlas_size
        atlas = np.zeros((h * k, w * k, 3), np.uint8)
        for (x, y, fw, fh), part in _parts(view):
            atlas[y * k:(y + fh) * k, x * k:(x + fw) * k] = self._image(part, k)[0]
        lookup = view.lens.lookup
        if k == 1:
            return cv2.remap(atlas, lookup, None, cv2.INTER_LINEAR)
        # Four places of each pixel; a jump between faces says nothing about the pixel's size.
        across, down = (np.where(np.abs(step) < 8.0, step / 4, 0.0).astype(np.float32)
                        for step in np.gradient(lookup, axis=(1, 0)))
        total = np.zeros((*lookup.shape[:2], 3), np.uint16)
        for sign in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            at = (lookup + sign[0] * across + sign[1] * down) * k + np.float32((k - 1) / 2)
            total += cv2.remap(atlas, at, None, cv2.INTER_LINEAR)
        total[~view.lens.valid] = 0
        return ((total + 2) // 4).astype(np.uint8)

    def measure(self, view: View, blend: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        self._prepare(blend)
        if view.lens is None:
            _, depth, row = self._image(view, 1)
        else:
            w, h = view.lens.atlas_size
            depth, row = np.zeros((h, w), np.float32), np.zeros((h, w), np.float32)
            for (x, y, fw, fh), part in _parts(view):
                block = np.s_[y:y + fh, x:x + fw]
                _, depth[block], row[block] = self._image(part, 1)
            depth, row = view.lens.look_up_depth(depth), view.lens.look_up(row)
        labels = np.concatenate([[-1], self.scene.labels()]).astype(np.int32)
        return np.where(row > 0, depth, np.float32(np.inf)), labels[row.astype(int)]

    def bodies_around(self, point: np.ndarray) -> list[str]:
        return self.scene.bodies_around(point)

    def _prepare(self, blend: float) -> None:
        if self._client is None:
            raise RenderingError("the renderer is closed")
        self.scene.refresh()
        if self.scene.version != self._drawn_version:
            self._drawn_version = self.scene.version
            self._copy()
        self._place(self.scene.poses_at(blend))

    def _flat(self, view: View) -> np.ndarray:
        """Picture of a pinhole, (height, width, 3)."""
        k = self._factor
        image = self._image(view, k)[0]
        if k > 1:
            image = cv2.resize(image, (view.width, view.height), interpolation=cv2.INTER_AREA)
        return image

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
        for part in self.scene.parts:
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


def _parts(view: View):
    """Rectangle in the atlas and pinhole view of each face of a view's lens."""
    for face in view.lens.faces:
        pose = view.world_T_optical.copy()
        pose[:3, :3] = pose[:3, :3] @ face.rotation.T
        width, height = face.rectangle[2:]
        yield face.rectangle, View(width, height, pose, face.K(), view.near, view.far)


def _slices(part: Part, limit: int = 10000):
    """(vertices, normals, indices) lists; a client takes a bounded number of vertices at once."""
    triangles = part.mesh.triangles
    step = limit // 3
    for start in range(0, len(triangles), step):
        chunk = triangles[start:start + step]
        used, inverse = np.unique(chunk, return_inverse=True)
        yield (part.mesh.positions[used].tolist(), part.mesh.normals[used].tolist(),
               inverse.reshape(-1).tolist())
