"""Camera poses from the files of hand-eye calibrations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aras_visual_servo_base.poses import inverse, xyz_rpy_from_matrix

from ..errors import ExperimentError
from .camera_specs import WORLD, CalibrationOffset, CameraSpec
from .experiment import FREE_CAMERA_PLANTS, Experiment
from .packages import PackagePath
from .robots import Robot


def with_fixed_cameras(experiment: Experiment, packages: PackagePath) -> Experiment:
    """Return the experiment with the hand-eye calibrations of fixed cameras replaced by poses.

    Raises:
        ExperimentError: a file cannot be used. Or a calibration is for a camera on an arm, but the
            plant has no arm.
    """
    cameras = dict(experiment.cameras)
    for name, spec in experiment.cameras.items():
        if spec.hand_eye is None:
            continue
        where = f"cameras.{name}.hand_eye"
        if spec.hand_eye.link == WORLD:
            world_T_camera = spec.hand_eye.read_optical(packages, where).link_T_camera
            pose = tuple(np.concatenate(xyz_rpy_from_matrix(world_T_camera)))
            cameras[name] = replace(spec, hand_eye=None, pose=pose)
        elif experiment.plant in FREE_CAMERA_PLANTS:
            raise ExperimentError(
                f"{where} gives the camera's pose on an arm, but plant '{experiment.plant}' has no "
                "arm: use plant chain or bullet; if the camera is fixed, set the link of hand_eye "
                f"to {WORLD}"
            )
    return replace(experiment, cameras=cameras) if cameras else experiment


def with_calibration_offsets(experiment: Experiment, robot: Robot) -> Experiment:
    """Return the experiment with each `calibration_offset.hand_eye` replaced by `xyz` and `rpy`.

    `hand_eye` names a file with the calibrated pose of a camera; `xyz` and `rpy` are the offset of
    this pose from the camera's true pose.

    Raises:
        ExperimentError: a file cannot be used, or its link does not carry the camera.
    """
    offsets = {
        name: _read_calibration_offset(name, spec, experiment, robot)
        for name, spec in experiment.camera_specs.items()
    }
    if not experiment.cameras:
        (offset,) = offsets.values()
        return replace(experiment, calibration_offset=offset)
    return replace(experiment, cameras={
        name: replace(spec, calibration_offset=offsets[name])
        for name, spec in experiment.cameras.items()
    })  # fmt: skip


def _read_calibration_offset(
    name: str, spec: CameraSpec, experiment: Experiment, robot: Robot
) -> CalibrationOffset:
    """Return the calibration offset of camera `name`, with `hand_eye` replaced by `xyz` and `rpy`.
    """
    offset = spec.calibration_offset
    file = offset.hand_eye
    if file is None:
        return offset
    where = "calibration_offset.hand_eye"
    if experiment.cameras:
        where = f"cameras.{name}.{where}"
    if spec.pose is not None and file.link in ("", WORLD):
        true_pose = spec.compute_pose()
        calibrated_pose = file.read_optical(robot.packages, where).link_T_camera
    elif experiment.plant in FREE_CAMERA_PLANTS:
        raise ExperimentError(
            f"{where} gives the camera's pose on an arm, but plant '{experiment.plant}' has no "
            "arm: set calibration_offset.xyz and rpy (relative to the true camera) instead"
        )
    else:
        link, calibrated_pose = file.read_mounting(robot.urdf, robot.packages, where)
        true_pose = robot.compute_mounting(link, name)
    xyz, rpy = xyz_rpy_from_matrix(inverse(true_pose) @ calibrated_pose)
    return replace(offset, hand_eye=None, xyz=tuple(map(float, xyz)), rpy=tuple(map(float, rpy)))
