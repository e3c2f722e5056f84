"""Readers of the geometry and bounce settings of URDF and SDF visuals and collisions."""

from collections.abc import Callable
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.shape_meshes import read_mesh
from aras_sim_bridge.description.types import Geometry
from aras_sim_bridge.errors import DescriptionError, UnsupportedPartError
from aras_visual_servo_base.safe_xml import (
    ElementReader,
    find_text,
    parse_direction,
    parse_number,
    parse_numbers,
    shorten,
)

SHAPES = ("box", "cylinder", "sphere", "capsule", "plane", "mesh")
# Function that finds a mesh file: (mesh URI, name of the URDF or SDF element in messages) -> path
# of the file.
Resolve = Callable[[str, str], str]
_SMALLEST_SIZE = 1e-4  # size used for a shape whose size is zero, m; as in Gazebo
_NO_SLIP = 1e6  # friction coefficient with which nothing slips


def read_geometry(
    element: Element, where: str, resolve: Resolve, warnings: list[str], is_sdf: bool
) -> Geometry | None:
    """Read the shape of a visual or collision.

    URDF contains the size of a shape in attributes, SDF in child elements. A size of zero becomes
    0.1 mm, as in Gazebo.

    Returns:
        The shape. If it is empty, None. If it is not supported, None; `warnings` then gets a
        sentence.

    Raises:
        DescriptionError: a size is negative or not a number.
    """
    shape = element.find("geometry/*")
    if shape is not None and shape.tag == "empty" and is_sdf:
        return None
    try:
        if shape is None:
            raise UnsupportedPartError(f"{where}: <geometry> with a shape is missing; add it")
        return _read_shape(shape, where, resolve, warnings, is_sdf)
    except UnsupportedPartError as error:
        warnings.append(f"{error}; the {element.tag} is ignored")
        return None


def parse_friction(text: str, where: str) -> float:
    """Parse a friction coefficient; as in Gazebo, a negative one means that nothing slips.

    Raises:
        DescriptionError: the text is not a finite number.
    """
    coefficient = parse_number(text, where)
    return coefficient if coefficient >= 0.0 else _NO_SLIP


def read_bounce(collision: Element, where: str) -> tuple[float, float] | None:
    """Read the restitution coefficient and threshold speed in the `<surface>` of a collision.

    Returns:
        (coefficient, threshold in m/s), or None if there is no `<restitution_coefficient>`.

    Raises:
        DescriptionError: the coefficient is outside 0 … 1, or the threshold is negative.
    """
    node = collision.find("surface/bounce")
    if find_text(node, "restitution_coefficient") is None:
        return None
    share = parse_number(
        find_text(node, "restitution_coefficient"), f"{where}: restitution_coefficient"
    )
    least = parse_number(find_text(node, "threshold"), f"{where}: threshold", 0.0)
    if not (0.0 <= share <= 1.0 and least >= 0.0):
        raise DescriptionError(f"{where}: <bounce> has restitution_coefficient {share} and "
                               f"threshold {least}; the coefficient must be 0 to 1, and the "
                               "threshold at least 0 m/s")
    return share, least


def _read_shape(
    shape: Element, where: str, resolve: Resolve, warnings: list[str], is_sdf: bool
) -> Geometry:
    def value(key: str) -> str | None:
        return find_text(shape, key) if is_sdf else shape.get(key)

    kind = shape.tag

    def read_positive(key: str, count: int, default: tuple[float, ...] | None = None) -> tuple:
        sizes = parse_numbers(value(key), count, f"{where}: {kind} {key}", default)
        if sizes == default or min(sizes) > 0.0:
            return sizes
        shown = sizes[0] if count == 1 else sizes
        if min(sizes) < 0.0:
            raise DescriptionError(f"{where}: {kind} {key} is {shown}; it must be positive")
        warnings.append(
            f"{where}: {kind} {key} is {shown}; {_SMALLEST_SIZE} m is used instead of 0, "
            "as in Gazebo"
        )
        return tuple(size or _SMALLEST_SIZE for size in sizes)

    if kind == "box":
        return Geometry(kind, size=read_positive("size", 3))
    if kind in ("cylinder", "capsule"):
        return Geometry(
            kind, radius=read_positive("radius", 1)[0], length=read_positive("length", 1)[0]
        )
    if kind == "sphere":
        return Geometry(kind, radius=read_positive("radius", 1)[0])
    if kind == "plane":  # the URDF standard has no <plane>, but Bullet and this reader accept it
        default = (1.0, 1.0) if is_sdf else (0.0, 0.0)
        normal = parse_direction(value("normal"), f"{where}: plane normal", (0.0, 0.0, 1.0))
        return Geometry(kind, size=(*read_positive("size", 2, default), 0.0), normal=normal)
    if kind == "mesh":
        file = "uri" if is_sdf else "filename"
        uri = value(file)
        if not uri:
            raise UnsupportedPartError(f"{where}: <mesh> has no {file}; add the path of the file")
        factors = (value("scale") or "1 1 1").split()
        scale = parse_numbers(
            " ".join(factors * 3 if len(factors) == 1 else factors), 3, f"{where}: scale"
        )
        if 0.0 in scale:
            raise UnsupportedPartError(
                f"{where}: mesh scale {scale} contains a zero; use numbers other than 0"
            )
        submesh = ElementReader(shape.find("submesh") if is_sdf else None, f"{where}: submesh ")
        if submesh.element is not None and not submesh.read_text("name"):
            raise UnsupportedPartError(f"{where}: <submesh> has no <name>; add it")
        mesh = Geometry(
            kind, filename=resolve(uri, where), scale=scale,
            submesh=submesh.read_text("name") or "", is_centred=submesh.read_bool("center", False),
        )  # fmt: skip
        return _check_submesh(mesh, where)
    raise UnsupportedPartError(
        f"{where}: shape <{shorten(kind)}> is not supported; use {', '.join(SHAPES)}")


def _check_submesh(mesh: Geometry, where: str) -> Geometry:
    """Return the shape; raise an UnsupportedPartError if its file does not contain its submesh."""
    if mesh.submesh:
        try:
            read_mesh(mesh)
        except DescriptionError as error:
            raise UnsupportedPartError(f"{where}: {error}") from None
    return mesh
