"""Shapes and colours of SDF visuals and collisions."""

from collections.abc import Callable
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.safe_xml import number, numbers, shorten, text_of
from aras_sim_bridge.description.types import Geometry, Rgba
from aras_sim_bridge.description.urdf import unit
from aras_sim_bridge.errors import DescriptionError

SHAPES = ("box", "cylinder", "sphere", "capsule", "plane", "mesh")


def geometry(element: Element, where: str, resolve: Callable[[str, str], str]) -> Geometry:
    """The shape in a visual's or collision's `<geometry>`.

    Raises:
        DescriptionError: no shape, one that is not among SHAPES, or a size that is not positive.
    """
    node = element.find("geometry")
    shape = next(iter(node), None) if node is not None else None
    if shape is None:
        raise DescriptionError(f"{where}: has no <geometry> with a shape in it")
    if shape.tag not in SHAPES:
        raise DescriptionError(f"{where}: shape <{shorten(shape.tag)}> is not supported; use "
                               f"{', '.join(SHAPES)}")

    def positive(tag: str) -> float:
        value = number(text_of(shape, tag), f"{where}: {shape.tag} {tag}")
        if value <= 0.0:
            raise DescriptionError(f"{where}: {shape.tag} {tag} is {value}; it must be positive")
        return value

    if shape.tag == "box":
        size = numbers(text_of(shape, "size"), 3, f"{where}: box size")
        if min(size) <= 0.0:
            raise DescriptionError(f"{where}: box size {size} must be positive")
        return Geometry("box", size=size)
    if shape.tag in ("cylinder", "capsule"):
        return Geometry(shape.tag, radius=positive("radius"), length=positive("length"))
    if shape.tag == "sphere":
        return Geometry("sphere", radius=positive("radius"))
    if shape.tag == "plane":
        normal = numbers(text_of(shape, "normal"), 3, f"{where}: plane normal", (0.0, 0.0, 1.0))
        size = numbers(text_of(shape, "size"), 2, f"{where}: plane size", (1.0, 1.0))
        if min(size) <= 0.0:
            raise DescriptionError(f"{where}: plane size {size} must be positive")
        return Geometry("plane", size=(*size, 0.0), normal=unit(normal, f"{where}: plane normal"))
    if shape.find("submesh") is not None:
        raise DescriptionError(f"{where}: <submesh> is not supported; give it a file of its own")
    uri = text_of(shape, "uri")
    if not uri:
        raise DescriptionError(f"{where}: <mesh> has no <uri>")
    scale = numbers(text_of(shape, "scale"), 3, f"{where}: scale", (1.0, 1.0, 1.0))
    if 0.0 in scale:
        raise DescriptionError(f"{where}: mesh scale {scale} holds a zero")
    return Geometry("mesh", filename=resolve(uri, where), scale=scale)


def material_name(visual: Element) -> str | None:
    """Name of a Gazebo material script ('Gazebo/Grey'), None without one."""
    return text_of(visual.find("material/script"), "name") or None


def colour(visual: Element, where: str) -> Rgba | None:
    """Diffuse colour of a visual's material, else its ambient one, else None."""
    material = visual.find("material")
    for tag in ("diffuse", "ambient"):
        text = text_of(material, tag)
        if text is not None:
            full = f"{text} 1" if len(text.split()) == 3 else text
            return numbers(full, 4, f"{where}: material {tag}")
    return None
