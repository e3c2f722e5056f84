"""Light in camera images, combined from the lights of a world and its scene settings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from aras_sim_bridge.description import Light
from aras_sim_bridge.description.types import SceneSettings, is_present
from aras_sim_bridge.rendering import Lighting

MOST_LIGHTS = 16  # largest number of lights that illuminate camera images
DARK = (0.0, 0.0, 0.0, 1.0)
NO_LIGHT = Light("none", diffuse=DARK)


def make_lighting(
    lights: Iterable[Light], scene: SceneSettings, exposure: str, time: float
) -> Lighting:
    """Return the light in camera images at a simulated time, s.

    Args:
        lights: lights of the world; the first MOST_LIGHTS illuminate images.
        scene: ambient light, background and shadows of the world.
        exposure: conversion of light to grey levels, one of rendering.EXPOSURES.
        time: simulated time, s, at which some lights may be off.
    """
    lights = tuple(lights)[:MOST_LIGHTS]
    now = tuple(
        light if is_present(light.lit_intervals, time) else replace(light, diffuse=DARK)
        for light in lights
    )
    light = _combine(lights, scene, exposure)
    if now == lights:
        return light
    return replace(_combine(now, scene, exposure), reference_white_level=light.white_level)


def _combine(lights: tuple[Light, ...], scene: SceneSettings, exposure: str) -> Lighting:
    """Return the light that consists of these lights and the ambient light.

    If possible, the result describes a single white sun by its fields `direction` and `diffuse`.
    Otherwise it lists all lights in its field `lights`.
    """
    ambient = max(scene.ambient[:3])
    tint = tuple(part / (ambient or 1.0) for part in scene.ambient[:3])
    around = Lighting(diffuse=0.0, ambient=ambient, tint=tint, background=scene.background,
                      sky=scene.sky, exposure=exposure, shadows=scene.shadows)
    shadows = scene.shadows != "none" and any(light.cast_shadows for light in lights)
    if len(set(tint)) == 1 and len(lights) <= 1 and not shadows:
        if not lights:
            return around
        (light,) = lights
        if light.kind == "directional" and len(set(light.diffuse[:3])) == 1:
            return replace(around, direction=light.direction, diffuse=light.diffuse[0])
    return replace(around, lights=lights or (NO_LIGHT,))
