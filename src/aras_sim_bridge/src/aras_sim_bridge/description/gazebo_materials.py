"""Gazebo's material names and their colours.

A robot description uses the names in `<gazebo reference="link"><material>Gazebo/Black</material>`.
The colours are the diffuse colours of Gazebo classic's material script. A textured material (wood,
bricks) has the mean colour of its texture.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.ogre_materials import Appearance
from aras_sim_bridge.description.types import Rgba
from aras_visual_servo_base.names import find_nearest
from aras_visual_servo_base.safe_xml import find_text, parse_numbers, shorten

WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)

COLOURS: dict[str, Rgba] = {
    "Gazebo/Grey": (0.7, 0.7, 0.7, 1.0),
    "Gazebo/Gray": (0.7, 0.7, 0.7, 1.0),
    "Gazebo/DarkGrey": (0.175, 0.175, 0.175, 1.0),
    "Gazebo/DarkGray": (0.175, 0.175, 0.175, 1.0),
    "Gazebo/LightGrey": (0.8, 0.8, 0.8, 1.0),
    "Gazebo/White": WHITE,
    "Gazebo/FlatBlack": (0.1, 0.1, 0.1, 1.0),
    "Gazebo/Black": (0.0, 0.0, 0.0, 1.0),
    "Gazebo/Red": (1.0, 0.0, 0.0, 1.0),
    "Gazebo/RedBright": (0.87, 0.26, 0.07, 1.0),
    "Gazebo/Green": (0.0, 1.0, 0.0, 1.0),
    "Gazebo/Blue": (0.0, 0.0, 1.0, 1.0),
    "Gazebo/SkyBlue": (0.13, 0.44, 0.70, 1.0),
    "Gazebo/Yellow": (1.0, 1.0, 0.0, 1.0),
    "Gazebo/ZincYellow": (0.9725, 0.9529, 0.2078, 1.0),
    "Gazebo/DarkYellow": (0.7, 0.7, 0.0, 1.0),
    "Gazebo/Purple": (1.0, 0.0, 1.0, 1.0),
    "Gazebo/Turquoise": (0.0, 1.0, 1.0, 1.0),
    "Gazebo/Orange": (1.0, 0.5088, 0.0468, 1.0),
    "Gazebo/Indigo": (0.33, 0.0, 0.5, 1.0),
    "Gazebo/Gold": (0.8, 0.64869, 0.120759, 1.0),
    "Gazebo/Wood": (0.55, 0.40, 0.25, 1.0),
    "Gazebo/WoodFloor": (0.55, 0.40, 0.25, 1.0),
    "Gazebo/Bricks": (0.55, 0.35, 0.30, 1.0),
    "Gazebo/Road": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Residential": (0.35, 0.35, 0.35, 1.0),
    "Gazebo/Grass": (0.26, 0.36, 0.14, 1.0),
    "Gazebo/CeilingTiled": (0.65, 0.65, 0.62, 1.0),
    "Gazebo/PaintedWall": (0.80, 0.78, 0.72, 1.0),
    "Gazebo/PioneerBody": (1.0, 0.0, 0.0, 1.0),
    "Gazebo/Pioneer2Body": (0.681193, 0.000923, 0.000923, 1.0),
    "Gazebo/WoodPallet": (0.60, 0.47, 0.33, 1.0),
    "Gazebo/WindowFrame": (0.75, 0.75, 0.75, 1.0),
    "Gazebo/BuildingFrame": (0.60, 0.60, 0.60, 1.0),
    "Gazebo/Runway": (0.35, 0.35, 0.35, 1.0),
    "Gazebo/GreyGradientSky": (0.70, 0.70, 0.70, 1.0),
    "Gazebo/CloudySky": (0.55, 0.65, 0.80, 1.0),
    "Gazebo/Tertiary": (0.35, 0.35, 0.35, 1.0),
    "Gazebo/Primary": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Secondary": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Trunk": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Motorway": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Lane_1": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Lanes_2": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Lanes_4": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Lanes_6": (0.30, 0.30, 0.30, 1.0),
    "Gazebo/Pedestrian": (0.55, 0.55, 0.52, 1.0),
    "Gazebo/Footway": (0.55, 0.55, 0.52, 1.0),
    "Gazebo/Steps": (0.50, 0.50, 0.50, 1.0),
    "Gazebo/CoM": (0.5, 0.5, 0.5, 1.0),
    "Gazebo/JointAnchor": WHITE,
    "Gazebo/LightOn": (0.0, 1.0, 0.0, 1.0),
    "Gazebo/LightOff": (1.0, 0.0, 0.0, 1.0),
    "Gazebo/RedGlow": (1.0, 0.0, 0.0, 1.0),
    "Gazebo/GreenGlow": (0.0, 1.0, 0.0, 1.0),
    "Gazebo/BlueGlow": (0.0, 0.0, 1.0, 1.0),
    "Gazebo/YellowGlow": (1.0, 1.0, 0.0, 1.0),
    "Gazebo/PurpleGlow": (1.0, 0.0, 1.0, 1.0),
    "Gazebo/TurquoiseGlow": (0.0, 1.0, 1.0, 1.0),
    "Gazebo/TurquoiseGlowOutline": (0.0, 1.0, 1.0, 1.0),
    "Gazebo/WhiteGlow": WHITE,
    "Gazebo/RedTransparent": (1.0, 0.0, 0.0, 0.5),
    "Gazebo/GreenTransparent": (0.0, 1.0, 0.0, 0.5),
    "Gazebo/BlueTransparent": (0.0, 0.0, 1.0, 0.5),
    "Gazebo/YellowTransparent": (1.0, 1.0, 0.0, 0.5),
    "Gazebo/GreyTransparent": (0.5, 0.5, 0.5, 0.5),
    "Gazebo/BlackTransparent": (0.0, 0.0, 0.0, 0.5),
    "Gazebo/OrangeTransparent": (1.0, 0.44, 0.0, 0.4),
    "Gazebo/DarkMagentaTransparent": (0.6, 0.0, 0.6, 0.5),
    "Gazebo/BlueLaser": (0.0, 0.0, 1.0, 0.4),
    "Gazebo/LightBlueLaser": (0.5, 0.5, 1.0, 0.4),
    "Gazebo/RedTransparentOverlay": (1.0, 0.0, 0.0, 0.5),
    "Gazebo/GreenTransparentOverlay": (0.0, 1.0, 0.0, 0.5),
    "Gazebo/BlueTransparentOverlay": (0.0, 0.0, 1.0, 0.5),
    "Gazebo/OrangeTransparentOverlay": (1.0, 0.5088, 0.0468, 0.8),
    "Gazebo/DarkOrangeTransparentOverlay": (0.6, 0.305, 0.028, 0.8),
    "youbot/Orange": (1.0, 0.4, 0.0, 1.0),
    "youbot/DarkGrey": WHITE,
    "youbot/Grey": (0.7, 0.7, 0.7, 1.0),
    "drc/san_fauxcity_sign": (0.8, 0.8, 0.8, 1.0),
}


def find_colour(name: str, link: str, warnings: list[str]) -> Rgba:
    """Return the colour of a link's Gazebo material, rgba in 0 … 1.

    An unknown material is drawn white, as in Gazebo; a sentence in `warnings` then names the most
    similar known material.
    """
    if name not in COLOURS:
        near = find_nearest(f"Gazebo/{name.split('/')[-1]}", COLOURS, 0.0)
        warnings.append(f"link '{link}' is drawn white, because Gazebo has no material "
                        f"'{shorten(name)}'; did you mean '{near}'?")
    return COLOURS.get(name, WHITE)


def find_sdf_colour(
    link: Element, name: str, warnings: list[str], appearances: Sequence[Appearance | None]
) -> Rgba | None:
    """Return the colour of an SDF link: the colour of its first visual that has one.

    Args:
        appearances: for each visual of the link, in order, the appearance from its material script.
    """
    found = [appearance.colour or WHITE if appearance is not None
             else find_text(visual.find("material/script"), "name")
             or _read_colour(visual, f"link '{name}'")
             for visual, appearance in zip(link.findall("visual"), appearances, strict=True)]
    found = [colour for colour in found if colour is not None]
    if any(colour != found[0] for colour in found):
        warnings.append(f"link '{name}': all visuals are drawn in the colour of the first visual; "
                        "put visuals of other colours into other links")
    first = found[0] if found else None
    return find_colour(first, name, warnings) if isinstance(first, str) else first


def _read_colour(visual: Element, where: str) -> Rgba | None:
    """Return the diffuse colour of an SDF visual's material.

    If the material has no diffuse colour, return its ambient colour; if it has neither, return
    None.
    """
    material = visual.find("material")
    for tag in ("diffuse", "ambient"):
        text = find_text(material, tag)
        if text is not None:
            full = f"{text} 1" if len(text.split()) == 3 else text
            return parse_numbers(full, 4, f"{where}: material {tag}")
    return None
