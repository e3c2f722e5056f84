"""A robot as the bench knows it: description, controllers' settings, frames; no ROS needed."""

from __future__ import annotations

import functools
import runpy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_base.urdf import Joint, parse_tree
from aras_visual_servo_base.yaml_files import read_text, read_yaml
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.arm import find_camera_path
from aras_visual_servo_controller.observation.camera_rig import (
    CameraKinematics,
    FixedCameraKinematics,
    make_camera_kinematics,
)

from ..errors import ExperimentError
from .cameras import CameraSpec, HandEyeSpec
from .packages import PackagePath

if TYPE_CHECKING:
    from aras_sim_bridge.description import CameraDescription, RobotDescription

    from .added_links import MountedTarget

ROBOT = "robot"  # its model in the simulated world
# of a camera that the robot's own description has not, by its name
CAMERA_FRAME_PREFIX = "camera_frame_of_"
# frames of one that is not where that has it
MOVED_FRAME_PREFIX, CALIBRATED_FRAME_PREFIX = "moved_", "believed_"
CAMERA_LINK = "camera_link"  # the one that the launch files move
TARGET_LINK_PREFIX = "target_of_"  # of what a camera looks at, by its name
NO_CAMERAS: Mapping[str, CameraSpec] = {}
# Keys of a described camera that say how it takes images; the others say where, and for whom.
IMAGING_SETTINGS = frozenset((
    "width", "height", "horizontal_fov", "update_rate", "format", "near", "far", "lens",
    "camera_matrix", "cutoff_angle", "distortion_model", "distortion_coefficients", "effects",
))  # fmt: skip
NO_TARGETS: Mapping[str, MountedTarget] = {}


@dataclass(frozen=True)
class RobotSpec:
    """Which robot; the shipped one where nothing is said.

    urdf: path or package:// of the description. config: of the controllers' YAML.
    namespace: the robot's, below which the YAML may keep its controllers.
    camera_frame: the optical frame. camera: its name in the description; '' the first.
    target_frame: the link that carries the target where the arm moves that (eye-to-hand): poses
        of target and goal are then in this link's frame; '': the target stands in the world.
    controllers: names of the joint controllers to use; empty: every one for a single joint.
    joint_states: name of the controller that publishes them.
    cameras: package whose config/cameras holds the presets.
    search: folders that hold packages, for package://.
    """

    urdf: str = parameter(
        "package://aras_visual_servo_gazebo/robots/aras_visual_servo.urdf", shorthand=True
    )
    config: str = "package://aras_visual_servo_gazebo/config/aras_visual_servo_control.yaml"
    namespace: str = "/aras_visual_servo"
    camera_frame: str = "camera_optical_frame"
    camera: str = ""
    target_frame: str = ""
    controllers: tuple[str, ...] = ()
    joint_states: str = "joint_state_controller"
    cameras: str = "aras_visual_servo_gazebo"
    search: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check(self, ExperimentError, "robot")

    def find_carrier(self, camera: CameraSpec | None) -> str:
        """The link that carries what a camera looks at, None: the robot's own; '': the world."""
        own = "" if camera is None else camera.target_frame
        return own or self.target_frame


class Robot:
    """A RobotSpec with its files read.

    Attributes:
        spec: what it was made of. packages: where its packages are. urdf: the description's text.
        parameters: of the controllers.
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
        """Read the files.

        Args:
            xyz, rpy: the camera moved in its link, m and rad.
            friction: False takes the joints' dry friction out of the description.
            cameras: that it has, by name: each that is not its own gets a frame in the description.
            carried: targets on its links, by the names of the links that they become.
            hand_eye: where its camera is; None: where the description has it.

        Raises:
            ExperimentError: a file that is missing or cannot be used.
        """
        self.spec, self._cameras = spec, cameras
        self.packages = PackagePath(spec.search)
        self._original_urdf = read_text(self.packages.resolve(spec.urdf), ExperimentError)
        if not friction:
            self._original_urdf = self._adapt("remove_friction", self._original_urdf)
        if hand_eye is not None:
            self._original_urdf = self._apply_hand_eye(hand_eye)
        self._own_frame = spec.camera_frame
        self.urdf = self._add_camera_frames(self._move_camera(matrix_from_xyz_rpy(xyz, rpy)))
        if mounted_targets:
            from .added_links import with_target
        for name, one in mounted_targets.items():
            self.urdf = with_target(self.urdf, name, one, spec.urdf)
        tree = read_yaml(self.packages.resolve(spec.config), ExperimentError)
        if not isinstance(tree, Mapping):
            raise ExperimentError(f"{spec.config} holds no controllers")
        for part in filter(None, spec.namespace.split("/")):
            tree = tree.get(part, tree)
        self.parameters: dict[str, Any] = dict(tree)

    def parse_description(self) -> RobotDescription:
        """As the simulator takes it; ExperimentError naming what is wrong."""
        try:
            return parse_robot_description(self.urdf, self.spec.search)
        except DescriptionError as error:
            raise ExperimentError(f"{self.spec.urdf}: {error}") from None

    def read_camera_settings(self) -> dict[str, Any]:
        """How its camera takes images, as the description has it; empty where it has none.

        Raises:
            ExperimentError: the description says something impossible of it.
        """
        try:
            found = [one for one in parse_camera_descriptions(self.urdf)
                     if self.spec.camera in ("", find_camera_name(one))]
            settings = sensor_settings(found[0]) if found else {}
        except (DescriptionError, CameraError) as error:
            raise ExperimentError(f"{self.spec.urdf}: {error}") from None
        return {key: value for key, value in settings.items() if key in IMAGING_SETTINGS}

    def find_optical_frame(self, camera: str) -> str:
        """The optical frame of a camera, in the description."""
        spec = self._cameras.get(camera)
        if spec is None or spec.is_in_description:
            return self._own_frame if spec is None or not spec.frame else spec.frame
        return f"{CAMERA_FRAME_PREFIX}{camera}"

    def has_camera_on(self, link: str) -> bool:
        """Whether the optical frame of its own camera is a link, or fixed to it."""
        for joint in reversed(_find_joint_path(self.urdf, self._own_frame, self.spec.urdf)):
            if joint.child == link or joint.kind == "fixed" and joint.parent == link:
                return True
            if joint.kind != "fixed":
                break
        return False

    def find_target_frame(self, camera: str) -> str:
        """The link that carries what a camera looks at; '': that stands in the world."""
        return self.spec.find_carrier(self._cameras.get(camera))

    def find_fixed_pose(self, camera: str) -> np.ndarray | None:
        """(4, 4) in the world of a camera that no joint moves, nor the target; None: one does."""
        if self.find_target_frame(camera):
            return None
        return Arm.find_fixed_pose(self.urdf, self.find_optical_frame(camera))

    def compute_mounting(self, link: str, camera: str = "") -> np.ndarray:
        """(4, 4) of a camera's optical frame in a link that carries it.

        Raises:
            ExperimentError: a link that does not carry it, or in which joints move it.
        """
        place = None
        for joint in _find_joint_path(self.urdf, self.find_optical_frame(camera), self.spec.urdf):
            if joint.parent == link:
                place = np.eye(4)
            if place is None:
                continue
            if joint.kind != "fixed":
                raise ExperimentError(f"joint '{joint.name}' moves the camera in link '{link}': a "
                                      "hand-eye calibration is of a link that carries it")
            place = place @ joint.pose.matrix()
        if place is None:
            raise ExperimentError(f"link '{link}' does not carry the camera: set hand_eye.link to "
                                  "one that does")
        return place

    def make_arm(self, camera: str = "") -> Arm:
        """Its true kinematics, of a camera; '': its own."""
        return self._read_arm(self.urdf, camera)

    def make_camera_kinematics(
        self, camera: str, control: Arm, is_calibrated: bool = False
    ) -> CameraKinematics:
        """What moves another camera than the control camera; `is_calibrated`: as the controller has
        it.

        Raises:
            ConfigurationError: see `beside`.
        """
        belief, place = self._cameras[camera].calibration_offset, self.find_fixed_pose(camera)
        if place is not None:
            off = matrix_from_xyz_rpy(belief.xyz, belief.rpy)
            return FixedCameraKinematics(place @ off if is_calibrated else place)
        urdf, frame = self.urdf, self.find_optical_frame(camera)
        if is_calibrated:
            urdf, frame = self._add_calibrated_frame(belief.xyz, belief.rpy, camera)
        return make_camera_kinematics(urdf, control, self._read_arm(urdf, camera, frame), camera)

    def make_calibrated_arm(
        self, xyz: Sequence[float], rpy: Sequence[float], camera: str = ""
    ) -> Arm:
        """Its kinematics with a camera believed elsewhere: off its place in its own optical frame
        (z forward, x right, y down), m, rad."""
        urdf, frame = self._add_calibrated_frame(xyz, rpy, camera)
        return self._read_arm(urdf, camera, frame)

    def _add_calibrated_frame(
        self, xyz: Sequence[float], rpy: Sequence[float], camera: str
    ) -> tuple[str, str]:
        """The description with a camera where it is believed, and the optical frame there."""
        frame = self.find_optical_frame(camera)
        if not (any(xyz) or any(rpy)):
            return self.urdf, frame
        believed = f"{CALIBRATED_FRAME_PREFIX}{frame}"
        return self._with_frame(self.urdf, believed, frame, matrix_from_xyz_rpy(xyz, rpy)), believed

    def _add_camera_frames(self, urdf: str) -> str:
        """The description with the frames of all cameras that the experiment puts somewhere."""
        if self._cameras:
            from .added_links import with_link
        for name, camera in self._cameras.items():
            if camera.pose is not None:
                child, root = f"{CAMERA_FRAME_PREFIX}{name}", parse_tree(urdf).root
                urdf = with_link(urdf, child, root, camera.compute_pose())
            elif camera.hand_eye is not None:
                urdf = with_link(
                    urdf,
                    f"{CAMERA_FRAME_PREFIX}{name}",
                    *self._read_calibrated_mounting(urdf, name),
                )
            elif not camera.is_in_description:
                urdf = self._with_frame(
                    urdf, f"{CAMERA_FRAME_PREFIX}{name}", self._own_frame, camera.compute_pose()
                )
        return urdf

    def find_controllers(self, joints: Sequence[str]) -> tuple[dict[str, str], str]:
        """Controller of each of these joints, and the kind of command they take.

        Raises:
            ExperimentError: a joint without a controller, or controllers of different kinds.
        """
        from aras_visual_servo_controller.kinematics.joint_controllers import find_joint_controllers

        wanted = self.spec.controllers or tuple(self.parameters)
        known = {
            one.name: one for one in find_joint_controllers(self.parameters) if not one.is_group
        }
        found: dict[str, str] = {}
        kinds = set()
        for name in wanted:
            if name not in self.parameters:
                raise ExperimentError(
                    f"controller '{name}' is not in {self.spec.config}: "
                    + suggest(name, self.parameters)
                )
            one = known.get(name)
            if one is not None and one.joints[0] in joints:
                found.setdefault(one.joints[0], name)
                kinds.add(one.kind)
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
                " name one kind in robot.controllers"
            )
        return {joint: found[joint] for joint in joints}, kinds.pop()

    def _read_arm(self, urdf: str, camera: str, frame: str = "") -> Arm:
        try:
            return read_arm(
                urdf, frame or self.find_optical_frame(camera), self.find_target_frame(camera)
            )
        except ConfigurationError as error:
            raise ExperimentError(f"{self.spec.urdf}: {error}") from None

    def _with_frame(
        self, urdf: str, name: str, frame: str, frame_T_child: np.ndarray
    ) -> str:
        """The description with one more link, fixed to an optical frame, which need not be
        described itself."""
        last = _find_joint_path(urdf, frame, self.spec.urdf)[-1]
        if last.child not in parse_tree(urdf).links:
            frame, frame_T_child = last.parent, last.pose.matrix() @ frame_T_child
        from .added_links import with_link

        return with_link(urdf, name, frame, frame_T_child)

    def _read_calibrated_mounting(self, urdf: str, name: str) -> tuple[str, np.ndarray]:
        """The link of a camera whose place is a hand-eye calibration's, and link_T_optical."""
        from aras_visual_servo_base.camera_mounting import check_optical, find_camera_link

        camera = self._cameras[name]
        try:
            found = camera.hand_eye.read(self.packages)
            check_optical(found)
            link = find_camera_link(urdf, found, camera.hand_eye.link)
        except SimError as error:
            raise ExperimentError(f"cameras.{name}.hand_eye: {error}") from None
        return link, found.link_T_camera

    def _apply_hand_eye(self, spec: HandEyeSpec) -> str:
        """The description with its camera where a hand-eye calibration found it."""
        from aras_visual_servo_base.camera_mounting import mount_camera

        try:
            found = spec.read(self.packages)
            return mount_camera(self._original_urdf, found, spec.link, self.spec.camera_frame)
        except SimError as error:
            raise ExperimentError(f"hand_eye: {error}") from None

    def _move_camera(self, link_T_link: np.ndarray) -> str:
        """The description with its camera moved in its link: as the launch files do it where
        camera_link carries the optical frame, else by a frame of its own."""
        if np.array_equal(link_T_link, np.eye(4)):
            return self._original_urdf
        carried = _find_joint_path(self._original_urdf, self._own_frame, self.spec.urdf)
        if not any(joint.child == CAMERA_LINK for joint in carried):
            link = optical_pose(np.eye(4))  # the axes of a camera's link: x forward, y left, z up
            frame, self._own_frame = self._own_frame, f"{MOVED_FRAME_PREFIX}{self._own_frame}"
            moved = inverse(link) @ link_T_link @ link
            return self._with_frame(self._original_urdf, self._own_frame, frame, moved)
        texts = (" ".join(map(repr, numbers)) for numbers in xyz_rpy_from_matrix(link_T_link))
        try:
            return self._adapt("move_camera", self._original_urdf, *texts)
        except ValueError as error:
            raise ExperimentError(f"{self.spec.urdf}: camera cannot be moved: {error}") from None

    def _adapt(self, function: str, *texts: str) -> str:
        """The description as a function of the launch files' own script makes it."""
        script = self.packages.resolve("package://aras_visual_servo_gazebo/scripts/adapt_description")
        return _load_functions(script)[function](*texts)


def _find_joint_path(urdf: str, camera_frame: str, name: str) -> list[Joint]:
    """The joints from the root to an optical frame; ExperimentError, with the description's name,
    where there is no such frame."""
    try:
        return find_camera_path(parse_tree(urdf), "", camera_frame)
    except DescriptionError as error:
        raise ExperimentError(f"{name}: robot description: {error}") from None


_load_functions = functools.cache(runpy.run_path)


@functools.lru_cache(maxsize=32)
def read_arm(urdf: str, camera_frame: str, target_frame: str) -> Arm:
    """Read once a process, as `parse_robot_description`."""
    return Arm.from_urdf(urdf, camera_frame, target_frame=target_frame)


def find_camera_name(camera: CameraDescription) -> str:
    """A described camera's name, below which its topics are."""
    named = camera.plugin.camera_name if camera.plugin is not None else ""
    return (named or camera.name).strip("/")


@functools.lru_cache(maxsize=32)
def parse_camera_descriptions(urdf: str) -> tuple[CameraDescription, ...]:
    """Read once a process, as `parse_robot_description`."""
    from aras_sim_bridge.description import parse_cameras

    return parse_cameras(urdf)


@functools.lru_cache(maxsize=8)
def parse_robot_description(urdf: str, search: tuple[str, ...]) -> RobotDescription:
    """Parsed once a process: all runs of a study have the same, which is frozen."""
    from aras_sim_bridge.description import parse_urdf

    return parse_urdf(urdf, PackagePath(search).find)
