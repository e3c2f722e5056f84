"""Renderer on PyBullet's TinyRenderer: plain software, slow, works everywhere."""

from __future__ import annotations

import numpy as np
import pybullet

from ..errors import RenderingError
from .scene import Part, Scene
from .view import Light, MaterialTable, View


class TinyRenderer:
    """Draws with getCameraImage.

    The shapes are copied to a Bullet client of its own, each visual as a fixed body, so the colour
    overrides never touch the client that simulates.
    """

    name = "tiny"

    def __init__(
        self, client: int, materials: MaterialTable, light: Light, antialiasing: str = "none"
    ) -> None:
        if antialiasing not in ("none", "edges"):
            raise RenderingError(f"'tiny' has no anti-aliasing '{antialiasing}'; choose edges or none")
        self.reason = ""
        self.scene = Scene(client, materials)
        self.light = light
        self._factor = 2 if antialiasing == "edges" else 1
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        self._copies: list[tuple[int, Part]] = []

    def snapshot(self) -> None:
        self.scene.snapshot()

    def forget(self) -> None:
        self.scene.forget()

    def close(self) -> None:
        if self._client is not None:
            pybullet.disconnect(self._client)
            self._client = None

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        if self._client is None:
            raise RenderingError("the renderer is closed")
        if self.scene.refresh():
            self._copy()
        self._place(self.scene.poses_at(blend))
        k = self._factor
        w, h = view.width * k, view.height * k
        K = view.K * np.array([[k], [k], [1.0]])
        K[:2, 2] += (k - 1) / 2
        optical_T_world = np.linalg.inv(view.world_T_optical)
        # Bullet's eye looks along -z with y up.
        eye = np.diag([1.0, -1.0, -1.0, 1.0]) @ optical_T_world
        near, far = view.near, view.far
        # TinyRenderer samples pixel (u, v) at ndc (2 u / w - 1, (h - 2 - 2 v) / h).
        projection = np.array([
            [2 * K[0, 0] / w, 0, 1 - 2 * K[0, 2] / w, 0],
            [0, 2 * K[1, 1] / h, 2 * (K[1, 2] + 1) / h - 1, 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ])
        _, _, rgba, _, labels = pybullet.getCameraImage(
            w, h, eye.T.reshape(-1).tolist(), projection.T.reshape(-1).tolist(),
            lightDirection=self.light.to_sun.tolist(), lightColor=[1, 1, 1], lightDistance=1.0,
            shadow=0, lightAmbientCoeff=self.light.ambient, lightDiffuseCoeff=self.light.diffuse,
            lightSpecularCoeff=0.0, renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        image = np.array(rgba, dtype=np.uint8).reshape(h, w, 4)[..., :3]
        empty = np.asarray(labels).reshape(h, w) < 0
        image = np.ascontiguousarray(image)
        image[empty] = np.round(np.array(self.light.background[:3]) * 255).astype(np.uint8)
        if k > 1:
            blocks = image.reshape(view.height, k, view.width, k, 3).astype(np.uint16)
            image = ((blocks.sum(axis=(1, 3)) + k * k // 2) // (k * k)).astype(np.uint8)
        return image

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

    def _place(self, world_T_link: np.ndarray) -> None:
        quaternions = [_quaternion(T[:3, :3]) for T in world_T_link]
        for body, part in self._copies:
            pybullet.resetBasePositionAndOrientation(
                body, world_T_link[part.row, :3, 3], quaternions[part.row],
                physicsClientId=self._client,
            )


def _slices(part: Part, limit: int = 10000):
    """(vertices, normals, indices) lists; a client takes a bounded number of vertices at once."""
    triangles = part.mesh.triangles
    step = limit // 3
    for start in range(0, len(triangles), step):
        chunk = triangles[start:start + step]
        used, inverse = np.unique(chunk, return_inverse=True)
        yield (part.mesh.positions[used].tolist(), part.mesh.normals[used].tolist(),
               inverse.reshape(-1).tolist())


def _quaternion(R: np.ndarray) -> np.ndarray:
    """Unit quaternion xyzw of a rotation matrix, by its largest component."""
    m = np.array([R[0, 0], R[1, 1], R[2, 2]])
    trace = m.sum()
    i = int(np.argmax([*m, trace]))
    q = np.empty(4)
    if i == 3:
        q[3] = 1 + trace
        q[:3] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1 - trace + 2 * R[i, i]
        q[j], q[k] = R[j, i] + R[i, j], R[k, i] + R[i, k]
        q[3] = R[k, j] - R[j, k]
    return q / np.linalg.norm(q)
