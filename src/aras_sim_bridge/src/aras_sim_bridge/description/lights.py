"""What a light of the world may be. The renderers know one sun; see Simulation.set_light."""

from __future__ import annotations

import math

from aras_sim_bridge.description import Light
from aras_sim_bridge.errors import WorldError

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
