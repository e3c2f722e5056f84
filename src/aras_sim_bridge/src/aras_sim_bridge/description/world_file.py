"""An SDF world file: gravity, physics step and pace, models and lights."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import Light, RobotDescription, packages, read_sdf
from aras_sim_bridge.description.lights import read_scene
from aras_sim_bridge.description.types import SUN, SceneSettings
from aras_sim_bridge.errors import DescriptionError, SimError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose, Vector3

MOST_SIMILAR_WARNINGS = 3  # warnings that differ only in the part of the world that they are about
# Where a warning applies, before what it says.
_PART = re.compile(r"((?:model '[^']*'|link '[^']*'|visual '[^']*'|collision '[^']*')[,:] )+(.*)")


@dataclass(frozen=True)
class WorldFile:
    """time_step: s. gravity: m/s². update_rate: steps per second of wall time; 0: free.

    models, lights: what stands in the file, in its order. scene: what is around.
    ground_plane: whether Gazebo's is to be added, because no file was given. Absent numbers are
    Gazebo's defaults. warnings: what the file asks for in vain, one sentence each. time_ns:
    simulated time at which it begins. link_attacher: whether the plug-in of this name is in it.
    """

    time_step: float = 0.001
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.8)
    update_rate: float = 1000.0
    models: tuple[RobotDescription, ...] = ()
    lights: tuple[Light, ...] = (SUN,)
    scene: SceneSettings = SceneSettings()
    ground_plane: bool = True
    warnings: tuple[str, ...] = ()
    time_ns: int = 0
    link_attacher: bool = False


def load_world(
    path: str | Path, resolve_package: packages.ResolvePackage = packages.find_package
) -> WorldFile:
    """Read an SDF world file: gravity, physics step, models, lights and scene.

    `SimulationConfig` takes its numbers and lights, `populate` puts its models into a simulation.

    Args:
        path: of the file; an empty path gives Gazebo's defaults.
        resolve_package: the directory of a package, by its name.

    Raises:
        DescriptionError: no such file, not SDF, something in it that cannot be built, or a number
            that is none.
    """
    if not path:
        return WorldFile()
    where = f"world file {path}"
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"the world file cannot be read: {error}") from None
    root = safe_xml.parse(text, where)
    world = root.find("world") if root.tag in ("sdf", "gazebo") else None
    if world is None:
        raise DescriptionError(f"{where}: there is no <sdf><world> in it")
    try:
        content = read_sdf(root, resolve_package, os.path.dirname(os.path.abspath(path)))
        scene = read_scene(world.find("scene"))
    except DescriptionError as error:
        raise DescriptionError(f"{where}: {error}") from None
    physics = world.find("physics")
    defaults = WorldFile()

    def read_number(tag: str, default: float) -> float:
        text = None if physics is None else safe_xml.find_text(physics, tag)
        return safe_xml.parse_number(text, f"{where}: <{tag}>", default)

    def read_vector(element: Element | None, tag: str, default: Vector3) -> Vector3:
        text = None if element is None else safe_xml.find_text(element, tag)
        return default if text is None else safe_xml.parse_numbers(text, 3, f"{where}: <{tag}>")

    warnings = [text if text.startswith(f"model '{m.name}'") else f"model '{m.name}': {text}"
                for m in content.models for text in m.warnings]
    return WorldFile(
        time_step=read_number("max_step_size", defaults.time_step),
        gravity=read_vector(world, "gravity", read_vector(physics, "gravity", defaults.gravity)),
        update_rate=read_number("real_time_update_rate", defaults.update_rate),
        models=content.models,
        lights=content.lights,
        scene=scene,
        ground_plane=False,
        warnings=(*content.warnings, *_group_warnings(warnings)),
        time_ns=content.time_ns,
        link_attacher=content.link_attacher,
    )


def _group_warnings(warnings: Sequence[str]) -> list[str]:
    """One sentence for what more than MOST_ALIKE parts of models have in common, such as a missing
    mesh: that of the first part, with the number of the others."""
    groups: dict[str, list[str]] = {}
    for warning in warnings:
        found = _PART.match(warning)
        groups.setdefault(found[2] if found else warning, []).append(warning)
    found = []
    for same in groups.values():
        many = len(same) > MOST_SIMILAR_WARNINGS
        found += [f"{same[0]} (and in {len(same) - 1} more places)"] if many else same
    return found


def populate(spawn: Callable[..., object], world: WorldFile,
             warn: Callable[[str], object] | None = None) -> None:
    """Spawn all models of a world file in a simulation.

    Args:
        spawn: `Simulation.spawn`, or a function with the same arguments.
        world: as `load_world` returned it.
        warn: called with one sentence for each model that cannot be simulated, which is left out.

    Raises:
        SimError: a model cannot be simulated, and there is no `warn`.
    """
    for model in world.models:
        try:
            spawn(model, model.name, Pose.from_rpy(*model.initial_pose),
                  joint_positions=model.initial_joints)
        except SimError as error:
            if warn is None:
                raise SimError(f"model '{model.name}' of the world file: {error}") from None
            warn(f"model '{model.name}' is left out: {error}")
