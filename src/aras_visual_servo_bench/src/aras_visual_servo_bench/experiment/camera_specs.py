"""Settings of an experiment's cameras: the true camera, and the controller's calibration of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.errors import SimError
from aras_visual_servo_base.poses import LENGTH_UNITS, inverse, matrix_from_xyz_rpy, optical_pose
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import InvalidIntrinsicsError

from ..errors import ExperimentError, catch_setting_errors, require
from ..targets.target_spec import PoseValues, TargetSpec
from .packages import PackagePath

if TYPE_CHECKING:
    from aras_visual_servo_base.hand_eye_files import HandEyeCalibration

# Limit of angles in settings: half a turn, rad, rounded up, because a file may contain 3.142
# instead of pi.
HALF_TURN = 3.142
MAX_DELAY = 10.0  # s
DEFAULT_PRESET = "original"
WORLD = "world"  # value of HandEyeSpec.link for a camera that is fixed in the world


@dataclass(frozen=True)
class HandEyeSpec:
    """File with the result of a hand-eye calibration; see aras_visual_servo_base.hand_eye_files.

    file: path of the file.
    units: unit of the lengths in the file: m, cm or mm; '': the unit that the file states, or m if
        it states none.
    link: link that carries the camera; '': the link that the file names; 'world': the camera is
        fixed, and the file gives its pose in the world (the arm's base).
    """

    file: str = parameter(shorthand=True)
    units: str = parameter("", choices=("", *LENGTH_UNITS))
    link: str = ""

    def __post_init__(self) -> None:
        check(self, ExperimentError, "hand_eye")

    def read(self, packages: PackagePath) -> HandEyeCalibration:
        """Read the calibration from the file.

        Raises:
            HandEyeFileError: the file does not contain a calibration.
            ExperimentError: there is no such file.
        """
        from aras_visual_servo_base.hand_eye_files import read_hand_eye

        return read_hand_eye(packages.resolve(self.file), self.units)

    def read_optical(self, packages: PackagePath, where: str) -> HandEyeCalibration:
        """Read a calibration that gives the pose of an optical frame.

        where: dotted key of this setting, for error messages.

        Raises:
            ExperimentError: the file does not contain a calibration of an optical frame.
        """
        from aras_visual_servo_base.urdf_changes import check_optical

        with catch_setting_errors(SimError, where):
            calibration = self.read(packages)
            check_optical(calibration)
        return calibration

    def read_mounting(
        self, urdf: str, packages: PackagePath, where: str
    ) -> tuple[str, np.ndarray]:
        """Read the link that carries the camera, and the pose (4, 4) of the optical frame in it.

        Args:
            urdf: text of the robot description.
            packages: search path for files.
            where: dotted key of this setting, for error messages.

        Raises:
            ExperimentError: the file does not contain a calibration of an optical frame, or the
                robot has no such link.
        """
        from aras_visual_servo_base.urdf_changes import find_camera_link

        calibration = self.read_optical(packages, where)
        with catch_setting_errors(SimError, where):
            link = find_camera_link(urdf, calibration, self.link)
        return link, calibration.link_T_camera


@dataclass(frozen=True)
class CalibrationOffset:
    """Difference between the camera that the controller assumes and the true camera.

    focal: assumed focal length divided by the true one.
    centre: offset of the assumed principal point from the true one, px (right, down).
    distortion: distortion coefficients that the controller uses; None: the true coefficients.
    xyz, rpy: offset of the assumed camera pose from the true one, m and rad, in the true optical
        frame (z forward, x right, y down).
    hand_eye: file of a hand-eye calibration that gives the assumed camera pose, instead of xyz and
        rpy.
    depth: depth of the target that the controller assumes, divided by the true depth.
    """

    focal: float = parameter(1.0, ", the ratio of the calibrated to the true focal "
                                  "length", above=0.0, most=10.0)
    centre: tuple[float, float] = parameter((0.0, 0.0), "px")
    distortion: tuple[float, ...] | None = None
    xyz: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "m")
    rpy: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "rad", least=-HALF_TURN, most=HALF_TURN
    )
    hand_eye: HandEyeSpec | None = None
    depth: float = parameter(1.0, ", the ratio of the assumed to the true "
                                  "depth", above=0.0, most=10.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "calibration_offset")
        require(self.hand_eye is None or not self.is_moved,
                "calibration_offset.hand_eye already gives the camera's pose: leave out "
                "calibration_offset.xyz and rpy, or hand_eye")

    @property
    def is_moved(self) -> bool:
        """True if the assumed camera pose differs from the true one."""
        return any(self.xyz) or any(self.rpy)

    def make_calibrated_camera(self, true_camera: CameraModel) -> CameraModel:
        """Return the intrinsics that the controller uses.

        Raises:
            ExperimentError: the resulting intrinsics are invalid.
        """
        K = np.array(true_camera.K).reshape(3, 3)
        K[[0, 1], [0, 1]] *= self.focal
        K[:2, 2] += self.centre
        D = true_camera.D if self.distortion is None else self.distortion
        with catch_setting_errors(InvalidIntrinsicsError, "calibration_offset"):
            return replace(true_camera, K=tuple(K.ravel().tolist()), D=D)


@dataclass(frozen=True)
class CameraSpec:
    """One of several cameras of an experiment.

    model: the true camera: name of a preset, path of a YAML file or of a calibration, or settings.
    rate: number of images per second; None: the rate that `model` gives.
    xyz, rpy: pose of a camera in the hand relative to the robot's own camera, in camera_link (x
        forward, y left, z up), m and rad.
    pose: pose of the optical frame of a fixed camera in the world (the arm's base): x, y, z (m),
        roll, pitch, yaw (rad).
    frame: optical frame of a camera that the robot description contains.
    hand_eye: file of a hand-eye calibration that gives the pose of the camera, in the hand or in
        the world; see HandEyeSpec.
    delay: time from an exposure until the control loop receives the image, s.
    calibration_offset: errors of the controller's calibration; see CalibrationOffset.
    target: target that this camera observes; by default, the target of the experiment.
    target_frame: link of the arm that carries the target of this camera. The poses of target and
        camera are then in the frame of this link. '': the link in robot.target_frame.
    """

    renamed_keys = {"believed": "calibration_offset"}

    model: str | Mapping[str, Any] = parameter(DEFAULT_PRESET, shorthand=True)
    rate: float | None = parameter(None, "1/s", above=0.0)
    xyz: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "m")
    rpy: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "rad", least=-HALF_TURN, most=HALF_TURN
    )
    pose: PoseValues | None = parameter(None, "m, rad")
    frame: str = ""
    hand_eye: HandEyeSpec | None = None
    delay: float = parameter(0.0, "s", least=0.0, most=MAX_DELAY)
    calibration_offset: CalibrationOffset = CalibrationOffset()
    target: TargetSpec | None = None
    target_frame: str = ""

    def __post_init__(self) -> None:
        check(self, ExperimentError, "cameras")
        placements = (self.pose is not None, any(self.xyz) or any(self.rpy), bool(self.frame),
                      self.hand_eye is not None)  # fmt: skip
        require(
            sum(placements) < 2,
            "the pose of a camera is given more than once: give only one of pose (in the world), "
            "xyz and rpy (in the hand), frame (of the robot's description) and hand_eye",
        )

    @property
    def is_in_description(self) -> bool:
        """True if the robot description gives the pose of the camera."""
        has_pose = self.pose is not None or self.hand_eye is not None
        return not has_pose and not (any(self.xyz) or any(self.rpy))

    def compute_pose(self) -> np.ndarray:
        """Return the pose (4, 4) of the camera's optical frame.

        The reference frame is the world if `pose` is set, else the optical frame of the robot's own
        camera.
        """
        if self.pose is not None:
            return matrix_from_xyz_rpy(self.pose[:3], self.pose[3:])
        link = optical_pose(np.eye(4))
        return inverse(link) @ matrix_from_xyz_rpy(self.xyz, self.rpy) @ link
