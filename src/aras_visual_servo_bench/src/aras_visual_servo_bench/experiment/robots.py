"""Robot of an experiment: its description, the settings of its controllers, and its frames."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_sim_bridge.camera.from_description import read_settings as sensor_settings
from aras_sim_bridge.errors import CameraError, DescriptionError, SimError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import (
    inverse,
    matrix_from_xyz_rpy,
    optical_pose,
    xyz_rpy_from_matrix,
)
from aras_visual_servo_base.urdf import parse_tree
from aras_visual_servo_base.yaml_files import read_text, read_yaml
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.camera_rig import (
    CameraKinematics,
    FixedCameraKinematics,
    make_camera_kinematics,
)

from ..errors import ExperimentError, catch_setting_errors
from .added_links import MountedTarget, find_joint_path, with_frame, with_link, with_target
from .camera_specs import CameraSpec, HandEyeSpec
from .packages import PackagePath
from .robot_spec import RobotSpec

if TYPE_CHECKING:
    from aras_sim_bridge.description import CameraDescription, RobotDescription

ROBOT = "robot"  # name of the robot's model in the simulated world
# Prefix of the name of an optical frame that is added for a camera without a frame in the robot
# description.
CAMERA_FRAME_PREFIX = "camera_frame_of_"
# Prefix of the name of the optical frame of the robot's camera after camera_xyz and camera_rpy
# displaced it.
MOVED_FRAME_PREFIX = "moved_"
# prefix of the name of an optical frame at the calibrated pose of a camera
CALIBRATED_FRAME_PREFIX = "believed_"
# link of the robot's own camera, which camera_xyz and camera_rpy displace
CAMERA_LINK = "camera_link"
# Prefix of the name of the link for the target of a single camera.
TARGET_LINK_PREFIX = "target_of_"
NO_CAMERAS: Mapping[str, CameraSpec] = {}
# Settings of a camera in a robot description that affect its images. Settings of its pose and of
# its topics are not included.
IMAGING_SETTINGS = frozenset((
    "width", "height", "horizontal_fov", "update_rate", "format", "near", "far", "lens",
    "camera_matrix", "cutoff_angle", "distortion_model", "distortion_coefficients", "effects",
))  # fmt: skip
NO_TARGETS: Mapping[str, MountedTarget] = {}


class Robot:
    """Robot of an experiment, after its files have been read.

    Attributes:
        spec: settings of the robot.
        packages: search path for ROS packages.
        urdf: text of the robot description, with added cameras and targets.
        parameters: parameters of the robot's controllers, by the controller's name.
    """

    def __init__(
        self,
        spec: RobotSpec,
        xyz: Sequence[float] = (0.0,) * 3,
        rpy: Sequence[float] = (0.0,) * 3,
        friction: bool = True,
        cameras: Mapping[str, CameraSpec] = NO_CAMERAS,
        mounted_targets: Mapping[str, MountedTarget] = NO_TARGETS,
        hand_eye: HandEyeSpec | None = None,
    ) -> None:
        """Read the files of the robot.

        Args:
            spec: settings of the robot.
            xyz, rpy: displacement of the camera in its link, m and rad.
            friction: whether the joints have dry friction.
            cameras: the cameras by name; a camera that the description lacks is added to it.
            mounted_targets: targets to add to links of the robot, by the name of the new link.
            hand_eye: calibration that gives the pose of the robot's camera; None: the pose in the
                description is used.

        Raises:
            ExperimentError: a file is missing or cannot be used.
        """
        self.spec, self._cameras = spec, cameras
        self.packages = PackagePath(spec.search)
        urdf = read_text(self.packages.resolve(spec.urdf), ExperimentError)
        if not friction:
            from aras_visual_servo_base.urdf_changes import remove_friction

            urdf = remove_friction(urdf)
        if hand_eye is not None:
            from aras_visual_servo_base.urdf_changes import mount_camera

            with catch_setting_errors(SimError, "hand_eye"):
                calibration = hand_eye.read(self.packages)
                urdf = mount_camera(urdf, calibration, hand_eye.link, spec.camera_frame)
        self._own_frame = spec.camera_frame
        urdf = self._move_camera(urdf, matrix_from_xyz_rpy(xyz, rpy))
        urdf = self._add_camera_frames(urdf)
        for name, target in mounted_targets.items():
            urdf = with_target(urdf, name, target, spec.urdf)
        self.urdf = urdf
        tree = read_yaml(self.packages.resolve(spec.config), ExperimentError)
        if not isinstance(tree, Mapping):
            raise ExperimentError(
                f"{spec.config} has no controllers: set robot.config to the YAML file of this "
                "robot's controllers"
            )
        for part in filter(None, spec.namespace.split("/")):
            tree = tree.get(part, tree)
        self.parameters: dict[str, Any] = dict(tree)

    def parse_description(self) -> RobotDescription:
        """Return the robot description in the form that the simulator uses.

        Raises:
            ExperimentError: the description is invalid.
        """
        with catch_setting_errors(DescriptionError, self.spec.urdf):
            return parse_robot_description(self.urdf, self.spec.search)

    def read_camera_settings(self) -> dict[str, Any]:
        """Return the settings that affect images of the robot's camera; {} if it has no camera.

        Raises:
            ExperimentError: the description has invalid settings of the camera.
        """
        with catch_setting_errors((DescriptionError, CameraError), self.spec.urdf):
            found = [camera for camera in parse_camera_descriptions(self.urdf)
                     if self.spec.camera in ("", find_camera_name(camera))]
            settings = sensor_settings(found[0]) if found else {}
        return {key: value for key, value in settings.items() if key in IMAGING_SETTINGS}

    def find_optical_frame(self, camera: str) -> str:
        """Return the name of a camera's optical frame in the description."""
        spec = self._cameras.get(camera)
        if spec is None or spec.is_in_description:
            return self._own_frame if spec is None or not spec.frame else spec.frame
        return f"{CAMERA_FRAME_PREFIX}{camera}"

    def has_camera_on(self, link: str) -> bool:
        """Return True if the optical frame of the robot's camera is `link` or is fixed to it."""
        for joint in reversed(find_joint_path(self.urdf, self._own_frame, self.spec.urdf)):
            if joint.child == link or joint.kind == "fixed" and joint.parent == link:
                return True
            if joint.kind != "fixed":
                break
        return False

    def find_target_frame(self, camera: str) -> str:
        """Return the link that carries the target of a camera; '' if the target is in the world."""
        return self.spec.find_carrier(self._cameras.get(camera))

    def find_fixed_pose(self, camera: str) -> np.ndarray | None:
        """Return the pose (4, 4) of a camera in the world if this pose is fixed.

        Return None if a joint moves the camera or the target of the camera.
        """
        if self.find_target_frame(camera):
            return None
        return Arm.find_fixed_pose(self.urdf, self.find_optical_frame(camera))

    def compute_mounting(self, link: str, camera: str = "") -> np.ndarray:
        """Return link_T_camera (4, 4), the pose of a camera's optical frame in the frame of a link.

        Raises:
            ExperimentError: the link does not carry the camera, or a joint between link and camera
                is movable.
        """
        pose = None
        for joint in find_joint_path(self.urdf, self.find_optical_frame(camera), self.spec.urdf):
            if joint.parent == link:
                pose = np.eye(4)
            if pose is None:
                continue
            if joint.kind != "fixed":
                raise ExperimentError(f"joint '{joint.name}' moves the camera relative to link "
                                      f"'{link}', so a calibration cannot give its pose on this "
                                      "link: set hand_eye.link to a link that carries the camera "
                                      "rigidly")
            pose = pose @ joint.pose.matrix()
        if pose is None:
            raise ExperimentError(f"link '{link}' does not carry the camera: set hand_eye.link to "
                                  "the link that carries it")
        return pose

    def make_arm(self, camera: str = "") -> Arm:
        """Return the true kinematics of the arm up to a camera; '' is the robot's own camera."""
        return self._read_arm(self.urdf, camera)

    def make_camera_kinematics(
        self, camera: str, control: Arm, is_calibrated: bool = False
    ) -> CameraKinematics:
        """Return the kinematics of a camera that is not the control camera.

        Args:
            control: kinematics of the control camera.
            is_calibrated: True returns the kinematics that the controller uses, with the
                calibration offset; False returns the true kinematics.

        Raises:
            ConfigurationError: different joints move the two cameras, so one scheme cannot use
                both.
        """
        offset, pose = self._cameras[camera].calibration_offset, self.find_fixed_pose(camera)
        if pose is not None:
            true_T_calibrated = matrix_from_xyz_rpy(offset.xyz, offset.rpy)
            return FixedCameraKinematics(pose @ true_T_calibrated if is_calibrated else pose)
        urdf, frame = self.urdf, self.find_optical_frame(camera)
        if is_calibrated:
            urdf, frame = self._add_calibrated_frame(offset.xyz, offset.rpy, camera)
        return make_camera_kinematics(urdf, control, self._read_arm(urdf, camera, frame), camera)

    def make_calibrated_arm(
        self, xyz: Sequence[float], rpy: Sequence[float], camera: str = ""
    ) -> Arm:
        """Return the kinematics of the arm from the base to the calibrated pose of a camera.

        Args:
            xyz, rpy: offset of the calibrated camera pose in the true optical frame (z forward,
                x right, y down), m and rad.
            camera: name of the camera; '' for the robot's own camera.
        """
        urdf, frame = self._add_calibrated_frame(xyz, rpy, camera)
        return self._read_arm(urdf, camera, frame)

    def _add_calibrated_frame(
        self, xyz: Sequence[float], rpy: Sequence[float], camera: str
    ) -> tuple[str, str]:
        """Return a description with a frame at a camera's calibrated pose, and the frame's name."""
        frame = self.find_optical_frame(camera)
        if not (any(xyz) or any(rpy)):
            return self.urdf, frame
        calibrated = f"{CALIBRATED_FRAME_PREFIX}{frame}"
        urdf = self._with_frame(self.urdf, calibrated, frame, matrix_from_xyz_rpy(xyz, rpy))
        return urdf, calibrated

    def _add_camera_frames(self, urdf: str) -> str:
        """Return a copy of a description, with the missing optical frames of cameras added."""
        for name, camera in self._cameras.items():
            frame = f"{CAMERA_FRAME_PREFIX}{name}"
            if camera.pose is not None:
                urdf = with_link(urdf, frame, parse_tree(urdf).root, camera.compute_pose())
            elif camera.hand_eye is not None:
                where = f"cameras.{name}.hand_eye"
                link, pose = camera.hand_eye.read_mounting(urdf, self.packages, where)
                urdf = with_link(urdf, frame, link, pose)
            elif not camera.is_in_description:
                urdf = self._with_frame(urdf, frame, self._own_frame, camera.compute_pose())
        return urdf

    def find_controllers(self, joints: Sequence[str]) -> tuple[dict[str, str], str]:
        """Find the controller of each joint.

        Returns:
            The names of the controllers by joint, and the kind of command that they receive.

        Raises:
            ExperimentError: a joint has no controller, or the controllers are of different kinds.
        """
        from aras_visual_servo_controller.kinematics.ros_control_controllers import (
            find_joint_controllers,
        )

        names = self.spec.controllers or tuple(self.parameters)
        known = {
            controller.name: controller
            for controller in find_joint_controllers(self.parameters) if not controller.is_group
        }  # fmt: skip
        found: dict[str, str] = {}
        kinds = set()
        for name in names:
            if name not in self.parameters:
                raise ExperimentError(
                    f"robot.controllers names '{name}', which is not in {self.spec.config}: "
                    + suggest(name, self.parameters)
                )
            controller = known.get(name)
            if controller is not None and controller.joints[0] in joints:
                found.setdefault(controller.joints[0], name)
                kinds.add(controller.kind)
        missing = [joint for joint in joints if joint not in found]
        if missing:
            raise ExperimentError(
                f"{self.spec.config} has no single-joint controller for {', '.join(missing)}, of a "
                "type that ends in /JointPositionController, /JointVelocityController or "
                "/JointEffortController: set robot.config to the YAML file of this robot's "
                "controllers, or use plant chain"
            )
        if len(kinds) > 1:
            raise ExperimentError(
                f"{self.spec.config} has controllers of several kinds ({', '.join(sorted(kinds))}):"
                " list controllers of one kind in robot.controllers"
            )
        return {joint: found[joint] for joint in joints}, kinds.pop()

    def _read_arm(self, urdf: str, camera: str, frame: str = "") -> Arm:
        frame = frame or self.find_optical_frame(camera)
        with catch_setting_errors(ConfigurationError, self.spec.urdf):
            return read_arm(urdf, frame, self.find_target_frame(camera))

    def _with_frame(self, urdf: str, name: str, frame: str, frame_T_child: np.ndarray) -> str:
        return with_frame(urdf, name, frame, frame_T_child, self.spec.urdf)

    def _move_camera(self, urdf: str, link_T_link: np.ndarray) -> str:
        """Return a description with the robot's camera displaced in its link.

        If camera_link carries the optical frame, camera_link is displaced, as in the launch files;
        otherwise a new optical frame is added.
        """
        if np.array_equal(link_T_link, np.eye(4)):
            return urdf
        path = find_joint_path(urdf, self._own_frame, self.spec.urdf)
        if not any(joint.child == CAMERA_LINK for joint in path):
            # pose of a camera's link (x forward, y left, z up) in its optical frame
            link = optical_pose(np.eye(4))
            frame, self._own_frame = self._own_frame, f"{MOVED_FRAME_PREFIX}{self._own_frame}"
            moved = inverse(link) @ link_T_link @ link
            return self._with_frame(urdf, self._own_frame, frame, moved)
        from aras_visual_servo_base.urdf_changes import move_camera

        texts = (" ".join(map(repr, numbers)) for numbers in xyz_rpy_from_matrix(link_T_link))
        where = f"{self.spec.urdf}: camera_xyz and camera_rpy cannot displace the camera"
        with catch_setting_errors(ValueError, where):
            return move_camera(urdf, *texts)


@functools.lru_cache(maxsize=32)
def read_arm(urdf: str, camera_frame: str, target_frame: str) -> Arm:
    """Return the kinematics of an arm; the result is cached, because all runs of a study use it."""
    return Arm.from_urdf(urdf, camera_frame, target_frame=target_frame)


def find_camera_name(camera: CameraDescription) -> str:
    """Return the name of a camera in the robot description, the namespace of its topics."""
    plugin_name = camera.plugin.camera_name if camera.plugin is not None else ""
    return (plugin_name or camera.name).strip("/")


@functools.lru_cache(maxsize=32)
def parse_camera_descriptions(urdf: str) -> tuple[CameraDescription, ...]:
    """Parse the cameras of a robot description; cached, because all runs of a study use them."""
    from aras_sim_bridge.description import parse_cameras

    return parse_cameras(urdf)


@functools.lru_cache(maxsize=8)
def parse_robot_description(urdf: str, search: tuple[str, ...]) -> RobotDescription:
    """Parse a robot description; the result is cached, because all runs of a study use it."""
    from aras_sim_bridge.description import parse_urdf

    return parse_urdf(urdf, PackagePath(search).find)
