"""The lights of a world: their values as Gazebo keeps them, and what they do to the picture.

The renderers know one sun without shadows, in grey. The first directional light is that sun; point
and spot lights are kept and told back, and light nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from aras_sim_bridge.description import Light
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.rendering import Light as PictureLight

# Gazebo's models/sun.
SUN = Light("sun", "directional", direction=(-0.5, 0.1, -0.9))
_FINITE = ("origin_xyz", "origin_rpy", "direction")
_NOT_NEGATIVE = ("diffuse", "specular")
_NOT_NEGATIVE_NUMBERS = ("attenuation_constant", "attenuation_linear", "attenuation_quadratic")


class Lights:
    """The lights of one world by name."""

    def __init__(self, lights: Iterable[Light] = (SUN,)) -> None:
        """Begin with `lights`; WorldError when one is impossible or two have one name."""
        self._lights: dict[str, Light] = {}
        for light in lights:
            self.add(light)

    def all(self) -> Mapping[str, Light]:
        """The lights by name, in the order in which they came; read-only."""
        return MappingProxyType(self._lights)

    def add(self, light: Light) -> None:
        """Put a light into the world; WorldError for a name that is empty or taken."""
        if not light.name:
            raise WorldError("a light needs a name that is not empty")
        if light.name in self._lights:
            raise WorldError(f"a light named '{light.name}' exists already; delete it first")
        self._lights[light.name] = _checked(light)

    def get(self, name: str) -> Light:
        """Return a light; WorldError naming it and those there are."""
        if name not in self._lights:
            known = ", ".join(self._lights) or "none"
            raise WorldError(f"light '{name}' does not exist; there are {known}")
        return self._lights[name]

    def change(self, name: str, **values: Any) -> None:
        """Change fields of a light; WorldError, and nothing changed, for impossible ones."""
        self._lights[name] = _checked(replace(self.get(name), **values))

    def delete(self, name: str) -> None:
        """Take a light out; WorldError when there is none."""
        self.get(name)
        del self._lights[name]

    def for_renderer(self) -> PictureLight:
        """What the renderers draw with: Gazebo's ambient light and the first directional one."""
        for light in self._lights.values():
            if light.kind == "directional":
                return PictureLight(light.direction, diffuse=sum(light.diffuse[:3]) / 3.0)
        return PictureLight(diffuse=0.0)


def _checked(light: Light) -> Light:
    where = f"light '{light.name}'"
    for what in (*_FINITE, *_NOT_NEGATIVE, *_NOT_NEGATIVE_NUMBERS):
        value = getattr(light, what)
        values = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(number) for number in values):
            raise WorldError(f"{where}: {what} {value} is not finite")
        if what not in _FINITE and min(values) < 0.0:
            raise WorldError(f"{where}: {what} {value} must not be negative")
    if math.hypot(*light.direction) < 1e-9:
        raise WorldError(f"{where}: its direction is zero; a light shines somewhere")
    return light
