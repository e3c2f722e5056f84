"""Lights of a scene as rows of numbers in the optical frame.

A light adds `diffuse` times the cosine of its angle to the surface normal, times the attenuation
1 / (constant + linear d + quadratic d²), which is at most 1, and 0 beyond the range. A spot light
has full intensity within its inner cone, falls off up to its outer cone, and is 0 beyond. There are
no highlights: surfaces are Lambertian.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.compiled import jit_inline
from aras_visual_servo_base.poses import rotation_from_rpy

from ..description.types import Light

# Columns of a light's row: kind (0 directional, 1 point, 2 spot); unit vector towards a directional
# light, otherwise its position (m); axis of a spot; colour; attenuation and range; cosines of a
# spot's half angles, and its fall-off; whether it casts shadows; radius (rad or m).
KIND, PLACE, AXIS, COLOUR, FADE, RANGE, INNER, OUTER, FALLOFF, CASTS_SHADOWS, RADIUS = (
    0, 1, 4, 7, 10, 13, 14, 15, 16, 17, 18)
WIDTH = 19
# Radii of lights with soft shadows: rad for directional lights, m for the others.
SOFT_SUN, SOFT_LAMP = 0.03, 0.04
DIRECTIONAL, POINT, SPOT = range(3)
_KINDS = {"directional": DIRECTIONAL, "point": POINT, "spot": SPOT}


def pack_lights(lights: Sequence[Light], optical_T_world: np.ndarray, scale: float, shadows: str
            ) -> np.ndarray:
    """Return the rows (lights, WIDTH) of lights in the world; shadows: 'none', 'hard' or 'soft'."""
    rows = np.zeros((len(lights), WIDTH))
    R, t = optical_T_world[:3, :3], optical_T_world[:3, 3]
    for row, light in zip(rows, lights, strict=True):
        kind = _KINDS[light.kind]
        towards = -np.array(light.direction) / np.linalg.norm(light.direction)
        row[KIND] = kind
        row[PLACE:AXIS] = R @ towards if kind == DIRECTIONAL else R @ light.origin_xyz + t
        # A spot shines along its direction, rotated by the orientation of its pose.
        axis = -towards if kind != SPOT else rotation_from_rpy(*light.origin_rpy) @ -towards
        row[AXIS:COLOUR] = R @ axis
        row[COLOUR:FADE] = scale * np.array(light.diffuse[:3])
        row[FADE:RANGE] = (light.attenuation_constant, light.attenuation_linear,
                           light.attenuation_quadratic)
        row[RANGE] = light.attenuation_range
        row[INNER], row[OUTER] = np.cos(light.spot_inner / 2), np.cos(light.spot_outer / 2)
        row[FALLOFF] = light.spot_falloff
        row[CASTS_SHADOWS] = light.cast_shadows and shadows != "none"
        if shadows == "soft":
            row[RADIUS] = SOFT_SUN if kind == DIRECTIONAL else SOFT_LAMP
    return rows


@jit_inline
def direction_to_lamp(lamps, n, p, d):
    """Write the unit vector from the point p (3,) to lamp n into d (3,).

    Returns:
        Distance of the lamp (m; inf for a directional one) and the attenuation at p.
    """
    far, left = np.inf, 1.0
    if lamps[n, KIND] == DIRECTIONAL:
        for j in range(3):
            d[j] = lamps[n, PLACE + j]
    else:
        squared = 0.0
        for j in range(3):
            d[j] = lamps[n, PLACE + j] - p[j]
            squared += d[j] * d[j]
        far = np.sqrt(max(squared, 1e-18))
        along = 0.0
        for j in range(3):
            d[j] /= far
            along -= d[j] * lamps[n, AXIS + j]
        left = 1.0 / max(lamps[n, FADE] + far * (lamps[n, FADE + 1] + far * lamps[n, FADE + 2]),
                         1.0)
        if far > lamps[n, RANGE]:
            left = 0.0
        if lamps[n, KIND] == SPOT:
            inner, outer = lamps[n, INNER], lamps[n, OUTER]
            share = min(max((along - outer) / max(inner - outer, 1e-9), 0.0), 1.0)
            left *= share ** lamps[n, FALLOFF] if share > 0.0 else 0.0
    return far, left
