"""What is around the arm, and a link of it as the target."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from aras_sim_bridge.description import Light, RobotDescription, world_file
from aras_sim_bridge.description.lights import SUN
from aras_sim_bridge.description.shapes import triangles
from aras_sim_bridge.description.types import Link, within
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base.names import nearest
from aras_visual_servo_base.poses import to_xyz_rpy

from ..errors import ExperimentError, require
from ..targets.solids import made_solid
from .experiment import Experiment, SunSpec
from .packages import PackagePath

BEGINNING = 1e-3  # s: the first step of the physics
WORLDS = "package://aras_visual_servo_gazebo/world/{}.world"


def around(experiment: Experiment, packages: PackagePath, exactly: bool = False) -> WorldFile:
    """A world file's content, or the sun over Gazebo's ground.

    exactly: lights that come and go stay as they are at the beginning.

    Raises:
        ExperimentError: for a bad file.
    """
    try:
        found = WorldFile(lights=(_sun(experiment.sun),))
        if experiment.world:
            found = world_file.read(_path(experiment, packages), packages.find)
    except SimError as error:
        raise ExperimentError(str(error)) from error
    if not exactly:
        return found
    return replace(found, lights=tuple(
        replace(light, shines=None if within(light.shines, BEGINNING) else ())
        for light in found.lights
    ))  # fmt: skip


def with_link(experiment: Experiment, packages: PackagePath) -> Experiment:
    """The same with the mesh and the pose of the link that its target is; itself where it is none.

    Raises:
        ExperimentError: there is no such model or link, or it is no closed solid.
    """
    target = experiment.target
    if not target.model:
        return experiment
    models = {model.name: model for model in around(experiment, packages).models}
    require(target.model in models, f"target.model: no model '{target.model}' stands in world "
            f"'{experiment.world}': {nearest(target.model, models)}")  # fmt: skip
    model = models[target.model]
    link = _link(model, target.link)
    shape, pose = _link_target(_path(experiment, packages), packages, model.name, link)
    return replace(experiment, target=replace(target, shape=shape, pose=pose, link=link))


def _path(experiment: Experiment, packages: PackagePath) -> str:
    named = experiment.world
    if "/" not in named and not named.endswith(".world"):
        named = WORLDS.format(named)
    return str(packages.file(named))


def _link(model: RobotDescription, wanted: str) -> str:
    """Name of the link; that of the only one that is seen where none is wanted."""
    seen = [name for name, link in model.links.items() if link.visuals]
    if not wanted:
        require(len(seen) == 1, f"target.link: model '{model.name}' has {len(seen)} links that are "
                f"seen: name one of {', '.join(seen) or 'none'}")  # fmt: skip
        return seen[0]
    require(wanted in seen,
            f"target.link: model '{model.name}' shows no link '{wanted}': {nearest(wanted, seen)}")
    return wanted


@lru_cache(maxsize=32)
def _link_target(
    world: str, packages: PackagePath, model: str, link: str
) -> tuple[str, tuple[float, ...]]:
    """Path of the mesh of a link's visuals, and where it is at first: m, rad."""
    try:
        content = world_file.read(world, packages.find)
        simulation = Simulation(SimulationConfig(ground_plane=content.ground_plane))
        try:
            world_file.populate(simulation.spawn, content)
            placed = simulation.world.models[model]
            pose = placed.link_pose(link).matrix()
            corners = _corners(placed.description.links[link])
        finally:
            simulation.close()
    except SimError as error:
        raise ExperimentError(str(error)) from error
    path = made_solid(corners, f"{model}::{link}").path
    xyz, rpy = to_xyz_rpy(pose)
    return str(path), (*map(float, xyz), *map(float, rpy))


def _corners(link: Link) -> np.ndarray:
    """Triangles (n, 3, 3) of a link's visuals, in its frame, m."""
    parts = [
        part.transformed(visual.pose.matrix())
        for visual in link.visuals for part in triangles(visual.geometry)
    ]  # fmt: skip
    return np.concatenate([part.positions[part.triangles] for part in parts])


def _sun(spec: SunSpec) -> Light:
    """The world's sun, of that direction and strength."""
    strength = (spec.diffuse,) * 3
    return replace(SUN, direction=spec.direction, diffuse=(*strength, 1.0), shines=spec.shines)
