"""What Bullet holds, as meshes in link frames and link poses in the world."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.bullet import pybullet

from ..errors import RenderingError
from . import meshes
from .gazebo_materials import COLOURS, Rgba
from .indexed_mesh import Mesh
from .view import MaterialTable

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Part:
    """One visual: a mesh in its link's frame, the row of that link in `Scene.poses`, a colour."""

    row: int
    body: int
    link: int
    mesh: Mesh
    rgba: Rgba


@dataclass
class _Body:
    """Where one body's links stand in the pose table."""

    body: int
    rows: slice
    links: list[int]
    has_base: bool
    base_from_com: np.ndarray


def pose_matrices(positions: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """(N, 4, 4) from positions (N, 3) and unit quaternions xyzw (N, 4)."""
    x, y, z, w = np.asarray(quaternions, dtype=float).T
    out = np.zeros((len(x), 4, 4))
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = 1 - 2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = 2 * (xy + wz), 1 - 2 * (xx + zz), 2 * (yz - wx)
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = 2 * (xz - wy), 2 * (yz + wx), 1 - 2 * (xx + yy)
    out[:, :3, 3] = positions
    out[:, 3, 3] = 1.0
    return out


class Scene:
    """Follows one Bullet client: `refresh` finds models spawned and removed, `poses` reads links.

    client: Bullet physics client id.
    materials: colour overrides; read again whenever its version changes.
    """

    def __init__(self, client: int, materials: MaterialTable) -> None:
        self.client = client
        self.materials = materials
        self.parts: list[Part] = []
        self.version = 0
        self._signature: tuple = ()
        self._bodies: list[_Body] = []
        self._mesh_files: dict[str, list[Mesh]] = {}
        self._shapes: dict[tuple, list[Mesh]] = {}
        self._warned: set[tuple] = set()
        self._rows = 0
        self._previous: tuple[np.ndarray, np.ndarray] | None = None
        self._positions = np.zeros((0, 3))
        self._quaternions = np.zeros((0, 4))

    def refresh(self) -> bool:
        """Read the shapes again if models or colours changed; True if they did.

        What cannot be drawn is left out, with a log line that names the link and the mend.
        """
        n = pybullet.getNumBodies(physicsClientId=self.client)
        ids = tuple(
            pybullet.getBodyUniqueId(i, physicsClientId=self.client) for i in range(n)
        )
        signature = (self.materials.version, ids)
        if signature == self._signature:
            return False
        self._load(ids)
        self._signature = signature
        self.version += 1
        return True

    def forget(self) -> None:
        """Read every shape again at the next refresh (visuals changed, simulation reset)."""
        self._signature = ()

    def poses(self) -> np.ndarray:
        """Poses of all links that carry a visual, (rows, 4, 4), link to world."""
        return self.poses_at(1.0)

    def _read_all(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (rows, 3) and quaternions (rows, 4) now, in arrays that are used again."""
        p, q = self._positions, self._quaternions
        for body in self._bodies:
            self._read(body, p, q)
        return p, q

    def _matrices(self, p: np.ndarray, q: np.ndarray) -> np.ndarray:
        matrices = pose_matrices(p, q)
        for body in self._bodies:
            if body.has_base:
                row = body.rows.start
                matrices[row] = matrices[row] @ body.base_from_com
        return matrices

    def _read(self, body: _Body, p: np.ndarray, q: np.ndarray) -> None:
        row = body.rows.start
        if body.has_base:
            p[row], q[row] = pybullet.getBasePositionAndOrientation(
                body.body, physicsClientId=self.client
            )
            row += 1
        if body.links:
            states = pybullet.getLinkStates(
                body.body, body.links, 0, 1, physicsClientId=self.client
            )
            p[row:body.rows.stop] = [s[4] for s in states]
            q[row:body.rows.stop] = [s[5] for s in states]

    def snapshot(self) -> None:
        """Remember the present poses, for `poses_at`."""
        self.refresh()
        p, q = self._read_all()
        self._previous = p.copy(), q.copy()

    def poses_at(self, blend: float) -> np.ndarray:
        """Poses `blend` of the way from the last snapshot (0) to now (1), (rows, 4, 4).

        Quaternions are blended linearly and made unit ones again: over one physics step the error
        is of third order in the turned angle.
        """
        p, q = self._read_all()
        if blend >= 1.0 or self._previous is None or len(self._previous[0]) != len(p):
            return self._matrices(p, q)
        before_p, before_q = self._previous
        share = np.where((before_q * q).sum(axis=1, keepdims=True) < 0.0, -blend, blend)
        turned = (1.0 - blend) * before_q + share * q
        turned /= np.sqrt((turned * turned).sum(axis=1, keepdims=True))
        return self._matrices((1.0 - blend) * before_p + blend * p, turned)

    def labels(self) -> np.ndarray:
        """(rows,) int32 segmentation values: body id + (link index + 1) << 24, as in Bullet."""
        return np.array([body.body + ((link + 1) << 24) for body in self._bodies
                         for link in ([-1] if body.has_base else []) + body.links], np.int32)

    def bodies_around(self, point: np.ndarray) -> list[str]:
        """Names of the links whose closed visuals contain the point (3,), world frame."""
        self.refresh()
        poses = self.poses()
        names = []
        for part in self.parts:
            T = poses[part.row]
            local = (np.asarray(point) - T[:3, 3]) @ T[:3, :3]
            if meshes.contains(part.mesh, local):
                names.append(self.link_name(part.body, part.link))
        return list(dict.fromkeys(names))

    def _load(self, ids: tuple[int, ...]) -> None:
        parts: list[Part] = []
        bodies: list[_Body] = []
        row = 0
        for body in ids:
            visuals = pybullet.getVisualShapeData(body, physicsClientId=self.client)
            by_link: dict[int, list] = {}
            for visual in visuals:
                by_link.setdefault(visual[1], []).append(visual)
            if not by_link:
                continue
            links = sorted(by_link)
            for offset, link in enumerate(links):
                for visual in by_link[link]:
                    parts += self._parts(row + offset, body, link, visual)
            bodies.append(self._body(body, links, row))
            row += len(links)
        self.parts, self._bodies, self._rows = parts, bodies, row
        self._previous = None
        self._positions = np.zeros((row, 3))
        self._quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (row, 1))
        for body in bodies:
            self._read(body, self._positions, self._quaternions)

    def _body(self, body: int, links: list[int], row: int) -> _Body:
        info = pybullet.getDynamicsInfo(body, -1, physicsClientId=self.client)
        com = pose_matrices([info[3]], [info[4]])[0]
        return _Body(
            body=body, rows=slice(row, row + len(links)),
            links=[link for link in links if link >= 0], has_base=links[0] == -1,
            base_from_com=np.linalg.inv(com),
        )

    def _parts(self, row: int, body: int, link: int, visual: tuple) -> list[Part]:
        _, _, kind, dims, file, position, orientation, rgba = visual[:8]
        override = self.materials.lookup(body, link)
        plain = tuple(rgba) == (1.0, 1.0, 1.0, 1.0)
        if plain and kind == pybullet.GEOM_PLANE:
            rgba = COLOURS["Gazebo/Grey"]  # Gazebo's ground plane; Bullet gives planes no colour
        local = pose_matrices([position], [orientation])[0]
        parts = []
        for mesh in self._meshes(kind, dims, file, (body, link)):
            colour = override or (mesh.rgba if mesh.rgba and plain else rgba)
            if colour[3] <= 0.0:
                continue
            scale = np.array(dims) if kind == pybullet.GEOM_MESH else 1.0
            parts.append(Part(row, body, link, mesh.transformed(local, scale), tuple(colour)))
        return parts

    def _meshes(self, kind: int, dims: tuple, file: bytes, where: tuple[int, int]) -> list[Mesh]:
        if kind == pybullet.GEOM_MESH:
            name = file.decode()
            if not name or name == "unknown_file":
                self._warn_once(where, "is a mesh without a file, which Bullet does not give "
                                       "back; it is not drawn. Load it from a mesh file")
                return []
            if name not in self._mesh_files:
                try:
                    self._mesh_files[name] = meshes.load(name)
                except RenderingError as error:  # the rest of the world is still worth seeing
                    self._warn_once(where, f"is not drawn: {error}")
                    return []
            return self._mesh_files[name]
        makers: dict[int, Callable[[], Mesh]] = {
            pybullet.GEOM_BOX: lambda: meshes.box(np.array(dims)),
            pybullet.GEOM_SPHERE: lambda: meshes.sphere(dims[0]),
            pybullet.GEOM_CYLINDER: lambda: meshes.cylinder(dims[1], dims[0]),
            pybullet.GEOM_CAPSULE: lambda: meshes.capsule(dims[1], dims[0]),
            pybullet.GEOM_PLANE: lambda: meshes.plane(dims if any(dims) else (0.0, 0.0, 1.0)),
        }
        if kind not in makers:
            self._warn_once(where, f"has a visual of Bullet's kind {kind}, which is not drawn")
            return []
        key = (kind, tuple(dims))
        if key not in self._shapes:
            self._shapes[key] = [makers[kind]()]
        return self._shapes[key]

    def _warn_once(self, where: tuple[int, int], what: str) -> None:
        if (where, what) not in self._warned:
            self._warned.add((where, what))
            _log.warning("%s %s", self.link_name(*where), what)

    def link_name(self, body: int, link: int) -> str:
        """'model::link' of a Bullet body and link index."""
        base, model = pybullet.getBodyInfo(body, physicsClientId=self.client)
        if link < 0:
            return f"{model.decode()}::{base.decode()}"
        name = pybullet.getJointInfo(body, link, physicsClientId=self.client)[12]
        return f"{model.decode()}::{name.decode()}"
