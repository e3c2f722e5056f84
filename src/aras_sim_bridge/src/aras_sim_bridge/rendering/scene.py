"""Scene: visual meshes of all models in a World, and the poses of their links."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from aras_sim_bridge.description import shape_meshes
from aras_sim_bridge.description.gazebo_materials import WHITE
from aras_sim_bridge.description.types import Link, Rgba
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.pose_interpolation import blend_poses
from aras_sim_bridge.world.labels import make_label
from aras_visual_servo_base.meshes.mesh import Mesh

if TYPE_CHECKING:
    from aras_sim_bridge.world import Model, Pose, World

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class VisualMesh:
    """Mesh of a visual in its link's frame, its colour, and the row of the link's pose."""

    row: int
    mesh: Mesh
    rgba: Rgba


@dataclass
class _ModelRows:
    """Rows of one model in the arrays of poses.

    Row `first` belongs to the model's root if `has_root`; the next rows belong to `links`, in this
    order. `root_pose` is the pose in row `first`; None if this row is not filled yet.
    """

    model: Model
    first: int
    has_root: bool
    links: tuple[str, ...]
    root_pose: Pose | None = None


class Scene:
    """Visuals of one World, and poses of the links that have visuals.

    Attributes:
        visuals: visuals that `refresh` read last.
        version: number of times that `refresh` has changed the visuals.
    """

    def __init__(self, world: World) -> None:
        self.visuals: list[VisualMesh] = []
        self.version = 0
        self._world = world
        self._revision = -1
        self._models: list[_ModelRows] = []
        self._names: list[str] = []
        self._reported_errors: set[str] = set()
        self._labels = np.zeros(0, np.int32)
        self._previous: tuple[np.ndarray, np.ndarray] | None = None
        self._positions = np.zeros((0, 3))
        self._quaternions = np.zeros((0, 4))

    def refresh(self) -> bool:
        """Read the visuals again if models were spawned, changed or deleted.

        A mesh file that has been damaged since the spawn is skipped with a warning. Return whether
        the visuals were read.
        """
        if self._world.revision == self._revision:
            return False
        self._load()
        self._revision = self._world.revision
        self.version += 1
        return True

    def read_poses(self) -> np.ndarray:
        """Return the poses world_T_link (rows, 4, 4) of all links with visuals."""
        return self.interpolate_poses(1.0)

    def interpolate_poses(self, blend: float) -> np.ndarray:
        """Return poses (rows, 4, 4) between the last snapshot (blend 0) and the present (1)."""
        now = self._read_all()
        before = self._previous
        if before is None or len(before[0]) != len(now[0]):
            before = now
        poses = np.empty((len(now[0]), 4, 4))
        blend_poses(*before, *now, min(blend, 1.0), poses)
        return poses

    def snapshot(self) -> None:
        """Store the present poses, for `interpolate_poses`."""
        self.refresh()
        p, q = self._read_all()
        self._previous = p.copy(), q.copy()

    def compute_labels(self) -> np.ndarray:
        """Return the labels (rows,) of the links: body id + ((link index + 1) << 24)."""
        return self._labels

    def find_bodies_around(self, point: np.ndarray) -> list[str]:
        """Return the names 'model::link' of links with a visual that contains a point of the world.

        `point` (3,) is in m. Only visuals with a closed surface are found reliably.
        """
        self.refresh()
        poses = self.read_poses()
        names = []
        for part in self.visuals:
            T = poses[part.row]
            if part.mesh.contains((np.asarray(point) - T[:3, 3]) @ T[:3, :3]):
                names.append(self._names[part.row])
        return list(dict.fromkeys(names))

    def _read_all(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the present positions (rows, 3) and quaternions (rows, 4) of the links.

        The next call overwrites the arrays.
        """
        p, q = self._positions, self._quaternions
        for rows in self._models:
            row = rows.first
            if rows.has_root:
                pose = rows.model.pose()
                if pose is not rows.root_pose:  # a fixed root keeps its pose
                    p[row], q[row] = rows.root_pose = pose
                row += 1
            if rows.links:
                behind = slice(row, row + len(rows.links))
                p[behind], q[behind] = rows.model.read_link_frames(rows.links)
        return p, q

    def _load(self) -> None:
        parts: list[VisualMesh] = []
        models: list[_ModelRows] = []
        names = self._names = []
        labels: list[int] = []
        for model in self._world.models.values():
            links = [(model.link_index(link.name), link)
                     for link in model.description.links.values() if link.visuals]
            if not links:
                continue
            links.sort(key=lambda pair: pair[0])
            indices = [index for index, _ in links]
            models.append(_ModelRows(model, len(names), indices[0] == -1,
                                tuple(link.name for index, link in links if index >= 0)))
            for index, link in links:
                names.append(model.get_scoped_name(link.name))
                parts += self._make_visuals(
                    len(names) - 1, link, model.description.colours.get(link.name)
                )
                labels.append(make_label(model.body_id, index))
        self.visuals, self._models = parts, models
        self._labels = np.array(labels, np.int32)
        self._previous = None
        self._positions = np.empty((len(names), 3))
        self._quaternions = np.empty((len(names), 4))

    def _make_visuals(self, row: int, link: Link, colour: Rgba | None) -> list[VisualMesh]:
        """Return the visuals of a link.

        As in Gazebo, the colour is that of the link, otherwise that of the mesh file, otherwise
        white.
        """
        parts = []
        for visual in link.visuals:
            try:
                meshes = shape_meshes.make_meshes(visual.geometry)
            except DescriptionError as error:  # draw the scene without this visual
                if str(error) not in self._reported_errors:
                    _log.warning("%s is not drawn: %s", self._names[row], error)
                self._reported_errors.add(str(error))
                continue
            link_T_visual = visual.pose.matrix()
            for mesh in meshes:
                if visual.texture:
                    mesh = mesh.apply_texture(visual.texture, visual.geometry.kind != "mesh")
                rgba = colour or mesh.rgba or WHITE
                if rgba[3] > 0.0:
                    parts.append(VisualMesh(row, mesh.transform(link_T_visual), rgba))
        return parts
