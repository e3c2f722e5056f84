"""Reader of COLLADA files (.dae) by pycollada, with checks that pycollada omits."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import collada
import numpy as np

from .. import safe_xml
from ..errors import DescriptionError
from .collada_materials import MeshMaterial, read_materials
from .mesh import GREY, Mesh, check_reach, check_size, from_indices

# Parts of a file that contain the triangles and their poses. The other parts, such as materials,
# cameras and animations, are removed before pycollada reads the file: it would drop a node together
# with a part that it cannot read.
_LIBRARIES = {"asset", "library_geometries", "library_nodes", "library_visual_scenes", "scene"}
_NODE_PARTS = {"node", "matrix", "translate", "rotate", "scale", "skew", "lookat",
               "instance_geometry", "instance_node"}
_NOT_TRIANGLES = {"lines", "linestrips", "extra"}
_NUMBER = "number"  # attribute that numbers the elements <instance_geometry>
_log = logging.getLogger(__name__)
# Largest number of nodes in a scene. A file of a few kB can describe so many nodes that the memory
# is exhausted, if each node refers twice to the next one.
_MOST_NODES = 100_000


def read(data: bytes, folder: Path) -> list[Mesh]:
    """Read one mesh for each primitive in the scene, in metres.

    As in Gazebo and rviz, the unit of the file is applied, but its up axis is ignored.

    Args:
        folder: folder to which the paths of texture files are relative.

    Raises:
        DescriptionError: the file is invalid; the message says what is missing or wrong.
    """
    root = _parse_root(data)
    materials = _bind_materials(root, read_materials(root, folder))
    _remove_unused(root)
    try:
        # pycollada loses text that follows a comment. Therefore pycollada gets the XML of `root`,
        # which contains no comments.
        checked = ElementTree.tostring(root)
        document = collada.Collada(io.BytesIO(checked))
    except Exception as error:  # pycollada raises errors of many types for damaged files
        raise DescriptionError(
            f"the parts of the file do not match: {_format_error(error)}"
        ) from None
    unit = document.assetInfo.unitmeter or 1.0
    metres = np.diag([unit, unit, unit, 1.0])
    meshes: list[Mesh] = []
    count = 0
    for node, placed, name in _find_geometries(document.scene):
        by_symbol = materials[int(node.xmlnode.get(_NUMBER))]
        for primitive in node.geometry.primitives:
            if isinstance(primitive, collada.polylist.Polylist):
                primitive = _triangulate(primitive)
            if isinstance(primitive, collada.triangleset.TriangleSet) and len(primitive):
                count += len(primitive)
                check_size(count, len(meshes) + 1)
                material = by_symbol.get(primitive.material, MeshMaterial())
                mesh = _make_mesh(primitive, material).apply_affine(metres @ placed)
                meshes.append(replace(mesh, name=name))
    if not meshes:
        raise DescriptionError("the scene contains no triangles")
    return meshes


def _format_error(error: Exception) -> str:
    return str(getattr(error, "msg", error)) or type(error).__name__


def _parse_root(data: bytes) -> Element:
    """Parse a file and check its numbers, array lengths and references; return the root element.

    These checks are needed because pycollada replaces numbers that are not finite by zero, and does
    not check lengths.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DescriptionError("the file is not UTF-8 text") from None
    root = safe_xml.parse(text, "COLLADA", largest=len(data))
    if root.tag != "COLLADA":
        raise DescriptionError("the root element is not <COLLADA>")
    unit = root.find("asset/unit")
    if unit is not None and safe_xml.parse_number(unit.get("meter"), "<unit>: meter", 1.0) <= 0.0:
        raise DescriptionError(f"<unit>: meter {unit.get('meter')} must be positive")
    for array in root.iterfind("library_geometries/geometry/mesh/source/float_array"):
        values = _parse_numbers(array, float)
        count = safe_xml.parse_integer(array.get("count"), "<float_array>: count", len(values))
        if count != len(values):
            raise DescriptionError(
                f"<float_array> has the count {count}, but {len(values)} numbers")
        if not np.isfinite(values).all():
            raise DescriptionError("<float_array> contains a number that is not finite")
    for tag in ("instance_geometry", "instance_node", "instance_visual_scene"):
        for instance in root.iter(tag):
            _find_reference(instance, "url")
    for mesh in root.iterfind("library_geometries/geometry/mesh"):
        sources = {part.get("id") for part in mesh}
        for part in mesh.iter("input"):
            if _find_reference(part, "source") not in sources:
                raise DescriptionError(
                    f"there is no <source> '{safe_xml.shorten(part.get('source'))}'")
        for primitive in mesh:
            if primitive.tag in ("triangles", "polylist"):
                _check_primitive(primitive)
    for tag, count in (("matrix", 16), ("translate", 3), ("scale", 3), ("rotate", 4)):
        for transform in root.iter(tag):
            values = _parse_numbers(transform, float)
            if len(values) != count:
                raise DescriptionError(f"<{tag}>: needs {count} numbers, has {len(values)}")
            check_reach(values, f"number of <{tag}>")
    return root


def _bind_materials(
    root: Element, materials: dict[str, MeshMaterial]
) -> list[dict[str, MeshMaterial]]:
    """Number the elements <instance_geometry>, and return the materials that each one uses.

    Returns:
        For each element, the materials by the symbols in its geometry.
    """
    found = []
    for instance in root.iter("instance_geometry"):
        instance.set(_NUMBER, str(len(found)))
        by_symbol = {}
        for binding in instance.iter("instance_material"):
            target = (binding.get("target") or "").removeprefix("#")
            if target not in materials:
                _log.warning("material '%s' is drawn grey: the file does not contain it",
                             safe_xml.shorten(target))
            by_symbol[binding.get("symbol")] = materials.get(target, MeshMaterial(GREY))
        found.append(by_symbol)
    return found


def _remove_unused(root: Element) -> None:
    """Remove the parts of a file that are neither triangles nor their poses.

    Raises:
        DescriptionError: the scene contains a geometry that does not exist.
    """
    geometries = {one.get("id"): one for one in root.iterfind("library_geometries/geometry")}
    for instance in root.iter("instance_geometry"):
        if _find_reference(instance, "url") not in geometries:
            raise DescriptionError("the scene contains a geometry that does not exist: "
                                   f"'{safe_xml.shorten(instance.get('url'))}'")
    curves = {name for name, one in geometries.items() if one.find("mesh") is None}
    for parent in root.iter():
        for child in list(parent):
            if parent is root:
                is_used = child.tag in _LIBRARIES
            elif parent.tag == "node":
                is_used = child.tag in _NODE_PARTS and not (
                    child.tag == "instance_geometry" and _find_reference(child, "url") in curves)
            elif parent.tag == "library_geometries":
                is_used = child.get("id") not in curves
            elif parent.tag == "scene":
                is_used = child.tag == "instance_visual_scene"
            else:
                is_used = parent.tag != "instance_geometry" and child.tag not in _NOT_TRIANGLES
            if not is_used:
                parent.remove(child)


def _check_primitive(primitive: Element) -> None:
    """Check that a primitive has as many indices as its counts require."""
    what = f"<{primitive.tag}>"
    count = safe_xml.parse_integer(primitive.get("count"), f"{what}: count")
    offsets = [safe_xml.parse_integer(part.get("offset"), "<input>: offset")
               for part in primitive.findall("input")]
    if not offsets or min(offsets) < 0 or max(offsets) > 64:
        raise DescriptionError(f"{what} has no <input>, or an <input> with an invalid offset")
    corners = 3 * count
    if primitive.tag == "polylist":
        each = primitive.find("vcount")
        each = np.zeros(0) if each is None else _parse_numbers(each, float)
        if len(each) != count or (each < 3).any():
            raise DescriptionError(f"{what} with the count {count}: <vcount> has {len(each)} "
                                   f"numbers, must have {count}; each polygon needs at least "
                                   "three corners")
        corners = each.sum()
    found = 0 if primitive.find("p") is None else len(_parse_numbers(primitive.find("p"), float))
    if count < 0 or found != corners * (max(offsets) + 1):
        raise DescriptionError(f"{what} with the count {count}: <p> has {found} indices, which do "
                               "not match the count")


def _find_reference(element: Element, name: str) -> str:
    """Return the id in a reference '#id'; references to other files are errors."""
    value = element.get(name) or ""
    if not value.startswith("#"):
        raise DescriptionError(f"<{element.tag}>: {name} '{safe_xml.shorten(value)}' does not "
                               "start with #; references to other files are not supported")
    return value[1:]


def _parse_numbers(element: Element, kind: type) -> np.ndarray:
    try:
        return np.array((element.text or "").split(), dtype=kind)
    except (ValueError, OverflowError):
        raise DescriptionError(f"<{element.tag}> contains text that is not a number") from None


def _find_geometries(
    scene: collada.scene.Scene | None,
) -> Iterator[tuple[collada.scene.GeometryNode, np.ndarray, str]]:
    """Yield the geometries in the scene with their poses (4, 4) and the names of their nodes."""
    nodes = scene.nodes if scene is not None else []
    pending = [(node, np.eye(4), "") for node in reversed(nodes)]
    for _ in range(_MOST_NODES):
        if not pending:
            return
        node, placed, name = pending.pop()
        if isinstance(node, collada.scene.GeometryNode):
            yield node, placed, name
        elif isinstance(node, collada.scene.Node):
            inside = placed @ node.matrix
            check_reach(inside, "transform")
            name = getattr(node, "name", None) or node.id or name
            pending += [(child, inside, name) for child in reversed(node.children)]
    raise DescriptionError(f"the scene has more than {_MOST_NODES} nodes", "simplify it")


def _triangulate(polygons: collada.polylist.Polylist) -> collada.triangleset.TriangleSet:
    # This is checked here, because _check_primitive does not check <polygons>.
    if (polygons.vcounts < 3).any():
        raise DescriptionError("<polygons> has a polygon with fewer than three corners")
    return polygons.triangleset()


def _make_mesh(triangles: collada.triangleset.TriangleSet, material: MeshMaterial) -> Mesh:
    """Return a mesh of the triangles in the frame and unit of their geometry."""
    index = np.full((*triangles.vertex_index.shape, 3), -1)
    index[..., 0] = triangles.vertex_index
    uv = normals = np.zeros((0, 3))
    if triangles.texcoordset:
        uv = triangles.texcoordset[0]
        index[..., 1] = triangles.texcoord_indexset[0]
    if triangles.normal is not None:
        normals = triangles.normal
        index[..., 2] = triangles.normal_index
    return from_indices(index, triangles.vertex, uv, normals, *material)
