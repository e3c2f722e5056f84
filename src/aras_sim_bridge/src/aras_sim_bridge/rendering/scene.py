"""What Bullet holds, as meshes in link frames and link poses in the world."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.world.bullet import pybullet

from ..description.gazebo_materials import COLOURS, Rgba
from ..errors import RenderingError
from ..poses import Pose
from . import meshes
from .compiled import compiled
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


@compiled("f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8")
def _blended_poses(before_p, before_q, p, q, blend):
    """Poses (N, 4, 4) `blend` of the way from one list to another of positions (N, 3) and unit
    quaternions xyzw (N, 4).

    Quaternions are blended linearly and made unit ones again: over one physics step the error is of
    third order in the turned angle.
    """
    out = np.zeros((len(p), 4, 4))
    for n in range(len(p)):
        same = (before_q[n] * q[n]).sum() >= 0.0
        turn = (1.0 - blend) * before_q[n] + (blend if same else -blend) * q[n]
        x, y, z, w = turn / np.sqrt((turn * turn).sum())
        T = out[n]
        T[0, :3] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        T[1, :3] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        T[2, :3] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        T[:3, 3] = before_p[n] + blend * (p[n] - before_p[n])
        T[3, 3] = 1.0
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

    def poses_at(self, blend: float) -> np.ndarray:
        """Poses `blend` of the way from the last snapshot (0) to now (1), (rows, 4, 4)."""
        now = self._read_all()
        before = self._previous
        if before is None or len(before[0]) != len(now[0]):
            before = now
        matrices = _blended_poses(*before, *now, min(blend, 1.0))
        for body in self._bodies:
            if body.has_base:
                row = body.rows.start
                matrices[row] = matrices[row] @ body.base_from_com
        return matrices

    def snapshot(self) -> None:
        """Remember the present poses, for `poses_at`."""
        self.refresh()
        p, q = self._read_all()
        self._previous = p.copy(), q.copy()

    def _read_all(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (rows, 3) and quaternions (rows, 4) now, in arrays that are used again."""
        p, q = self._positions, self._quaternions
        for body in self._bodies:
            self._read(body, p, q)
        return p, q

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
        com = Pose(info[3], info[4]).matrix()
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
        local = np.array(Pose(position, orientation).matrix())
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
