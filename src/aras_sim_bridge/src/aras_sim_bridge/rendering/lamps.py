"""Lights of a scene as rows of numbers in the optical frame.

A light with the colour `diffuse` adds `diffuse` times the cosine of the angle between its direction
and the surface normal, times an attenuation. At the distance d, the attenuation is 1 / (constant +
linear d + quadratic d²), but at most 1, and 0 beyond the light's range. The intensity of a spot
light is full within the inner cone, decreases towards the outer cone, and is 0 outside of it.
Surfaces are Lambertian, so there are no highlights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.compiled import jit_inline
from aras_visual_servo_base.poses import rotation_from_rpy

from ..description.types import Light

# First column of each value in the row of a light. PLACE: unit vector towards a directional light,
# or position (m) of another light. AXIS: direction of the light. FADE: constant, linear and
# quadratic coefficients of the attenuation. RANGE: largest distance (m). INNER, OUTER: cosines of a
# spot light's half angles. RADIUS: angular radius (rad) of a directional light, radius (m) of
# another light.
KIND, PLACE, AXIS, COLOUR, FADE, RANGE, INNER, OUTER, FALLOFF, CASTS_SHADOWS, RADIUS = (
    0, 1, 4, 7, 10, 13, 14, 15, 16, 17, 18)
WIDTH = 19
# Radii of lights with soft shadows: SOFT_SUN of directional lights (rad), SOFT_LAMP of point and
# spot lights (m).
SOFT_SUN, SOFT_LAMP = 0.03, 0.04
DIRECTIONAL, POINT, SPOT = range(3)
_KINDS = {"directional": DIRECTIONAL, "point": POINT, "spot": SPOT}


def pack_lights(lights: Sequence[Light], optical_T_world: np.ndarray, scale: float, shadows: str
            ) -> np.ndarray:
    """Return the rows (lights, WIDTH) of lights, whose values are in the optical frame.

    `lights` are given in the world frame. `scale` multiplies their colours. `shadows` is 'none',
    'hard' or 'soft'.
    """
    rows = np.zeros((len(lights), WIDTH))
    R, t = optical_T_world[:3, :3], optical_T_world[:3, 3]
    for row, light in zip(rows, lights, strict=True):
        kind = _KINDS[light.kind]
        towards = -np.array(light.direction) / np.linalg.norm(light.direction)
        row[KIND] = kind
        row[PLACE:AXIS] = R @ towards if kind == DIRECTIONAL else R @ light.origin_xyz + t
        # In SDF, the pose of a spot light rotates its direction; the poses of other lights do not.
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
    """Write to d (3,) the unit vector from the point p (3,) towards light n.

    Returns:
        Distance of the light (m; inf for a directional light), and its attenuation at p.
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
