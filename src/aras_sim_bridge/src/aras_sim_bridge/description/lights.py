"""Readers and checks of a world's lights and scene settings."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.types import SHADOWS, Light, Rgba, SceneSettings
from aras_sim_bridge.errors import DescriptionError, WorldError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import (
    find_text,
    parse_bool,
    parse_direction,
    parse_number,
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
    fade, spot = element.find("attenuation"), element.find("spot")

    def read_rgba(tag: str, default: Rgba) -> Rgba:
        return _read_rgba(element, tag, where, default)

    return Light(
        element.get("name"), kind, pose.xyz, pose.rpy,
        read_rgba("diffuse", (1.0, 1.0, 1.0, 1.0)), read_rgba("specular", (0.1, 0.1, 0.1, 1.0)),
        parse_direction(find_text(element, "direction"), f"{where}: direction", (0.0, 0.0, -1.0)),
        parse_number(find_text(fade, "constant"), f"{where}: attenuation constant", 1.0),
        parse_number(find_text(fade, "linear"), f"{where}: attenuation linear", 1.0),
        parse_number(find_text(fade, "quadratic"), f"{where}: attenuation quadratic", 0.0),
        parse_number(find_text(fade, "range"), f"{where}: attenuation range", 10.0),
        parse_number(find_text(spot, "inner_angle"), f"{where}: spot inner_angle", 0.6),
        parse_number(find_text(spot, "outer_angle"), f"{where}: spot outer_angle", 1.0),
        parse_number(find_text(spot, "falloff"), f"{where}: spot falloff", 1.0),
        parse_bool(find_text(element, "cast_shadows"), f"{where}: cast_shadows", False),
        _read_intervals(find_text(element, "aras:shines"), f"{where}: aras:shines"))


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
    return SceneSettings(_read_rgba(scene, "ambient", "scene", plain.ambient),
                        _read_rgba(scene, "background", "scene", plain.background),
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


def _read_rgba(element: Element, tag: str, where: str, default: Rgba) -> Rgba:
    text = find_text(element, tag)
    if text is None:
        return default
    values = parse_numbers(text if len(text.split()) != 3 else f"{text} 1", 4, f"{where}: {tag}")
    if min(values) < 0.0:
        raise DescriptionError(f"{where}: {tag} {text} must not be negative")
    return values
