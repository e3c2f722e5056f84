"""Reader of glTF 2.0 files (.glb, .gltf) by trimesh, with checks that trimesh omits."""

from __future__ import annotations

import atexit
import hashlib
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DescriptionError
from ..image_files import LARGEST_IMAGE
from ..safe_xml import shorten
from ..urdf import Rgba
from .mesh import Mesh, check_size, from_indices

if TYPE_CHECKING:
    import trimesh

# Number of bytes before the first chunk of a .glb file.
_HEADER = 12
_TRIANGLES = 4  # glTF's number of the primitive mode "triangles", the default
_NONE = np.zeros((0, 3))


def read(data: bytes, path: Path, find_file: Callable[[Path], bytes]) -> list[Mesh]:
    """Read one mesh for each primitive in the scene, in metres.

    Axes are not rotated, so +y is up, as in glTF.

    Args:
        data: content of the file.
        path: path of the file.
        find_file: function that reads another file to which the glTF file refers.

    Raises:
        DescriptionError: the file is invalid; the message says what is missing or wrong.
    """
    import trimesh  # imported here because trimesh takes half a second and is rarely needed

    tree = _parse_tree(data)
    normals = _check_tree(tree)

    class FileResolver(dict):
        """Reads the files to which the glTF file refers, by their names."""

        def __missing__(self, name: str) -> bytes:
            file = (path.parent / name).resolve()
            if not file.is_relative_to(path.parent.resolve()):
                raise DescriptionError(
                    f"the file refers to '{shorten(name)}', which is not in its folder",
                    "move that file there",
                )
            return find_file(file)

        get = dict.__getitem__  # trimesh may use either; a missing file must not become None

    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=path.suffix[1:].lower(),
                                   resolver=FileResolver(), process=False)
    except DescriptionError:
        raise
    except Exception as error:  # trimesh raises errors of many types for damaged files
        said = f"{type(error).__name__}: {error}"
        raise DescriptionError(
            f"the parts of the file do not match: {shorten(said, 200)}"
        ) from None
    meshes = []
    for node in sorted(scene.graph.nodes_geometry):
        placed, name = scene.graph[node]
        shape = scene.geometry[name]
        if isinstance(shape, trimesh.Trimesh) and len(shape.faces):
            mesh = _make_mesh(shape, normals).apply_affine(placed)
            meshes.append(replace(mesh, name=str(node)))
            check_size(sum(len(mesh.triangles) for mesh in meshes), len(meshes))
    if not meshes:
        raise DescriptionError("the scene contains no triangles")
    return meshes


def _parse_tree(data: bytes) -> dict[str, Any]:
    """Return the JSON part of a glTF file, which describes the file's binary data."""
    text = data
    if data[:4] == b"glTF":
        length = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
        text = data[_HEADER + 8 : _HEADER + 8 + length]
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError):
        raise DescriptionError("the file does not start like a glTF file") from None
    if not isinstance(tree, dict) or not isinstance(tree.get("asset"), dict):
        raise DescriptionError("the file is not a glTF file: it has no asset")
    if not str(tree["asset"].get("version", "")).startswith("2"):
        raise DescriptionError("the file is not glTF 2", "export it as glTF 2")
    return tree


def _check_tree(tree: dict[str, Any]) -> bool:
    """Check extensions and sizes; return whether the file contains normals for all triangles."""
    if needed := tree.get("extensionsRequired"):
        raise DescriptionError(f"the file needs {shorten(', '.join(map(str, needed)), 200)}, which "
                               "is not supported",
                               "export the file without glTF extensions such as compression")
    try:
        primitives = [one for mesh in tree.get("meshes", ()) for one in mesh["primitives"]
                      if one.get("mode", _TRIANGLES) == _TRIANGLES]
        corners = [one.get("indices", one["attributes"]["POSITION"]) for one in primitives]
        check_size(sum(int(tree["accessors"][k]["count"]) for k in corners) // 3, len(primitives))
        return all("NORMAL" in one["attributes"] for one in primitives)
    except (LookupError, TypeError, ValueError, AttributeError):
        raise DescriptionError("the meshes of the file refer to missing data") from None


def _make_mesh(shape: trimesh.Trimesh, normals: bool) -> Mesh:
    """Return the mesh of a primitive in its own frame.

    `normals`: True if the file contains normals for all triangles. Otherwise, they are computed.
    """
    index = np.full((len(shape.faces), 3, 3), -1)
    index[..., 0] = shape.faces
    uv = getattr(shape.visual, "uv", None)
    if uv is not None and len(uv) == len(shape.vertices):
        index[..., 1] = shape.faces
    else:
        uv = _NONE
    given = _NONE
    if normals:
        given, index[..., 2] = np.asarray(shape.vertex_normals), shape.faces
    rgba, texture = _read_material(shape.visual)
    return from_indices(index, np.asarray(shape.vertices), np.asarray(uv), given, rgba, texture)


def _read_material(visual: Any) -> tuple[Rgba | None, str | None]:
    """Return the colour and the texture file of a primitive; each is None if missing."""
    if visual.kind in ("vertex", "face"):
        return tuple((np.asarray(visual.main_color, float) / 255.0).tolist()), None
    material = getattr(visual, "material", None)
    image = getattr(material, "baseColorTexture", None)
    if image is not None:
        return None, _save_image(image)
    factor = getattr(material, "baseColorFactor", None)
    if factor is None:
        return None, None
    red, green, blue, opacity = np.asarray(factor, float) / 255.0
    return (_encode_srgb(red), _encode_srgb(green), _encode_srgb(blue), float(opacity)), None


def _encode_srgb(linear: float) -> float:
    """Convert a linear intensity (0 to 1) to an sRGB level (0 to 1), see IEC 61966-2-1.

    Colour factors in glTF are linear, but image pixels are sRGB levels.
    """
    low = linear <= 0.0031308
    return float(12.92 * linear if low else 1.055 * linear ** (1.0 / 2.4) - 0.055)


def _save_image(image: Any) -> str:
    """Save an embedded image as a temporary file, which is deleted when the process ends."""
    if image.width * image.height > LARGEST_IMAGE:
        raise DescriptionError(
            f"an image in the file has more than {LARGEST_IMAGE} pixels", "make it smaller"
        )
    pixels = image.convert("RGBA" if "A" in image.getbands() else "RGB")
    name = hashlib.sha256(pixels.tobytes() + str(pixels.size).encode()).hexdigest()[:32]
    file = _make_folder() / f"{name}.png"
    if not file.exists():
        pixels.save(file)
    return str(file)


@lru_cache(maxsize=1)
def _make_folder() -> Path:
    folder = Path(mkdtemp(prefix="aras_pictures_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
