"""Readers and checks of a world's lights and scene settings."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.types import SHADOWS, Light, Rgba, SceneSettings
from aras_sim_bridge.errors import DescriptionError, WorldError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import (
    ElementReader,
    find_text,
    parse_direction,
    parse_numbers,
    shorten,
)

_DIRECTION_FIELDS = ("origin_xyz", "origin_rpy", "direction")
_STRENGTH_FIELDS = ("diffuse", "specular", "attenuation_constant", "attenuation_linear",
              "attenuation_quadratic", "attenuation_range", "spot_inner", "spot_outer",
              "spot_falloff")  # fmt: skip


def check_light(light: Light) -> Light:
    """Return the light if it is valid.

    Raises:
        WorldError: a setting is negative, infinite, NaN or otherwise impossible for a light.
    """
    if not light.name:
        raise WorldError("a light has no name; give it one")
    where = f"light '{light.name}'"
    for what in (*_DIRECTION_FIELDS, *_STRENGTH_FIELDS):
        value = getattr(light, what)
        values = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(number) for number in values):
            raise WorldError(f"{where}: {what} {value} is not finite; give finite numbers")
        if what in _STRENGTH_FIELDS and min(values) < 0.0:
            raise WorldError(f"{where}: {what} {value} must not be negative")
    if math.hypot(*light.direction) < 1e-9:
        raise WorldError(f"{where}: direction is the zero vector; give the direction in which the "
                         "light shines")
    for begin, end in light.lit_intervals or ():
        if not 0.0 <= begin < end:
            raise WorldError(f"{where}: the lit interval is from {begin:g} to {end:g} s; it must "
                             "start at 0 s or later and end after its start")
    return light


def read_light(element: Element, pose: Pose) -> Light:
    """Read a `<light>` of an SDF world, whose pose in the world is `pose`.

    Raises:
        DescriptionError: an element has an invalid value.
    """
    where = f"light '{element.get('name')}'"
    kind = element.get("type") or "point"
    if kind not in ("directional", "point", "spot"):
        raise DescriptionError(f"{where}: type '{shorten(kind)}' is unknown; use directional, "
                               "point or spot")
    light = ElementReader(element, f"{where}: ")
    fade, spot = light.get_child("attenuation"), light.get_child("spot")
    return Light(
        name=element.get("name"),
        kind=kind,
        origin_xyz=pose.xyz,
        origin_rpy=pose.rpy,
        diffuse=_read_rgba(light, "diffuse", (1.0, 1.0, 1.0, 1.0)),
        specular=_read_rgba(light, "specular", (0.1, 0.1, 0.1, 1.0)),
        direction=parse_direction(
            light.read_text("direction"), f"{where}: direction", (0.0, 0.0, -1.0)
        ),
        attenuation_constant=fade.read_number("constant", 1.0),
        attenuation_linear=fade.read_number("linear", 1.0),
        attenuation_quadratic=fade.read_number("quadratic", 0.0),
        attenuation_range=fade.read_number("range", 10.0),
        spot_inner=spot.read_number("inner_angle", 0.6),
        spot_outer=spot.read_number("outer_angle", 1.0),
        spot_falloff=spot.read_number("falloff", 1.0),
        cast_shadows=light.read_bool("cast_shadows", False),
        lit_intervals=_read_intervals(light.read_text("aras:shines"), f"{where}: aras:shines"),
    )


def read_scene(scene: Element | None) -> SceneSettings:
    """Read a world's `<scene>`.

    The element `<aras:shadows>` selects the shadows. SDF's `<shadows>` is ignored: Gazebo sets it
    in every world that it saves, but the image-processing thresholds of the ARAS simulator were
    chosen for images without shadows.

    Raises:
        DescriptionError: an element has an invalid value.
    """
    plain = SceneSettings()
    if scene is None:
        return plain
    shadows = find_text(scene, "aras:shadows") or plain.shadows
    if shadows not in SHADOWS:
        raise DescriptionError(f"scene: aras:shadows '{shorten(shadows)}' is unknown; use "
                               f"{', '.join(SHADOWS)}")
    colours = ElementReader(scene, "scene: ")
    return SceneSettings(_read_rgba(colours, "ambient", plain.ambient),
                         _read_rgba(colours, "background", plain.background),
                         scene.find("sky") is not None, shadows)


def _read_intervals(text: str | None, where: str) -> tuple[tuple[float, float], ...] | None:
    if text is None:
        return None
    count = len(text.split())
    values = parse_numbers(text, count + count % 2, where)
    pairs = tuple(zip(values[::2], values[1::2], strict=True))
    for begin, end in pairs:
        if not 0.0 <= begin < end:
            raise DescriptionError(f"{where} is from {begin:g} to {end:g} s; it must start at 0 s "
                                   "or later and end after its start")
    return pairs


def _read_rgba(reader: ElementReader, tag: str, default: Rgba) -> Rgba:
    text = reader.read_text(tag)
    if text is None:
        return default
    where = reader.prefix + tag
    values = parse_numbers(text if len(text.split()) != 3 else f"{text} 1", 4, where)
    if min(values) < 0.0:
        raise DescriptionError(f"{where} {text} must not be negative")
    return values
