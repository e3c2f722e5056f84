"""Surroundings of the arm: world files, the sun, and targets that are links of models."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import replace
from functools import lru_cache

import numpy as np

from aras_sim_bridge.description import Light, RobotDescription, parse_urdf, world_file
from aras_sim_bridge.description.shape_meshes import make_meshes
from aras_sim_bridge.description.types import SUN, Link, is_present
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import xyz_rpy_from_matrix
from aras_visual_servo_base.yaml_files import read_text
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.kinematics import Arm

from ..errors import ExperimentError, catch_setting_errors, require
from .experiment import Experiment, SunSpec
from .packages import PackagePath

log = logging.getLogger(__name__)

# End of the first physics step, s. A goal is taught with the lights that are on at this time.
FIRST_STEP = 1e-3
WORLD_FILE = "package://aras_visual_servo_gazebo/world/{}.world"


def read_surroundings(
    experiment: Experiment, packages: PackagePath, is_teaching: bool = False
) -> WorldFile:
    """Read the world file of an experiment; without one, return the sun over Gazebo's ground plane.

    Args:
        is_teaching: whether the world is for teaching a goal; all lights then retain their initial
            state.

    Raises:
        ExperimentError: the world file is invalid.
    """
    world = WorldFile(lights=(_make_sun(experiment.sun),))
    if experiment.world:
        world = read_world(find_world_path(experiment, packages), packages)
    if not is_teaching:
        return world
    return replace(world, lights=tuple(
        replace(light, lit_intervals=None if is_present(light.lit_intervals, FIRST_STEP) else ())
        for light in world.lights
    ))  # fmt: skip


def read_world(path: str, packages: PackagePath) -> WorldFile:
    """Read a world file; an empty path gives a world with Gazebo's ground plane only.

    Raises:
        ExperimentError: the world file is invalid.
    """
    with catch_setting_errors(SimError):
        world = world_file.load_world(path, packages.find) if path else WorldFile()
    for text in world.warnings:
        _warn(path, text)
    return world


@lru_cache(maxsize=1024)
def _warn(path: str, text: str) -> None:
    """Log a warning about unused content of a world file, only once per process."""
    log.warning("world file %s: %s", path, text)


def with_target_link(experiment: Experiment, packages: PackagePath) -> Experiment:
    """Return an experiment whose target is a link, with the shape and pose of the target added.

    The shape is a mesh of the link's visuals, and the pose is the initial pose of the link.

    Raises:
        ExperimentError: the model or the link does not exist, the visuals of the link are not a
            closed solid, or a joint of the robot moves the link.
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
    """Find a link of a model in a world file.

    Args:
        path: path of the world file.
        packages: search path for ROS packages.
        name: name of the model.
        link_name: name of the link; '': the only link of the model with visuals.

    Returns:
        Path of a mesh of the link's visuals, initial pose of the link (m, rad), link name.

    Raises:
        ExperimentError: the model or the link does not exist, or the visuals of the link are not a
            closed solid.
    """
    models = {model.name: model for model in read_world(path, packages).models}
    require(name in models, f"target.model: there is no model '{name}' in world '{path}': "
            f"{suggest(name, models)}")  # fmt: skip
    link = _find_link_name(models[name], link_name)
    return *_read_world_link(path, packages, name, link), link


def find_world_path(experiment: Experiment, packages: PackagePath) -> str:
    """Return the path of an experiment's world file; '' if it has none."""
    path = experiment.world
    if not path:
        return ""
    if "/" not in path and not path.endswith(".world"):
        path = WORLD_FILE.format(path)
    return str(packages.resolve(path))


def _find_link_name(model: RobotDescription, link_name: str) -> str:
    """Return `link_name`; if it is '', return the name of the model's only link with visuals."""
    visible = [name for name, link in model.links.items() if link.visuals]
    if not link_name:
        require(len(visible) == 1, f"target.link: model '{model.name}' has {len(visible)} links "
                f"with visuals ({', '.join(visible) or 'none'}); name the target's link")
        return visible[0]
    require(
        link_name in visible,
        f"target.link: model '{model.name}' has no link '{link_name}' with visuals: "
        f"{suggest(link_name, visible)}",
    )
    return link_name


@lru_cache(maxsize=32)
def _read_world_link(
    world: str, packages: PackagePath, model: str, link: str
) -> tuple[str, tuple[float, ...]]:
    """Return the path of a mesh of a world link's visuals, and the link's initial pose (m, rad)."""
    with catch_setting_errors(SimError):
        content = world_file.load_world(world, packages.find)
        simulation = Simulation(SimulationConfig(ground_plane=content.ground_plane))
        with contextlib.closing(simulation):
            world_file.populate(simulation.spawn, content)
            spawned = simulation.world.models[model]
            pose = spawned.link_pose(link).matrix()
            corners = _read_triangles(spawned.description.links[link])
    return _write_solid(corners, pose, f"{model}::{link}")


@lru_cache(maxsize=32)
def _read_robot_link(
    urdf: str, packages: PackagePath, link: str
) -> tuple[str, tuple[float, ...]]:
    """Return the path of a mesh of a robot link's visuals, and the link's world pose (m, rad)."""
    with catch_setting_errors((SimError, ConfigurationError), "target.link"):
        robot = parse_urdf(urdf, packages.find)
        link = _find_link_name(robot, link)
        pose = Arm.find_fixed_pose(urdf, link)
    require(pose is not None, f"target.link: a joint of the robot moves '{link}'; for a target "
            "that the arm carries, set target.shape, and robot.target_frame to the link")
    return _write_solid(_read_triangles(robot.links[link]), pose, f"{robot.name}::{link}")


def _write_solid(corners: np.ndarray, pose: np.ndarray, name: str) -> tuple[str, tuple[float, ...]]:
    """Write triangles (n, 3, 3), in m, to a mesh file.

    Returns:
        The path of the file; and `pose` (4, 4) as x, y, z (m), roll, pitch, yaw (rad).
    """
    from ..targets.solids import make_solid

    path = make_solid(corners, name).path
    xyz, rpy = xyz_rpy_from_matrix(pose)
    return str(path), (*map(float, xyz), *map(float, rpy))


def _read_triangles(link: Link) -> np.ndarray:
    """Return the triangles (n, 3, 3) of a link's visuals in the link frame, m."""
    parts = [
        part.transform(visual.pose.matrix())
        for visual in link.visuals for part in make_meshes(visual.geometry)
    ]  # fmt: skip
    return np.concatenate([part.positions[part.triangles] for part in parts])


def _make_sun(spec: SunSpec) -> Light:
    """Make the sun of the world from the settings of an experiment."""
    strength = (spec.diffuse,) * 3
    return replace(
        SUN, direction=spec.direction, diffuse=(*strength, 1.0), lit_intervals=spec.shines
    )
