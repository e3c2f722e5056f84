"""Solid targets: a mesh file, in metres, whose pose a camera tracks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
import numpy as np

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.meshes import files
from aras_visual_servo_camera.errors import ModelError
from aras_visual_servo_camera.model import Solid, read_solid

from ..errors import ExperimentError, require
from .geometry import Target, project

MESHES = (".stl", ".obj", ".dae", ".glb", ".gltf")


@dataclass(frozen=True, eq=False)
class SolidTarget(Target):
    """A solid; as plane and points it has those halfway up its z axis (Solid.points).

    path: of its mesh file.
    """

    solid: Solid
    path: Path

    @property
    def coloured(self) -> bool:
        """Whether its file says a colour of any part."""
        return any(m.rgba is not None or m.texture for m in files.read(str(self.path)))

    def vertices(self) -> np.ndarray:
        """Corners of its middle plane."""
        return self.solid.points()

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """The convex hull of all its vertices in the view."""
        seen = project(self._extreme, target_T_camera)
        return cv2.convexHull(seen.astype(np.float32))[:, 0].astype(float)

    @cached_property
    def _extreme(self) -> np.ndarray:
        """(n, 3) vertices on its convex hull: no others bound a view of it."""
        from scipy.spatial import ConvexHull

        return self.solid.vertices[ConvexHull(self.solid.vertices).vertices]


def is_mesh(shape: str | tuple) -> bool:
    """Whether a target's shape is the path of a mesh file."""
    return isinstance(shape, str) and Path(shape).suffix.lower() in MESHES


@lru_cache(maxsize=32)
def solid_target(path: Path) -> SolidTarget:
    """The target of a mesh file.

    Raises:
        ExperimentError: it cannot be read, or is no closed solid in metres.
    """
    require(path.is_file(), f"target.shape: there is no file {path}")
    try:
        return SolidTarget(read_solid(str(path)), path.resolve())
    except (DescriptionError, ModelError) as error:
        raise ExperimentError(f"target.shape: {error}") from error
