"""Collada files (.dae) with their diffuse colours and textures, read by pycollada."""

from __future__ import annotations

import io
from pathlib import Path

import collada
import numpy as np

from ..errors import RenderingError
from .indexed_mesh import Mesh, from_indices

# Parts that pycollada does not know or that refer to nothing are left out.
_LEFT_OUT = [collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError]


def load_collada(path: Path) -> list[Mesh]:
    """One mesh for each primitive of the scene, in metres.

    The unit is applied and the up axis is not, as in Gazebo and rviz.
    """
    data = path.read_bytes()
    if b"<!DOCTYPE" in data[:4096]:
        raise RenderingError("has a document type, which is not read; export it again")
    try:
        document = collada.Collada(io.BytesIO(data), ignore=_LEFT_OUT)
    except (collada.common.DaeError, SyntaxError) as error:  # lxml's and Python's parse errors
        raise RenderingError(f"is damaged: {error}") from error
    scale = (document.assetInfo.unitmeter or 1.0) if document.assetInfo is not None else 1.0
    if document.scene is None:
        raise RenderingError("has no scene; export it again")
    meshes = []
    for geometry in document.scene.objects("geometry"):
        for primitive in geometry.primitives():
            if isinstance(primitive, collada.polylist.BoundPolylist):
                primitive = primitive.triangleset()
            if isinstance(primitive, collada.triangleset.BoundTriangleSet) and len(primitive):
                meshes.append(_mesh(primitive, scale, path.parent))
    if not meshes:
        raise RenderingError("has no triangles")
    return meshes


def _mesh(triangles: collada.triangleset.BoundTriangleSet, scale: float, folder: Path) -> Mesh:
    vertices = triangles.vertex * scale
    if not np.isfinite(vertices).all():
        raise RenderingError("has vertices that are not finite; export it again")
    index = np.full((*triangles.vertex_index.shape, 3), -1)
    index[..., 0] = triangles.vertex_index
    uv = normals = np.zeros((0, 2))
    if triangles.texcoordset:
        uv = triangles.texcoordset[0]
        index[..., 1] = triangles.texcoord_indexset[0]
    if triangles.normal is not None:
        normals = triangles.normal
        index[..., 2] = triangles.normal_index
    rgba, texture = _look(triangles.material, folder)
    return from_indices(index, vertices, uv, normals, rgba, texture)


def _look(material: collada.material.Material | None, folder: Path
          ) -> tuple[tuple[float, ...] | None, str | None]:
    """Colour and texture file of a material's diffuse light, None where it has none."""
    effect = getattr(material, "effect", None)
    diffuse = getattr(effect, "diffuse", None)
    if isinstance(diffuse, collada.material.Map):
        file = folder / diffuse.sampler.surface.image.path
        return None, str(file) if file.is_file() else None
    if diffuse is None:
        return None, None
    return (*(float(x) for x in diffuse[:3]), 1.0), None
