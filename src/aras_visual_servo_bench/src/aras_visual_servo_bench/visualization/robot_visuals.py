"""Triangles and colours of a robot's visuals, link by link."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

import cv2

from aras_sim_bridge.description import Geometry, RobotDescription
from aras_sim_bridge.description.shape_meshes import make_meshes
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.meshes.mesh import Mesh
from aras_visual_servo_base.poses import matrix_from_xyz_rpy

Colour = tuple[float, ...]  # red, green, blue, opacity, 0 to 1
DEFAULT_COLOUR = (0.7, 0.7, 0.72, 1.0)  # colour of visuals whose description has none


def collect_visuals(robot: RobotDescription, urdf: str) -> Iterator[tuple[str, Colour, Mesh]]:
    """Yield the link, the colour and the mesh of each visual of a robot.

    The mesh is in the frame of the link, m.

    Args:
        robot: parsed description of the robot.
        urdf: text of this description.

    Raises:
        DescriptionError: the description, or one of its meshes, cannot be used.
    """
    colours = _read_colours(urdf)
    for link in robot.links.values():
        for i, visual in enumerate(link.visuals):
            colour = colours.get((link.name, i), robot.colours.get(link.name, DEFAULT_COLOUR))
            link_T_visual = matrix_from_xyz_rpy(visual.origin_xyz, visual.origin_rpy)
            for mesh in _load_meshes(visual.geometry):
                mesh_colour = _compute_mean_colour(mesh.texture) if mesh.texture else mesh.rgba
                yield link.name, mesh_colour or colour, mesh.transform(link_T_visual)


def _compute_mean_colour(texture: str) -> Colour | None:
    """Return the mean colour of a texture's image file; return None if it cannot be read."""
    image = cv2.imread(texture, cv2.IMREAD_COLOR)
    if image is None:
        return None
    blue, green, red = (image.reshape(-1, 3).mean(axis=0) / 255.0).tolist()
    return red, green, blue, 1.0


def _load_meshes(geometry: Geometry) -> tuple[Mesh, ...]:
    if geometry.kind == "mesh" and not Path(geometry.filename).is_file():
        return ()  # raise no error, because the simulator has already reported the missing file
    return make_meshes(geometry)


def _read_colours(urdf: str) -> dict[tuple[str, int], tuple[float, ...]]:
    """Return the colour of each visual's URDF material, by the link and the visual's number.

    These are the colours that rviz shows. The simulated cameras use Gazebo's materials instead.
    """
    root = safe_xml.parse(urdf, "URDF")
    known = {m.get("name"): _read_rgba(m) for m in root.findall("material")}
    found = {}
    for link in root.findall("link"):
        for i, visual in enumerate(link.findall("visual")):
            material = visual.find("material")
            if material is not None:
                rgba = _read_rgba(material) or known.get(material.get("name"))
                if rgba:
                    found[link.get("name", ""), i] = rgba
    return found


def _read_rgba(material: Element) -> tuple[float, ...] | None:
    colour = material.find("color")
    try:
        values = tuple(float(word) for word in colour.get("rgba", "").split())
    except (AttributeError, ValueError):
        return None
    return values if len(values) == 4 else None
