"""A robot as the bench knows it: description, controllers' settings, frames; no ROS needed."""

from __future__ import annotations

import functools
import runpy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_sim_bridge.camera.from_description import settings as sensor_settings
from aras_sim_bridge.errors import CameraError, DescriptionError, SimError
from aras_visual_servo_base.names import nearest
from aras_visual_servo_base.poses import inverse, optical, to_xyz_rpy, transform
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_base.urdf import Joint, parse_tree
from aras_visual_servo_base.yaml_files import read_text, read_yaml
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.arm.arm import camera_path
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.seeing.rig import MovedBy, StandingCamera, beside

from ..errors import ExperimentError
from .cameras import CameraSpec, HandEyeSpec
from .packages import PackagePath

if TYPE_CHECKING:
    from aras_sim_bridge.description import CameraDescription, RobotDescription

    from .added_links import Carried

ROBOT = "robot"  # its model in the simulated world
FRAME = "camera_frame_of_"  # of a camera that the robot's own description has not, by its name
MOVED, BELIEVED = "moved_", "believed_"  # frames of one that is not where that has it
CAMERA_LINK = "camera_link"  # the one that the launch files move
OF = "target_of_"  # of what a camera looks at, by its name
NONE: Mapping[str, CameraSpec] = {}
# Keys of a described camera that say how it takes images; the others say where, and for whom.
IMAGING = frozenset((
    "width", "height", "horizontal_fov", "update_rate", "format", "near", "far", "lens",
    "camera_matrix", "cutoff_angle", "distortion_model", "distortion_coefficients", "effects",
))  # fmt: skip
NOTHING: Mapping[str, Carried] = {}


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

    def carrier_for(self, camera: CameraSpec | None) -> str:
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
        cameras: Mapping[str, CameraSpec] = NONE,
        carried: Mapping[str, Carried] = NOTHING,
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
        self._plain = read_text(self.packages.file(spec.urdf), ExperimentError)
        if not friction:
            self._plain = self._adapted("without_friction", self._plain)
        if hand_eye is not None:
            self._plain = self._calibrated(hand_eye)
        self._frame = spec.camera_frame
        self.urdf = self._framed(self._mounted(transform(xyz, rpy)))
        if carried:
            from .added_links import with_target
        for name, one in carried.items():
            self.urdf = with_target(self.urdf, name, one, spec.urdf)
        tree = read_yaml(self.packages.file(spec.config), ExperimentError)
        if not isinstance(tree, Mapping):
            raise ExperimentError(f"{spec.config} holds no controllers")
        for part in filter(None, spec.namespace.split("/")):
            tree = tree.get(part, tree)
        self.parameters: dict[str, Any] = dict(tree)

    def description(self) -> RobotDescription:
        """As the simulator takes it; ExperimentError naming what is wrong."""
        try:
            return described(self.urdf, self.spec.search)
        except DescriptionError as error:
            raise ExperimentError(f"{self.spec.urdf}: {error}") from None

    def camera_settings(self) -> dict[str, Any]:
        """How its camera takes images, as the description has it; empty where it has none.

        Raises:
            ExperimentError: the description says something impossible of it.
        """
        try:
            found = [one for one in described_cameras(self.urdf)
                     if self.spec.camera in ("", camera_name(one))]
            settings = sensor_settings(found[0]) if found else {}
        except (DescriptionError, CameraError) as error:
            raise ExperimentError(f"{self.spec.urdf}: {error}") from None
        return {key: value for key, value in settings.items() if key in IMAGING}

    def frame(self, camera: str) -> str:
        """The optical frame of a camera, in the description."""
        spec = self._cameras.get(camera)
        if spec is None or spec.own:
            return self._frame if spec is None or not spec.frame else spec.frame
        return f"{FRAME}{camera}"

    def carries_camera(self, link: str) -> bool:
        """Whether the optical frame of its own camera is a link, or fixed to it."""
        for joint in reversed(_path(self.urdf, self._frame, self.spec.urdf)):
            if joint.child == link or joint.kind == "fixed" and joint.parent == link:
                return True
            if joint.kind != "fixed":
                break
        return False

    def target_frame(self, camera: str) -> str:
        """The link that carries what a camera looks at; '': that stands in the world."""
        return self.spec.carrier_for(self._cameras.get(camera))

    def standing(self, camera: str) -> np.ndarray | None:
        """(4, 4) in the world of a camera that no joint moves, nor the target; None: one does."""
        if self.target_frame(camera):
            return None
        return Arm.standing(self.urdf, self.frame(camera))

    def mounting(self, link: str, camera: str = "") -> np.ndarray:
        """(4, 4) of a camera's optical frame in a link that carries it.

        Raises:
            ExperimentError: a link that does not carry it, or in which joints move it.
        """
        place = None
        for joint in _path(self.urdf, self.frame(camera), self.spec.urdf):
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

    def arm(self, camera: str = "") -> Arm:
        """Its true kinematics, of a camera; '': its own."""
        return self._arm(self.urdf, camera)

    def arm_of(self, camera: str, control: Arm, believed: bool = False) -> MovedBy:
        """What moves another camera than the control camera; `believed`: as the controller has it.

        Raises:
            ConfigurationError: see `beside`.
        """
        belief, place = self._cameras[camera].believed, self.standing(camera)
        if place is not None:
            off = transform(belief.xyz, belief.rpy)
            return StandingCamera(place @ off if believed else place)
        urdf, frame = self.urdf, self.frame(camera)
        if believed:
            urdf, frame = self._believed(belief.xyz, belief.rpy, camera)
        return beside(urdf, control, self._arm(urdf, camera, frame), camera)

    def believed_arm(self, xyz: Sequence[float], rpy: Sequence[float], camera: str = "") -> Arm:
        """Its kinematics with a camera believed elsewhere: off its place in its own optical frame
        (z forward, x right, y down), m, rad."""
        urdf, frame = self._believed(xyz, rpy, camera)
        return self._arm(urdf, camera, frame)

    def _believed(
        self, xyz: Sequence[float], rpy: Sequence[float], camera: str
    ) -> tuple[str, str]:
        """The description with a camera where it is believed, and the optical frame there."""
        frame = self.frame(camera)
        if not (any(xyz) or any(rpy)):
            return self.urdf, frame
        believed = f"{BELIEVED}{frame}"
        return self._with_frame(self.urdf, believed, frame, transform(xyz, rpy)), believed

    def _framed(self, urdf: str) -> str:
        """The description with the frames of all cameras that the experiment puts somewhere."""
        if self._cameras:
            from .added_links import with_link
        for name, camera in self._cameras.items():
            if camera.pose is not None:
                child, root = f"{FRAME}{name}", parse_tree(urdf).root
                urdf = with_link(urdf, child, root, camera.place())
            elif camera.hand_eye is not None:
                urdf = with_link(urdf, f"{FRAME}{name}", *self._calibrated_place(urdf, name))
            elif not camera.own:
                urdf = self._with_frame(urdf, f"{FRAME}{name}", self._frame, camera.place())
        return urdf

    def controllers(self, joints: Sequence[str]) -> tuple[dict[str, str], str]:
        """Controller of each of these joints, and the kind of command they take.

        Raises:
            ExperimentError: a joint without a controller, or controllers of different kinds.
        """
        from aras_visual_servo_controller.arm.joint_controllers import joint_controllers

        wanted = self.spec.controllers or tuple(self.parameters)
        known = {one.name: one for one in joint_controllers(self.parameters) if not one.group}
        found: dict[str, str] = {}
        kinds = set()
        for name in wanted:
            if name not in self.parameters:
                raise ExperimentError(
                    f"controller '{name}' is not in {self.spec.config}: "
                    + nearest(name, self.parameters)
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

    def _arm(self, urdf: str, camera: str, frame: str = "") -> Arm:
        try:
            return arm_from(urdf, frame or self.frame(camera), self.target_frame(camera))
        except ConfigurationError as error:
            raise ExperimentError(f"{self.spec.urdf}: {error}") from None

    def _with_frame(
        self, urdf: str, name: str, frame: str, frame_T_child: np.ndarray
    ) -> str:
        """The description with one more link, fixed to an optical frame, which need not be
        described itself."""
        last = _path(urdf, frame, self.spec.urdf)[-1]
        if last.child not in parse_tree(urdf).links:
            frame, frame_T_child = last.parent, last.pose.matrix() @ frame_T_child
        from .added_links import with_link

        return with_link(urdf, name, frame, frame_T_child)

    def _calibrated_place(self, urdf: str, name: str) -> tuple[str, np.ndarray]:
        """The link of a camera whose place is a hand-eye calibration's, and link_T_optical."""
        from aras_visual_servo_base.camera_mounting import carrying_link, check_optical

        camera = self._cameras[name]
        try:
            found = camera.hand_eye.read(self.packages)
            check_optical(found)
            link = carrying_link(urdf, found, camera.hand_eye.link)
        except SimError as error:
            raise ExperimentError(f"cameras.{name}.hand_eye: {error}") from None
        return link, found.link_T_camera

    def _calibrated(self, spec: HandEyeSpec) -> str:
        """The description with its camera where a hand-eye calibration found it."""
        from aras_visual_servo_base.camera_mounting import with_camera

        try:
            found = spec.read(self.packages)
            return with_camera(self._plain, found, spec.link, self.spec.camera_frame)
        except SimError as error:
            raise ExperimentError(f"hand_eye: {error}") from None

    def _mounted(self, link_T_link: np.ndarray) -> str:
        """The description with its camera moved in its link: as the launch files do it where
        camera_link carries the optical frame, else by a frame of its own."""
        if np.array_equal(link_T_link, np.eye(4)):
            return self._plain
        carried = _path(self._plain, self._frame, self.spec.urdf)
        if not any(joint.child == CAMERA_LINK for joint in carried):
            link = optical(np.eye(4))  # the axes of a camera's link: x forward, y left, z up
            frame, self._frame = self._frame, f"{MOVED}{self._frame}"
            moved = inverse(link) @ link_T_link @ link
            return self._with_frame(self._plain, self._frame, frame, moved)
        texts = (" ".join(map(repr, numbers)) for numbers in to_xyz_rpy(link_T_link))
        try:
            return self._adapted("mounted", self._plain, *texts)
        except ValueError as error:
            raise ExperimentError(f"{self.spec.urdf}: camera cannot be moved: {error}") from None

    def _adapted(self, how: str, *texts: str) -> str:
        """The description as a function of the launch files' own script makes it."""
        script = self.packages.file("package://aras_visual_servo_gazebo/scripts/adapt_description")
        return _functions(script)[how](*texts)


def _path(urdf: str, camera_frame: str, name: str) -> list[Joint]:
    """The joints from the root to an optical frame; ExperimentError, with the description's name,
    where there is no such frame."""
    try:
        return camera_path(parse_tree(urdf), "", camera_frame)
    except DescriptionError as error:
        raise ExperimentError(f"{name}: robot description: {error}") from None


_functions = functools.cache(runpy.run_path)


@functools.lru_cache(maxsize=32)
def arm_from(urdf: str, camera_frame: str, target_frame: str) -> Arm:
    """Read once a process, as `described`."""
    return Arm.from_urdf(urdf, camera_frame, target_frame=target_frame)


def camera_name(camera: CameraDescription) -> str:
    """A described camera's name, below which its topics are."""
    named = camera.plugin.camera_name if camera.plugin is not None else ""
    return (named or camera.name).strip("/")


@functools.lru_cache(maxsize=32)
def described_cameras(urdf: str) -> tuple[CameraDescription, ...]:
    """Read once a process, as `described`."""
    from aras_sim_bridge.description import parse_cameras

    return parse_cameras(urdf)


@functools.lru_cache(maxsize=8)
def described(urdf: str, search: tuple[str, ...]) -> RobotDescription:
    """Parsed once a process: all runs of a study have the same, which is frozen."""
    from aras_sim_bridge.description import parse_urdf

    return parse_urdf(urdf, PackagePath(search).find)
