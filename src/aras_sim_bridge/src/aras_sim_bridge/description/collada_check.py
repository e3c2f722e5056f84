"""COLLADA files: whether Bullet can follow everything that they refer to."""

import re
from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np

from aras_sim_bridge.description import safe_xml
from aras_sim_bridge.errors import DescriptionError

# How many numbers a node's transform has. Bullet looks for further ones behind the node.
_TRANSFORMS = {"matrix": 16, "translate": 3, "scale": 3, "rotate": 4}
_PRIMITIVES = ("triangles", "polylist")  # what Bullet reads, each as triangles; the rest it leaves
_MOST_GEOMETRIES = 512  # Bullet leaves out the others
# Bullet takes the first thing inside these for their text, without asking what it is.
_NOT_TEXT_FIRST = re.compile(r"<(?:p|float_array|up_axis)\b[^>]*(?<!/)>\s*<[!?]")


def check(data: bytes, solid: bool) -> None:
    """Check the bytes of a .dae file.

    Args:
        solid: it is to be collided with, so there must be triangles that Bullet reads.

    Raises:
        DescriptionError: saying what is missing or wrong.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DescriptionError("it is not UTF-8 text") from None
    root = safe_xml.parse(text, "COLLADA", largest=len(data))
    if root.tag != "COLLADA":
        tag = safe_xml.shorten(root.tag)
        raise DescriptionError(f"its root element is <{tag}>, not <COLLADA>")
    if _NOT_TEXT_FIRST.search(text):
        raise DescriptionError("a comment stands before the text of a <p>, an array or <up_axis>")
    _check_asset(_child(root, "asset"))
    known = _Geometries()
    for geometry in _child(root, "library_geometries").findall("geometry"):
        known.read(geometry)
    shown = sum(known.triangles.get(name, 0) for name in _instances(root))
    if solid and shown == 0:
        raise DescriptionError(
            "its scene shows no <triangles>, and Bullet reads nothing else to collide with"
        )
    if solid and known.polygons:
        raise DescriptionError(
            "it has polygons of more than three corners, which Bullet would take for triangles"
        )


def _check_asset(asset: Element) -> None:
    unit, up_axis = asset.find("unit"), asset.find("up_axis")
    if unit is not None:
        safe_xml.number(_attribute(unit, "meter"), "<unit>: meter")
    if up_axis is not None:
        _text(up_axis)


class _Geometries:
    """What `library_geometries` holds; names of all geometries are in one pot, as in Bullet.

    triangles: their number by geometry. polygons: whether some are not triangles.
    """

    def __init__(self) -> None:
        self.triangles: dict[str, int] = {}
        self.polygons = False
        self._sources: dict[str, Element] = {}
        self._vertices: dict[str, dict[str, str]] = {}

    def read(self, geometry: Element) -> None:
        """Check one geometry and remember what others may refer to."""
        name = _attribute(geometry, "id")
        if len(self.triangles) == _MOST_GEOMETRIES:
            raise DescriptionError(f"it has more than {_MOST_GEOMETRIES} geometries")
        self.triangles[name] = 0
        for mesh in geometry.findall("mesh"):
            for source in mesh.findall("source"):
                self._sources[_attribute(source, "id")] = source
            vertices = _child(mesh, "vertices")
            self._vertices[_attribute(vertices, "id")] = {
                _attribute(part, "semantic"): _reference(part, "source")
                for part in vertices.findall("input")
            }
            for primitive in mesh:
                if primitive.tag in _PRIMITIVES:
                    self.triangles[name] += self._check_primitive(primitive)
                vcount = primitive.find("vcount")
                self.polygons |= vcount is not None and (_numbers(vcount, int) != 3).any()

    def _check_primitive(self, primitive: Element) -> int:
        """Number of triangles of a primitive, each corner of which exists."""
        what = f"<{primitive.tag}>"
        count = safe_xml.integer(_attribute(primitive, "count"), f"{what}: count")
        offsets: dict[str, tuple[int, str]] = {}
        stride = 1
        for part in primitive.findall("input"):
            semantic, source = _attribute(part, "semantic"), _reference(part, "source")
            offset = safe_xml.integer(_attribute(part, "offset"), "<input>: offset")
            stride = max(stride, offset + 1)
            if offset < 0 or semantic == "VERTEX" and source not in self._vertices:
                raise DescriptionError(f"<input> '{semantic}': there is no '{source}' at {offset}")
            if semantic == "VERTEX":
                offsets |= {k: (offset, v) for k, v in self._vertices[source].items()}
            elif semantic == "NORMAL":
                offsets[semantic] = (offset, source)
        indices = _numbers(_child(primitive, "p"), int)
        if count < 0 or len(indices) < 3 * count * stride:
            raise DescriptionError(f"{what} of {count}: <p> has {len(indices)} indices")
        corners = indices[:3 * count * stride].reshape(-1, stride)
        if "POSITION" not in offsets:
            raise DescriptionError(f"{what} has no positions")
        for semantic, (offset, source) in offsets.items():
            if semantic in ("POSITION", "NORMAL") and count:
                length = self._length(source)
                mine = corners[:, offset]
                wrong = mine[(mine < 0) | (mine >= length)]
                if len(wrong):
                    raise DescriptionError(f"{what} names {semantic} {wrong[0]} of {length}")
        return count

    def _length(self, name: str) -> int:
        """Number of the points or normals of a <source>."""
        if name not in self._sources:
            raise DescriptionError(f"there is no <source> '{safe_xml.shorten(name)}'")
        source = self._sources[name]
        _child(_child(source, "technique_common"), "accessor")
        array = _child(source, "float_array")
        values = _numbers(array, float)
        count = safe_xml.integer(_attribute(array, "count"), "<float_array>: count")
        if count != len(values):
            raise DescriptionError(f"<float_array> of {count} has {len(values)} numbers")
        if not np.isfinite(values).all():
            raise DescriptionError("<float_array> holds a number that is not finite")
        return len(values) // 3


def _instances(root: Element) -> Iterator[str]:
    """Names of the geometries that the scene shows."""
    library, scene = root.find("library_visual_scenes"), root.find("scene/instance_visual_scene")
    if library is None:
        return
    scenes = {_attribute(element, "id"): element for element in library.findall("visual_scene")}
    if scene is None:
        return
    shown = scenes.get(_reference(scene, "url"))
    if shown is None:
        return
    for node in shown.iter("node"):
        _check_transforms(node)
        for instance in node.findall("instance_geometry"):
            yield _reference(instance, "url")


def _check_transforms(node: Element) -> None:
    seen_node = False
    for child in node:
        seen_node = seen_node or child.tag == "node"
        if child.tag not in _TRANSFORMS or not (child.text or "").strip():
            continue
        safe_xml.numbers(child.text, _TRANSFORMS[child.tag], f"<{child.tag}>")
        if seen_node:  # Bullet would search for it for ever
            raise DescriptionError(f"<{child.tag}> comes after a <node>")


def _child(element: Element, tag: str) -> Element:
    child = element.find(tag)
    if child is None:
        raise DescriptionError(f"<{element.tag}> has no <{tag}>")
    return child


def _attribute(element: Element, name: str) -> str:
    value = element.get(name)
    if value is None:
        raise DescriptionError(f"<{element.tag}> has no {name}")
    return value


def _reference(element: Element, name: str) -> str:
    """What '#name' refers to."""
    value = _attribute(element, name)
    if not value.startswith("#"):
        raise DescriptionError(
            f"<{element.tag}>: {name} '{safe_xml.shorten(value)}' does not begin with #"
        )
    return value[1:]


def _text(element: Element) -> str:
    if not (element.text or "").strip():
        raise DescriptionError(f"<{element.tag}> is empty")
    return element.text


def _numbers(element: Element, kind: type) -> np.ndarray:
    try:
        return np.array(_text(element).split(), dtype=kind)
    except (ValueError, OverflowError):
        raise DescriptionError(f"<{element.tag}> holds what is no number") from None
