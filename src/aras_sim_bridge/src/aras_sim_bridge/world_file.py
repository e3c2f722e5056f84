"""What the bridge takes from an SDF world file: gravity, physics step and pace, and its light.

Models in it are not built: spawn them. What is passed over is named in `ignored`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aras_sim_bridge.description import safe_xml
from aras_sim_bridge.errors import DescriptionError

GROUND = "ground_plane"


@dataclass(frozen=True)
class WorldFile:
    """time_step: s. gravity: m/s². update_rate: steps per second of wall time; 0: free.

    sun_direction: from the first directional light to the ground; ground_plane: whether there is
    one. None or absent elements leave Gazebo's defaults.
    """

    time_step: float = 0.001
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.8)
    update_rate: float = 1000.0
    sun_direction: tuple[float, float, float] = (-0.5, 0.1, -0.9)
    ground_plane: bool = True
    ignored: tuple[str, ...] = ()


def read(path: str) -> WorldFile:
    """Return what stands in the world file at `path`; an empty path gives the defaults.

    Raises:
        DescriptionError: no such file, not SDF, or a number in it that is none.
    """
    if not path:
        return WorldFile()
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"the world file cannot be read: {error}") from None
    root = safe_xml.parse(text, f"world file {path}")
    world = root.find("world") if root.tag in ("sdf", "gazebo") else None
    if world is None:
        raise DescriptionError(f"world file {path}: there is no <sdf><world> in it")
    where = f"world file {path}"
    physics = world.find("physics")
    sun = next((light for light in world.findall("light") if light.get("type") == "directional"),
               None)
    included = [safe_xml.text_of(include, "uri") or "" for include in world.findall("include")]
    models = [model.get("name", "") for model in world.findall("model")]
    names = [*models, *(uri.removeprefix("model://") for uri in included)]
    defaults = WorldFile()

    def number(tag: str, default: float) -> float:
        text = None if physics is None else safe_xml.text_of(physics, tag)
        return safe_xml.number(text, f"{where}: <{tag}>", default)

    def vector(element: object, tag: str, default: tuple) -> tuple:
        text = None if element is None else safe_xml.text_of(element, tag)
        return default if text is None else safe_xml.numbers(text, 3, f"{where}: <{tag}>")

    return WorldFile(
        time_step=number("max_step_size", defaults.time_step),
        gravity=vector(world, "gravity", vector(physics, "gravity", defaults.gravity)),
        update_rate=number("real_time_update_rate", defaults.update_rate),
        sun_direction=vector(sun, "direction", defaults.sun_direction),
        ground_plane=GROUND in names,
        ignored=tuple(name for name in names if name not in (GROUND, "sun")),
    )
