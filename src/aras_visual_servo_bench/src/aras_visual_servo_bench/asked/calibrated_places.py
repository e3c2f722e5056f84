"""Places of cameras that hand-eye calibrations give, as poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aras_visual_servo_base.camera_mounting import carrying_link, check_optical
from aras_visual_servo_base.errors import SimError
from aras_visual_servo_base.poses import inverse, to_xyz_rpy

from ..errors import ExperimentError
from .cameras import WORLD, Belief, CameraSpec, HandEyeSpec
from .experiment import FLYING, Experiment
from .packages import PackagePath
from .robots import Robot


def with_fixed_cameras(experiment: Experiment, packages: PackagePath) -> Experiment:
    """The experiment with a pose for each fixed camera that a hand-eye calibration places.

    Raises:
        ExperimentError: a file that cannot be used, or a camera in a hand that the plant has not.
    """
    cameras = dict(experiment.cameras)
    for name, spec in experiment.cameras.items():
        if spec.hand_eye is None:
            continue
        if spec.hand_eye.link == WORLD:
            pose = tuple(np.concatenate(to_xyz_rpy(_read(
                spec.hand_eye, packages, f"cameras.{name}.hand_eye"))))
            cameras[name] = replace(spec, hand_eye=None, pose=pose)
        elif experiment.plant in FLYING:
            raise ExperimentError(
                f"cameras.{name}.hand_eye says where an arm carries the camera, and plant "
                f"'{experiment.plant}' has no arm: use chain or bullet, or set its link to {WORLD} "
                "if the camera is fixed")
    return replace(experiment, cameras=cameras) if cameras else experiment


def with_believed_places(experiment: Experiment, robot: Robot) -> Experiment:
    """The experiment with how far each camera is believed from its true place, where a hand-eye
    calibration says where it is believed.

    Raises:
        ExperimentError: a file that cannot be used, or a link that does not carry the camera.
    """
    if experiment.cameras:
        return replace(experiment, cameras={
            name: replace(spec, believed=_believed(
                spec.believed, spec, experiment, robot, f"cameras.{name}.believed.hand_eye", name))
            for name, spec in experiment.cameras.items()})
    ((name, spec),) = experiment.seen_by.items()
    return replace(experiment, believed=_believed(
        spec.believed, spec, experiment, robot, "believed.hand_eye", name))


def _believed(belief: Belief, spec: CameraSpec, experiment: Experiment, robot: Robot, where: str,
              name: str) -> Belief:
    file = belief.hand_eye
    if file is None:
        return belief
    if spec.pose is not None and file.link in ("", WORLD):
        true, there = spec.place(), _read(file, robot.packages, where)
    elif experiment.plant in FLYING:
        raise ExperimentError(f"{where} says where an arm carries the camera, and plant "
                              f"'{experiment.plant}' has no arm: give believed.xyz and rpy, off "
                              "the camera's true place")
    else:
        try:
            found = file.read(robot.packages)
            check_optical(found)
            link = carrying_link(robot.urdf, found, file.link)
            true, there = robot.mounting(link, name), found.link_T_camera
        except SimError as error:
            raise ExperimentError(f"{where}: {error}") from None
    xyz, rpy = to_xyz_rpy(inverse(true) @ there)
    return replace(belief, hand_eye=None, xyz=tuple(map(float, xyz)), rpy=tuple(map(float, rpy)))


def _read(spec: HandEyeSpec, packages: PackagePath, where: str) -> np.ndarray:
    """(4, 4) of the camera's optical frame in the world."""
    try:
        found = spec.read(packages)
        check_optical(found)
    except SimError as error:
        raise ExperimentError(f"{where}: {error}") from None
    return found.link_T_camera
