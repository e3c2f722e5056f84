"""What a light of the world may be. The renderers know one sun; see Simulation.set_light."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.types import Light, Rgba
from aras_sim_bridge.errors import DescriptionError, WorldError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import direction, number, numbers, shorten, text_of, truth

# Gazebo's models/sun.
SUN = Light("sun", "directional", direction=(-0.5, 0.1, -0.9))
_DIRECTED = ("origin_xyz", "origin_rpy", "direction")
_STRENGTHS = ("diffuse", "specular", "attenuation_constant", "attenuation_linear",
              "attenuation_quadratic")  # fmt: skip


def checked_light(light: Light) -> Light:
    """Return the light; WorldError naming the number that no light has."""
    if not light.name:
        raise WorldError("a light needs a name that is not empty")
    where = f"light '{light.name}'"
    for what in (*_DIRECTED, *_STRENGTHS):
        value = getattr(light, what)
        values = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(number) for number in values):
            raise WorldError(f"{where}: {what} {value} is not finite")
        if what in _STRENGTHS and min(values) < 0.0:
            raise WorldError(f"{where}: {what} {value} must not be negative")
    if math.hypot(*light.direction) < 1e-9:
        raise WorldError(f"{where}: its direction is zero; a light shines somewhere")
    return light


def read_light(element: Element, pose: Pose) -> Light:
    """The `<light>` of an SDF world that stands at `pose`; DescriptionError naming what is wrong
    with it."""
    where = f"light '{element.get('name')}'"
    kind = element.get("type") or "point"
    if kind not in ("directional", "point", "spot"):
        raise DescriptionError(f"{where}: type '{shorten(kind)}' is unknown; use directional, "
                               "point or spot")
    fade = element.find("attenuation")

    def rgba(tag: str, default: Rgba) -> Rgba:
        text = text_of(element, tag)
        if text is None:
            return default
        return numbers(text if len(text.split()) != 3 else f"{text} 1", 4, f"{where}: {tag}")

    return Light(
        element.get("name"), kind, pose.xyz, pose.rpy,
        rgba("diffuse", (1.0, 1.0, 1.0, 1.0)), rgba("specular", (0.1, 0.1, 0.1, 1.0)),
        direction(text_of(element, "direction"), f"{where}: direction", (0.0, 0.0, -1.0)),
        number(text_of(fade, "constant"), f"{where}: attenuation constant", 1.0),
        number(text_of(fade, "linear"), f"{where}: attenuation linear", 1.0),
        number(text_of(fade, "quadratic"), f"{where}: attenuation quadratic", 0.0),
        truth(text_of(element, "cast_shadows"), f"{where}: cast_shadows", False))
