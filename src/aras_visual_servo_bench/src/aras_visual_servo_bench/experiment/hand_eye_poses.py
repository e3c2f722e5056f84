"""Camera poses from the files of hand-eye calibrations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aras_visual_servo_base.errors import SimError
from aras_visual_servo_base.poses import inverse, xyz_rpy_from_matrix
from aras_visual_servo_base.urdf_changes import check_optical, find_camera_link

from ..errors import ExperimentError
from .cameras import WORLD, CalibrationOffset, CameraSpec, HandEyeSpec
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
        if spec.hand_eye.link == WORLD:
            pose = tuple(np.concatenate(xyz_rpy_from_matrix(_read_pose(
                spec.hand_eye, packages, f"cameras.{name}.hand_eye"))))
            cameras[name] = replace(spec, hand_eye=None, pose=pose)
        elif experiment.plant in FREE_CAMERA_PLANTS:
            raise ExperimentError(
                f"cameras.{name}.hand_eye gives the camera's pose on an arm, but plant "
                f"'{experiment.plant}' has no arm: use plant chain or bullet; if the camera is "
                f"fixed, set the link of hand_eye to {WORLD}")
    return replace(experiment, cameras=cameras) if cameras else experiment


def with_calibration_offsets(experiment: Experiment, robot: Robot) -> Experiment:
    """Return the experiment with each `calibration_offset.hand_eye` replaced by `xyz` and `rpy`.

    `hand_eye` names a file with the calibrated pose of a camera; `xyz` and `rpy` are the offset of
    this pose from the camera's true pose.

    Raises:
        ExperimentError: a file cannot be used, or its link does not carry the camera.
    """
    if experiment.cameras:
        return replace(
            experiment,
            cameras={
                name: replace(
                    spec,
                    calibration_offset=_read_calibration_offset(
                        spec.calibration_offset,
                        spec,
                        experiment,
                        robot,
                        f"cameras.{name}.calibration_offset.hand_eye",
                        name,
                    ),
                )
                for name, spec in experiment.cameras.items()
            },
        )
    ((name, spec),) = experiment.camera_specs.items()
    return replace(experiment, calibration_offset=_read_calibration_offset(
        spec.calibration_offset, spec, experiment, robot, "calibration_offset.hand_eye", name))


def _read_calibration_offset(
    offset: CalibrationOffset,
    spec: CameraSpec,
    experiment: Experiment,
    robot: Robot,
    where: str,
    name: str,
) -> CalibrationOffset:
    """Return the calibration offset of camera `name`, with `hand_eye` replaced by `xyz` and `rpy`.

    where: dotted key of the setting that names the hand-eye file, for error messages.
    """
    file = offset.hand_eye
    if file is None:
        return offset
    if spec.pose is not None and file.link in ("", WORLD):
        true_pose, calibrated_pose = spec.compute_pose(), _read_pose(file, robot.packages, where)
    elif experiment.plant in FREE_CAMERA_PLANTS:
        raise ExperimentError(
            f"{where} gives the camera's pose on an arm, but plant '{experiment.plant}' has no "
            "arm: set calibration_offset.xyz and rpy (relative to the true camera) instead"
        )
    else:
        try:
            calibration = file.read(robot.packages)
            check_optical(calibration)
            link = find_camera_link(robot.urdf, calibration, file.link)
            true_pose = robot.compute_mounting(link, name)
            calibrated_pose = calibration.link_T_camera
        except SimError as error:
            raise ExperimentError(f"{where}: {error}") from None
    xyz, rpy = xyz_rpy_from_matrix(inverse(true_pose) @ calibrated_pose)
    return replace(offset, hand_eye=None, xyz=tuple(map(float, xyz)), rpy=tuple(map(float, rpy)))


def _read_pose(spec: HandEyeSpec, packages: PackagePath, where: str) -> np.ndarray:
    """Read world_T_camera (4, 4) of a fixed camera from its hand-eye calibration."""
    try:
        calibration = spec.read(packages)
        check_optical(calibration)
    except SimError as error:
        raise ExperimentError(f"{where}: {error}") from None
    return calibration.link_T_camera
