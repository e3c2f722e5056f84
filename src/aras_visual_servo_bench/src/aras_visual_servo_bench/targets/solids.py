"""Solid targets from mesh files, and solid targets of simple shape and given size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from aras_sim_bridge.description.shape_meshes import make_meshes
from aras_sim_bridge.description.types import Geometry
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.meshes import files
from aras_visual_servo_camera.errors import TrackingModelError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.model_tracker import Solid
from aras_visual_servo_camera.model_tracker.solid import read_triangles
from aras_visual_servo_camera.silhouette import find_silhouette_points, fit_outline_plane

from ..errors import ExperimentError, OutOfViewError, catch_setting_errors, require
from .geometry import Target, project
from .temporary_folders import make_scratch_folder


@dataclass(frozen=True, eq=False)
class SolidTarget(Target):
    """Target that is a solid.

    The feature points of the target, and its plane, are those of the horizontal section of the
    solid at half its height along z.

    solid: geometry of the solid.
    path: mesh file with lengths in m.
    is_temporary: whether this process has written the file `path`.
    coloured_path: mesh file with the colours of the solid; None: `path`.
    scale: factors along x, y and z that convert the lengths of `coloured_path` to m.
    """

    is_solid = True

    solid: Solid
    path: Path
    is_temporary: bool = False
    coloured_path: Path | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def has_colour(self) -> bool:
        """True if a part of the mesh file has a colour or a texture."""
        meshes = files.read(str(self.coloured_path or self.path))
        return any(mesh.rgba is not None or mesh.texture for mesh in meshes)

    def vertices(self) -> np.ndarray:
        """Return the corners (n, 3) of the solid's section at half its height along z."""
        return self.solid.compute_section_corners()

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Project the convex hull of the solid."""
        silhouette = find_silhouette_points(self._to_camera_frame(target_T_camera))
        return silhouette[:, :2] / silhouette[:, 2:]

    def outline_plane(self, target_T_camera: np.ndarray) -> Plane:
        """Fit a plane to the points of the solid that form its outline in the image."""
        try:
            return fit_outline_plane(self._to_camera_frame(target_T_camera), self.path.name)
        except TrackingModelError as error:
            raise OutOfViewError(str(error)) from error

    def _to_camera_frame(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Return the vertices (n, 3) of the convex hull in the camera frame, m.

        Raises:
            OutOfViewError: a vertex is behind the camera.
        """
        project(self._hull_vertices, target_T_camera)
        return (self._hull_vertices - target_T_camera[:3, 3]) @ target_T_camera[:3, :3]

    @cached_property
    def _hull_vertices(self) -> np.ndarray:
        """Vertices (n, 3) of the convex hull; only these determine the outline."""
        from scipy.spatial import ConvexHull

        return self.solid.vertices[ConvexHull(self.solid.vertices).vertices]


@lru_cache(maxsize=32)
def make_scaled_solid(unit: Geometry, size: tuple[float, float, float], name: str) -> SolidTarget:
    """Make a target from a solid of size 1 that is scaled to `size` along x, y and z (m).

    Raises:
        ExperimentError: the scaled solid is not valid.
    """
    (mesh,) = make_meshes(unit)
    return make_solid(mesh.positions[mesh.triangles] * size, name)


def make_solid(corners: np.ndarray, name: str) -> SolidTarget:
    """Make a target from triangles (n, 3, 3), m.

    Raises:
        ExperimentError: the triangles are not a closed solid of plausible size.
    """
    with catch_setting_errors(TrackingModelError, "target"):
        solid = Solid.from_triangles(corners, name)
    return SolidTarget(solid, _write_mesh(corners, name), is_temporary=True)


@lru_cache(maxsize=4)  # the cache is small, because meshes are large
def read_solid_target(
    path: Path, size: tuple[float, ...] | None = None, scale: float | None = None
) -> SolidTarget:
    """Make a target from a mesh file.

    Args:
        path: path of the mesh file.
        size: size of the bounding box along x, y and z, m; None: the size in the file.
        scale: factor on the lengths of the file, such as 0.001 for mm; None: 1.

    Raises:
        ExperimentError: the file cannot be read, or is not a closed solid of plausible size.
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
            require(bool((extent > 0.0).all()), f"target.shape: {path} is flat; leave out "
                                                "target.size")
            factor = tuple((np.asarray(size) / extent).tolist())
        solid = Solid.from_triangles(corners * factor, path.name)
    except (DescriptionError, TrackingModelError) as error:
        key = " (target.scale)" if "scale it" in str(error) else ""
        raise ExperimentError(f"target.shape: {error}{key}") from error
    if factor == (1.0,) * 3:
        return SolidTarget(solid, path.resolve())
    # the tracker reads this file and expects lengths in m
    written = _write_mesh(corners * factor, path.stem)
    return SolidTarget(solid, written, coloured_path=path.resolve(), scale=factor)


def _write_mesh(corners: np.ndarray, name: str) -> Path:
    """Write triangles (n, 3, 3), m, as a mesh file in a temporary folder, and return its path."""
    path = make_scratch_folder() / f"{name.replace(':', '_')}.obj"
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.reshape(corners, (-1, 3))]
    lines += [f"f {k} {k + 1} {k + 2}" for k in range(1, len(lines), 3)]
    path.write_text("\n".join(lines) + "\n")
    return path
