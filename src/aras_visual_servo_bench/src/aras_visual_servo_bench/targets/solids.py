"""Solid targets: a mesh file, in metres, or a box, a cylinder, an ellipsoid of a given size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from aras_sim_bridge.description.shapes import make_meshes
from aras_sim_bridge.description.types import Geometry
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.meshes import files
from aras_visual_servo_camera.errors import ModelError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.model_tracker import Solid
from aras_visual_servo_camera.model_tracker.solid import read_triangles
from aras_visual_servo_camera.silhouette import find_silhouette_points, fit_outline_plane

from ..errors import ExperimentError, ViewError, require
from .geometry import Target, project
from .scratch import make_scratch_folder


@dataclass(frozen=True, eq=False)
class SolidTarget(Target):
    """A solid; as plane and points it has those halfway up its z axis (Solid.points).

    path: of its mesh file, m. made: whether that file was made for this process.
    drawn: the file with its colours; None: path. factor: on the lengths of that along x, y and z.
    """

    is_solid = True

    solid: Solid
    path: Path
    is_temporary: bool = False
    coloured_path: Path | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def has_colour(self) -> bool:
        """Whether its file says a colour of any part."""
        meshes = files.read(str(self.coloured_path or self.path))
        return any(mesh.rgba is not None or mesh.texture for mesh in meshes)

    def vertices(self) -> np.ndarray:
        """Corners of its middle plane."""
        return self.solid.compute_section_corners()

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """The convex hull of all its vertices in the view."""
        rim = find_silhouette_points(self._to_camera_frame(target_T_camera))
        return rim[:, :2] / rim[:, 2:]

    def outline_plane(self, target_T_camera: np.ndarray) -> Plane:
        """The plane that fits where its outline touches it."""
        try:
            return fit_outline_plane(self._to_camera_frame(target_T_camera), self.path.name)
        except ModelError as error:
            raise ViewError(str(error)) from error

    def _to_camera_frame(self, target_T_camera: np.ndarray) -> np.ndarray:
        """(n, 3) vertices on its convex hull, in the camera's frame, m."""
        project(self._hull_vertices, target_T_camera)
        return (self._hull_vertices - target_T_camera[:3, 3]) @ target_T_camera[:3, :3]

    @cached_property
    def _hull_vertices(self) -> np.ndarray:
        """(n, 3) vertices on its convex hull: no others bound a view of it."""
        from scipy.spatial import ConvexHull

        return self.solid.vertices[ConvexHull(self.solid.vertices).vertices]


@lru_cache(maxsize=32)
def make_scaled_solid(unit: Geometry, size: tuple[float, float, float], name: str) -> SolidTarget:
    """A solid of size 1 about its frame's origin, scaled along x, y and z, m.

    Raises:
        ExperimentError: no camera could see it.
    """
    (mesh,) = make_meshes(unit)
    return make_solid(mesh.positions[mesh.triangles] * size, name)


def make_solid(corners: np.ndarray, name: str) -> SolidTarget:
    """The target of triangles (n, 3, 3), m; ExperimentError: they are no closed solid in metres."""
    try:
        solid = Solid.from_triangles(corners, name)
    except ModelError as error:
        raise ExperimentError(f"target: {error}") from error
    return SolidTarget(solid, _write_mesh(corners, name), is_temporary=True)


@lru_cache(maxsize=4)  # meshes are large
def read_solid_target(
    path: Path, size: tuple[float, ...] | None = None, scale: float | None = None
) -> SolidTarget:
    """The target of a mesh file.

    Args:
        size: of its box along x, y and z, m; None: the file's. scale: factor on the file's lengths,
            0.001 where they are mm; None: 1.

    Raises:
        ExperimentError: it cannot be read, or is no closed solid of that size in metres.
    """
    require(path.is_file(), f"target.shape: there is no file {path}")
    require(size is None or scale is None,
            "target.size and target.scale both set the lengths of a mesh: leave one out")
    require(size is None or len(size) == 3,
            f"target.size of {path.name} is {list(size or ())}, must be three lengths, along x, y "
            "and z, m")
    try:
        corners = read_triangles(files.read(str(path)))
        factor = (scale or 1.0,) * 3
        if size is not None:
            extent = np.ptp(corners.reshape(-1, 3), axis=0)
            require(bool((extent > 0.0).all()), f"target.shape: {path} is flat: leave out its size")
            factor = tuple((np.asarray(size) / extent).tolist())
        solid = Solid.from_triangles(corners * factor, path.name)
    except (DescriptionError, ModelError) as error:
        key = " (target.scale)" if "scale it" in str(error) else ""
        raise ExperimentError(f"target.shape: {error}{key}") from error
    if factor == (1.0,) * 3:
        return SolidTarget(solid, path.resolve())
    written = _write_mesh(corners * factor, path.stem)  # the tracker's model is in metres
    return SolidTarget(solid, written, coloured_path=path.resolve(), scale=factor)


def _write_mesh(corners: np.ndarray, name: str) -> Path:
    """A mesh file of triangles (n, 3, 3), m, in a folder of this process."""
    path = make_scratch_folder() / f"{name.replace(':', '_')}.obj"
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.reshape(corners, (-1, 3))]
    lines += [f"f {k} {k + 1} {k + 2}" for k in range(1, len(lines), 3)]
    path.write_text("\n".join(lines) + "\n")
    return path
