"""What is around the arm, and a link of it as the target."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import lru_cache

import numpy as np

from aras_sim_bridge.description import Light, RobotDescription, parse_urdf, world_file
from aras_sim_bridge.description.shapes import make_meshes
from aras_sim_bridge.description.types import SUN, Link, is_present
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import xyz_rpy_from_matrix
from aras_visual_servo_base.yaml_files import read_text
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.kinematics import Arm

from ..errors import ExperimentError, require
from .experiment import Experiment, SunSpec
from .packages import PackagePath

log = logging.getLogger(__name__)

FIRST_STEP = 1e-3  # s: the first step of the physics
WORLD_FILE = "package://aras_visual_servo_gazebo/world/{}.world"


def read_surroundings(
    experiment: Experiment, packages: PackagePath, is_teaching: bool = False
) -> WorldFile:
    """A world file's content, or the sun over Gazebo's ground.

    exactly: lights that come and go stay as they are at the beginning.

    Raises:
        ExperimentError: for a bad file.
    """
    found = WorldFile(lights=(_make_sun(experiment.sun),))
    if experiment.world:
        found = read_world(find_world_path(experiment, packages), packages)
    if not is_teaching:
        return found
    return replace(found, lights=tuple(
        replace(light, lit_intervals=None if is_present(light.lit_intervals, FIRST_STEP) else ())
        for light in found.lights
    ))  # fmt: skip


def read_world(path: str, packages: PackagePath) -> WorldFile:
    """The content of a world file; '': Gazebo's ground plane.

    Raises:
        ExperimentError: for a bad file.
    """
    try:
        found = world_file.load_world(path, packages.find) if path else WorldFile()
    except SimError as error:
        raise ExperimentError(str(error)) from error
    for text in found.warnings:
        _warn(path, text)
    return found


@lru_cache(maxsize=1024)
def _warn(path: str, text: str) -> None:
    """Log once in a process what a world file holds in vain."""
    log.warning("world file %s: %s", path, text)


def with_target_link(experiment: Experiment, packages: PackagePath) -> Experiment:
    """The same with the mesh and the pose of the link that its target is.

    Raises:
        ExperimentError: there is no such model or link, it is no closed solid, or it is a link of
            the robot's that moves.
    """
    target = experiment.target
    if not target.model:
        urdf = read_text(packages.resolve(experiment.robot.urdf), ExperimentError)
        shape, pose = _read_robot_link(urdf, packages, target.link)
        return replace(experiment, target=replace(target, shape=shape, pose=pose))
    path = find_world_path(experiment, packages)
    shape, pose, link = find_world_link(path, packages, target.model, target.link)
    return replace(experiment, target=replace(target, shape=shape, pose=pose, link=link))


def find_world_link(
    path: str, packages: PackagePath, name: str, link_name: str
) -> tuple[str, tuple[float, ...], str]:
    """Path of the mesh of a link's visuals, where it is at first (m, rad), and its name.

    Args:
        path: of the world file. name: of the model. wanted: its link; '': the only one that is
            seen.

    Raises:
        ExperimentError: there is no such model or link, or it is no closed solid.
    """
    models = {model.name: model for model in read_world(path, packages).models}
    require(name in models, f"target.model: no model '{name}' stands in world '{path}': "
            f"{suggest(name, models)}")  # fmt: skip
    link = _find_link_name(models[name], link_name)
    return *_read_world_link(path, packages, name, link), link


def find_world_path(experiment: Experiment, packages: PackagePath) -> str:
    """The path of an experiment's world file; '': it names none."""
    named = experiment.world
    if not named:
        return ""
    if "/" not in named and not named.endswith(".world"):
        named = WORLD_FILE.format(named)
    return str(packages.resolve(named))


def _find_link_name(model: RobotDescription, link_name: str) -> str:
    """Name of the link; that of the only one that is seen where none is wanted."""
    seen = [name for name, link in model.links.items() if link.visuals]
    if not link_name:
        require(len(seen) == 1, f"target.link: model '{model.name}' has {len(seen)} links that are "
                f"seen: name one of {', '.join(seen) or 'none'}")  # fmt: skip
        return seen[0]
    require(
        link_name in seen,
        f"target.link: model '{model.name}' shows no link '{link_name}': "
        f"{suggest(link_name, seen)}",
    )
    return link_name


@lru_cache(maxsize=32)
def _read_world_link(
    world: str, packages: PackagePath, model: str, link: str
) -> tuple[str, tuple[float, ...]]:
    """Path of the mesh of a link's visuals, and where it is at first: m, rad."""
    try:
        content = world_file.load_world(world, packages.find)
        simulation = Simulation(SimulationConfig(ground_plane=content.ground_plane))
        try:
            world_file.populate(simulation.spawn, content)
            placed = simulation.world.models[model]
            pose = placed.link_pose(link).matrix()
            corners = _read_triangles(placed.description.links[link])
        finally:
            simulation.close()
    except SimError as error:
        raise ExperimentError(str(error)) from error
    return _write_solid(corners, pose, f"{model}::{link}")


@lru_cache(maxsize=32)
def _read_robot_link(
    urdf: str, packages: PackagePath, link: str
) -> tuple[str, tuple[float, ...]]:
    """The same of a link of the robot's, which stands at the world's origin."""
    try:
        robot = parse_urdf(urdf, packages.find)
        link = _find_link_name(robot, link)
        pose = Arm.find_fixed_pose(urdf, link)
    except (SimError, ConfigurationError) as error:
        raise ExperimentError(f"target.link: {error}") from error
    require(pose is not None, f"target.link: a joint of the robot moves '{link}': where the arm "
            "carries the target, give its shape, and the link as robot.target_frame")
    return _write_solid(_read_triangles(robot.links[link]), pose, f"{robot.name}::{link}")


def _write_solid(corners: np.ndarray, pose: np.ndarray, name: str) -> tuple[str, tuple[float, ...]]:
    """Path of a mesh of triangles (n, 3, 3), m, and its pose (4, 4) as m and rad."""
    from ..targets.solids import make_solid

    path = make_solid(corners, name).path
    xyz, rpy = xyz_rpy_from_matrix(pose)
    return str(path), (*map(float, xyz), *map(float, rpy))


def _read_triangles(link: Link) -> np.ndarray:
    """Triangles (n, 3, 3) of a link's visuals, in its frame, m."""
    parts = [
        part.transform(visual.pose.matrix())
        for visual in link.visuals for part in make_meshes(visual.geometry)
    ]  # fmt: skip
    return np.concatenate([part.positions[part.triangles] for part in parts])


def _make_sun(spec: SunSpec) -> Light:
    """The world's sun, of that direction and strength."""
    strength = (spec.diffuse,) * 3
    return replace(
        SUN, direction=spec.direction, diffuse=(*strength, 1.0), lit_intervals=spec.shines
    )
