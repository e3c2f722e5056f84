"""Reader of SDF world files: gravity, physics step and real-time rate, models and lights."""

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

# Warnings that differ only in the part of the model that they name are merged if there are more
# than this number.
MOST_SIMILAR_WARNINGS = 3
# Matches a warning. Group 1 is the prefix that names a part of the model; group 2 is the text after
# the prefix.
_PART = re.compile(r"((?:model '[^']*'|link '[^']*'|visual '[^']*'|collision '[^']*')[,:] )+(.*)")


@dataclass(frozen=True)
class WorldFile:
    """Content of a world file; missing numbers have Gazebo's defaults.

    Attributes:
        time_step: physics step, s.
        gravity: acceleration of gravity in the world frame, m/s².
        update_rate: physics steps per second of wall time; 0 means as fast as possible.
        models, lights: models and lights in the order of the file.
        ground_plane: whether to add Gazebo's ground plane, because no file was given.
        warnings: one sentence for each part of the file that is ignored.
        time_ns: simulated time at the start.
        link_attacher: whether the world has the plug-in gazebo_ros_link_attacher.
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

    `SimulationConfig` takes gravity, physics step, lights and scene; `populate` spawns the models.

    Args:
        path: path of the file; with an empty path, return Gazebo's defaults.
        resolve_package: function that returns the directory of a package.

    Raises:
        DescriptionError: the file is missing, is not SDF, or has an element or number that is
            invalid.
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
        raise DescriptionError(f"{where} has no <world> in <sdf>; give an SDF world file")
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
    """Merge similar warnings, such as those of a missing mesh that many links use.

    If more than MOST_SIMILAR_WARNINGS warnings differ only in the part of the model that they name,
    only the first is returned, with the number of the others.
    """
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
        world: the result of `load_world`.
        warn: function that is called with one sentence for each model that cannot be simulated;
            such models are not spawned. May be None.

    Raises:
        SimError: a model cannot be simulated, and `warn` is None.
    """
    for model in world.models:
        try:
            spawn(model, model.name, Pose.from_rpy(*model.initial_pose),
                  joint_positions=model.initial_joints)
        except SimError as error:
            if warn is None:
                raise SimError(f"model '{model.name}' of the world file: {error}") from None
            warn(f"model '{model.name}' is ignored: {error}")
