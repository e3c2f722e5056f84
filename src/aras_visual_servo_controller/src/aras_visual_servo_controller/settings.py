"""Parameters of the controller: each one listed once, with unit and default, and checked.

The node, the runner and the tests build their loop from the same `Settings`, so it is one loop.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import nearest
from aras_visual_servo_base.poses import transform
from aras_visual_servo_base.settings import build, converted, default_of, defaults, parameter
from aras_visual_servo_base.urdf import parse_tree
from aras_visual_servo_base.yaml_files import read_yaml
from aras_visual_servo_camera.errors import SegmentationError, VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.pipeline import PipelineSettings
from aras_visual_servo_camera.segmentation import Segmentation

from .arm import (
    Arm,
    JointLimitAvoidance,
    Limits,
    Posture,
    Resolver,
    ResolverSettings,
    SecondaryTask,
    SingularityAvoidance,
)
from .arm.fold import find
from .errors import ConfigurationError
from .features.of_camera import check_steering
from .goals.goal import Goal
from .goals.starts import start_joints
from .laws import Law, create_law
from .laws.base import GREATEST_GAIN
from .loop.servo import Servo
from .loop.teaching import by_geometry
from .records.state import ByJoint, ServoSettings, by_joint
from .schemes import JointController, Scheme, create_scheme
from .seeing.observation import CAMERA, Need
from .seeing.observer import Observer
from .seeing.rig import MovedBy, Rig, StandingCamera, beside

if TYPE_CHECKING:
    from aras_visual_servo_camera.trackers import Tracker

# Parameters that are said for some of the joints, by name.
BY_JOINT = ("max_velocity", "max_acceleration", "lower", "upper", "posture", "elbow", "lead",
            "stiffness", "damping", "controllers")  # fmt: skip
NONE: Mapping[str, Any] = {}
MODEL = "model"  # the tracker of a known mesh
MARKER = "marker"  # the tracker of an ArUco or AprilTag marker, or of a board of them
OUTLINE = "outline"  # the tracker that takes the corners of what was segmented
# Parameters that are names on a ROS graph.
NAMES = ("namespace", "camera_namespace", "command_topic", "description")
LEGAL = re.compile(r"[~/]?[A-Za-z][\w/]*", re.ASCII)


def of_loop(name: str) -> Any:
    """The parameter that is a setting of the loop itself, as that has it."""
    field = ServoSettings.__dataclass_fields__[name]
    return parameter(field.default, **field.metadata)


@dataclass(frozen=True)
class CameraEntry:
    """One of several cameras of a node.

    frame: of it, in the description; empty: NAME_optical_frame.
    namespace: of its image_raw, camera_info and depth/image_raw; empty: /NAME.
    features: namespace of what a camera node measures in its images, moments and kernel; empty:
        camera/NAME in that of the arm.
    target_frame: link that carries what it looks at, where the arm moves that; empty: as for all.
    """

    frame: str = ""
    namespace: str = ""
    features: str = ""
    target_frame: str = ""


@dataclass(frozen=True)
class Settings:
    """Parameters of the loop and its node; lengths in m, angles in rad.

    What may be given for each joint is one number for all, a list in the arm's order, or numbers
    by joint name. Those of the loop itself are ServoSettings'.

    scheme: feature, scheme, several joined by '+', or 'package.module:Class'.
    interaction: interaction matrix that the scheme uses: current, desired, mean, estimated.
    tracker: what finds the target's points: outline, another tracker's name, or
        'package.module:Class'.
    marker: marker that is the target: 5, DICT_5X5_100:5, or a board; empty: that of the goal.
    model: mesh of the target (STL, OBJ, DAE), m, whose pose is followed: the tracker is 'model'.
    model_scale: factor on the lengths of the model's file, 0.001 where they are in mm.
    model_start: where the model is at first: {pose: x y z roll pitch yaw in the base}, {marker:
        {size, pose}} or {clicks: rows x y z u v}.
    segmentation: how the target's pixels are found, {method, threshold, near_colour, label, ...},
        as the camera node has it.
    depth_image: the target's plane comes from the camera's depth image instead of goal and
        kinematics.
    weights: one weight for each of several features; empty: all equal.
    smoothing: s, time constant of a low-pass filter on the errors; 0: none.
    law: name of a control law, or 'package.module:Class'.
    gain: 1/s, gain of the law; none: its own default.
    law_options: other parameters of the law, by name.
    continuous_start: 1/s, rate at which the initial velocity step is blended in; 0: at once.
    ramp: s, time constant with which the gain rises at the start; 0: none.
    start: initial pose: a name, none, joints, or {xyz, rpy} of the camera, searched from the
        posture at the goal.
    desired: goal: auto (that of the start), a name, or a YAML file.
    duration: s, servoing time after which the run has timed out; 0: no end.
    max_velocity: m/s, rad/s, greatest speed of each joint; none: that of the description, and
        needed where that has none.
    max_acceleration: m/s^2, rad/s^2, greatest acceleration of each joint; none: no limit.
    lower: m, rad, least position of each joint; none: that of the description.
    upper: m, rad, greatest position of each joint; none: that of the description.
    hold_gain: 1/s, gain of the directions that the scheme does not model, which are kept as at the
        goal.
    posture: m, rad, preferred joint positions by name; a secondary task.
    posture_gain: 1/s, gain of that secondary task.
    limit_avoidance: keep joints away from their limits; a secondary task.
    singularity_avoidance: increase manipulability; a secondary task.
    elbow: side to which stretched elbows bend: -1 or 1, or by joint.
    wall_watchdog: s, wall time without a fresh answer before the arm is stopped.
    scheme_timeout: s, wall time that a call of the scheme's code may take before the loop holds as
        after a fault of the scheme.
    camera_frame: frame of the camera in the description.
    cameras: several cameras by name, instead of camera_frame and camera_namespace: see CameraEntry.
    base_frame: link that is the arm's base; empty: the root.
    target_frame: link that carries the target, where the arm moves it.
    joints: names of the joints to use; empty: all that move the camera.
    namespace: namespace of joint states, features and commands.
    camera_namespace: namespace of image_raw, camera_info and depth/image_raw, for schemes that need
        them.
    controllers: name of each joint's controller, in the namespace.
    command_topic: one topic of a group of joints, instead of one each.
    description: parameter that holds the URDF.
    listeners: subscribers of controller/state to wait for, at most 5 s.
    image_timeout: s, time without images before the node reports it.
    joint_timeout: s, time without joint states before the node reports it.
    lockstep: one answer for each image; unless given, as the simulator's speed_mode says.
    autostart: servo at once; false: wait for start or the action.
    dry: send no commands: try a scheme on a recorded bag.
    package: directory of this package.
    """

    documented_by = (ServoSettings,)  # of the settings that are the loop's

    scheme: str = parameter("moments", name=True)
    interaction: str = parameter("current")
    tracker: str = parameter(OUTLINE)
    marker: str | Mapping[str, Any] = parameter("", name=True)
    model: str = parameter("")
    model_scale: float = parameter(1.0, above=0.0)
    model_start: Mapping[str, Any] = parameter({})
    segmentation: Mapping[str, Any] = parameter({})
    depth_image: bool = parameter(False)
    weights: tuple[float, ...] = parameter(())
    smoothing: float = parameter(0.0, "s", least=0.0, most=10.0)
    law: str = parameter("proportional")
    gain: float | None = parameter(None, "1/s", above=0.0)
    law_options: Mapping[str, int | float | Any] = parameter({})
    continuous_start: float = parameter(0.0, "1/s", least=0.0)
    ramp: float = parameter(0.0, "s", least=0.0)
    start: Any = parameter("none", name=True)
    desired: str = parameter("auto", name=True)
    hold: float = of_loop("hold")
    duration: float = parameter(0.0, "s", least=0.0)
    max_velocity: ByJoint | None = by_joint(None, "m/s, rad/s")
    max_acceleration: ByJoint | None = by_joint(None, "m/s^2, rad/s^2")
    lower: ByJoint | None = by_joint(None, "m, rad")
    upper: ByJoint | None = by_joint(None, "m, rad")
    hold_gain: float = parameter(3.0, "1/s", least=0.0, most=GREATEST_GAIN)
    posture: Mapping[str, float] = parameter({}, "m, rad")
    posture_gain: float = parameter(1.0, "1/s", least=0.0, most=GREATEST_GAIN)
    limit_avoidance: bool = parameter(True)
    singularity_avoidance: bool = parameter(False)
    elbow: ByJoint | None = by_joint(None)
    lead: ByJoint = of_loop("lead")
    lag: float = of_loop("lag")
    approach_speed: float = of_loop("approach_speed")
    delay: float = of_loop("delay")
    watchdog: float = of_loop("watchdog")
    wall_watchdog: float = parameter(5.0, "s", above=0.0)
    scheme_timeout: float = of_loop("scheme_timeout")
    stop_time: float = of_loop("stop_time")
    output: str = of_loop("output")
    stiffness: ByJoint = of_loop("stiffness")
    damping: ByJoint = of_loop("damping")
    camera_frame: str = parameter("camera_optical_frame")
    cameras: Mapping[str, CameraEntry] = parameter({})
    base_frame: str = parameter("")
    target_frame: str = parameter("")
    joints: tuple[str, ...] = parameter(())
    namespace: str = parameter("/aras_visual_servo")
    camera_namespace: str = parameter("/labrob/camera")
    controllers: Mapping[str, Any] = parameter({})
    command_topic: str = parameter("")
    description: str = parameter("robot_description")
    listeners: float = parameter(0.0, least=0.0)
    image_timeout: float = parameter(1.0, "s", least=0.1)
    joint_timeout: float = parameter(1.0, "s", least=0.1)
    lockstep: bool = parameter(False)
    autostart: bool = parameter(True)
    dry: bool = parameter(False)
    package: Path = parameter(Path("."), internal=True)

    @classmethod
    def from_mapping(
        cls, raw: Mapping[str, Any], package: Path = Path("."), file: str = ""
    ) -> Settings:
        """Check what the parameter server holds.

        Args:
            raw: name to value, as rosparam gives them.
            package: directory of this package, where config/ is.
            file: that holds them, for messages; '': the parameter server.

        Raises:
            ConfigurationError: naming the parameter, what is wrong and what would be right.
        """
        where = f"{file}: parameter ~" if file else "parameter ~"
        values = converted(cls, raw, where, ConfigurationError)
        known = defaults(cls)
        for name, value in values.items():
            if value == "" and known[name] != "":
                raise ConfigurationError(f"{where}{name} is '', must be a text that is not empty")
            if name in NAMES and not LEGAL.fullmatch(value or "x"):
                raise ConfigurationError(
                    f"{where}{name} is '{value}', which is no name on a ROS graph: letters, "
                    "digits, _ and / are"
                )
        settings = cls(**values, package=package)
        settings.make_segmentation(where)
        settings._check_cameras(where)
        return settings

    def _check_cameras(self, where: str) -> None:
        """ConfigurationError for two cameras of one topic: they would be one."""
        for key, topic in (("namespace", "image_raw"), ("features", "moments")):
            heard: dict[str, str] = {}
            for name in self.cameras:
                space = getattr(self.camera_of(name), key)
                if (other := heard.setdefault(space, name)) != name:
                    raise ConfigurationError(
                        f"{where}cameras: {other} and {name} both listen to {space}/{topic}: give "
                        f"each a {key} of its own"
                    )

    def for_robot(self, name: str, given: Mapping[str, Any] | None = None) -> Settings:
        """These settings, with config/robots/NAME.yaml for what was not given.

        Args:
            name: of the robot in its description.
            given: names of what was given (the keys count); None: what differs from the defaults.
        """
        path = self.package / "config" / "robots" / f"{Path(name).name}.yaml"
        if not name or not path.is_file():
            return self
        of_robot = Settings.from_mapping(
            read_yaml(path, ConfigurationError), self.package, str(path)
        )
        plain = Settings(package=self.package)
        if given is None:
            given = [
                f.name for f in fields(self) if getattr(self, f.name) != getattr(plain, f.name)
            ]
        given = set(given)
        known = {
            f.name: getattr(of_robot, f.name)
            for f in fields(self)
            if f.name not in given and getattr(of_robot, f.name) != getattr(plain, f.name)
        }
        for key in BY_JOINT if self.joints else ():  # of the other joints nothing is to be said
            if isinstance(value := known.get(key), Mapping):
                known[key] = {name: v for name, v in value.items() if name in self.joints} or (
                    getattr(plain, key)
                )
        return replace(self, **known)

    def arm(self, urdf: str) -> Arm:
        """The arm of a description; ConfigurationError as Arm.from_urdf, or for controllers of
        joints that it has not."""
        name = ""
        if self.cameras:  # of one camera the scheme need not be there, as where a bag is read
            name = self.read_by(self.make_scheme())[0]
        arm = self._arm_of(urdf, name)
        for joint, controller in self.controllers.items():
            known = arm.names if joint in arm.names else parse_tree(urdf).joints
            if joint not in known:
                raise ConfigurationError(
                    f"parameter ~controllers names the joint {joint}: {nearest(joint, known)}"
                )
            if not (isinstance(controller, str) and LEGAL.fullmatch(controller)):
                raise ConfigurationError(
                    f"parameter ~controllers: that of {joint} is {controller!r}, must be the name "
                    f"of a controller, as {joint}_{self.output}_controller"
                )
        return arm

    def _arm_of(self, urdf: str, camera: str) -> Arm:
        entry = self.camera_of(camera)
        return Arm.from_urdf(
            urdf, entry.frame, self.base_frame, self.joints or None, entry.target_frame
        )

    def camera_of(self, name: str) -> CameraEntry:
        """Frame and topics of the camera of a name."""
        features = f"{self.namespace.rstrip('/')}/camera"
        if not self.cameras:
            return CameraEntry(
                self.camera_frame, self.camera_namespace.rstrip("/"), features, self.target_frame
            )
        entry = self.cameras[name]
        return CameraEntry(
            entry.frame or f"{name}_optical_frame", (entry.namespace or f"/{name}").rstrip("/"),
            (entry.features or f"{features}/{name}").rstrip("/"),
            entry.target_frame or self.target_frame,
        )  # fmt: skip

    def read_by(self, scheme: Scheme | JointController) -> tuple[str, ...]:
        """Names of the cameras that a scheme reads, in their own order: the first is the control
        camera.

        Raises:
            ConfigurationError: it names one that there is not.
        """
        known = tuple(self.cameras or (CAMERA,))
        read = {name or known[0] for name in scheme.cameras or ("",)}
        for name in read:
            if name not in known:
                raise ConfigurationError(
                    f"scheme '{self.scheme}' reads the camera '{name}': {nearest(name, known)}"
                )
        return tuple(name for name in known if name in read)

    def others(self, urdf: str, arm: Arm) -> dict[str, MovedBy]:
        """What moves the other cameras that the scheme reads, by their names.

        Raises:
            ConfigurationError: one of them sits elsewhere on the arm than the control camera, or
                stands still where it is to steer; see `beside`.
        """
        others: dict[str, MovedBy] = {}
        scheme = self.make_scheme()
        for name in self.read_by(scheme)[1:]:
            one, place = self.camera_of(name), None
            if not one.target_frame:
                place = Arm.standing(urdf, one.frame, self.base_frame)
            if place is None:
                others[name] = beside(urdf, arm, self._arm_of(urdf, name), name)
            else:
                check_steering(getattr(scheme, "features", ()), name)
                others[name] = StandingCamera(place)
        return others

    def make_law(self) -> Law:
        """Return the law with its parameters; ConfigurationError for what it refuses."""
        options = dict(self.law_options)
        for key in ("gain", "continuous_start", "ramp"):
            if key in options:
                raise ConfigurationError(f"parameter ~law_options.{key}: give it as ~{key}")
        if self.gain is not None:
            options["gain"] = self.gain
        if wrong := [key for key in options if not isinstance(key, str)]:
            raise ConfigurationError(
                f"parameter ~law_options: {wrong[0]!r} is no parameter of a law"
            )
        return create_law(self.law, self.continuous_start, self.ramp, **options)

    def make_scheme(self) -> Scheme | JointController:
        """The scheme with its law; ConfigurationError naming what is unknown."""
        return create_scheme(
            self.scheme,
            self.make_law(),
            self.weights or None,
            interaction=self.interaction,
            smoothing=self.smoothing,
        )

    def limits(self, arm: Arm) -> Limits:
        """Of the commands; ConfigurationError as Limits.of, or for a joint of an arm whose speed
        nothing limits."""
        limits = Limits.of(arm, self.lower, self.upper, self.max_velocity, self.max_acceleration)
        if isinstance(arm, Arm) and not np.isfinite(limits.velocity).all():
            name = arm.names[int(np.flatnonzero(~np.isfinite(limits.velocity))[0])]
            raise ConfigurationError(
                f"nothing limits the speed of {name}: its <limit> in the robot description says no "
                "velocity: give one there or as ~max_velocity (rad/s, m/s)"
            )
        return limits

    def goal_path(self) -> Path:
        """The YAML file of the goal."""
        name = self.desired
        if name == "auto":
            name = self.start if isinstance(self.start, str) else ""
            if not self._shipped(name).is_file():
                name = "2016"
        shipped = self._shipped(name)
        return shipped if shipped.is_file() else Path(name).expanduser()

    def load_goal(self) -> Goal:
        """The goal; ConfigurationError for a name that there is not, and as Goal.load."""
        path = self.goal_path()
        if not path.suffix and len(path.parts) == 1 and not path.exists():
            shipped = self._shipped("").parent.glob("goal_*.yaml")
            names = sorted(file.stem.removeprefix("goal_") for file in shipped)
            raise ConfigurationError(
                f"unknown goal '{path}': {nearest(str(path), names)} (or the path of a YAML "
                "file)"
            )
        return Goal.load(path)

    def _shipped(self, name: str) -> Path:
        return self.package / "config" / f"goal_{Path(name).name}.yaml"

    def resolver(self, arm: Arm, limits: Limits, goal: Goal | None = None) -> Resolver:
        """The resolver with its secondary tasks; ConfigurationError for unknown joints.

        `goal`: tells the lengths of a camera that flies without an arm.
        """
        sides = self.elbow
        folds = find(arm)
        if isinstance(sides, float):
            sides = {arm.names[fold.joint]: sides for fold in folds}
        if not isinstance(sides, Mapping | None):
            raise ConfigurationError(
                f"parameter ~elbow is {list(sides)}, must be -1 or 1, or {{joint: -1 or 1}}"
            )
        if sides and self.joints:  # of an elbow that is not used, or not alone, nothing is known
            elbows = [arm.names[fold.joint] for fold in folds]
            sides = {n: s for n, s in sides.items() if n in elbows or n not in arm.names}
        if sides:
            folds = find(arm, sides)
        tasks: list[SecondaryTask] = []
        if self.posture:
            tasks.append(Posture(arm, self.posture, self.posture_gain))
        if self.limit_avoidance:
            tasks.append(JointLimitAvoidance(limits))
        if self.singularity_avoidance:
            tasks.append(SingularityAvoidance(arm))
        numbers = ResolverSettings(hold_gain=self.hold_gain)
        if goal is not None and flies(arm):
            numbers = ResolverSettings.without_arm(goal.distance, self.hold_gain)
        return Resolver(arm, limits, tasks, numbers, folds)

    def build(
        self,
        arm: Arm,
        goal: Goal | None = None,
        clock: Callable[[], float] | None = None,
        scheme: Scheme | JointController | None = None,
        resolver: Resolver | None = None,
        others: Mapping[str, MovedBy] = NONE,
    ) -> Servo:
        """The loop that these parameters describe.

        Args:
            arm: that it moves.
            goal: None: the one that `desired` names.
            clock: s, to tell a scheme that takes too long.
            scheme: None: the one that `scheme` names.
            resolver: None: the one that these parameters describe.
            others: what moves the other cameras that the scheme reads, by name.

        Raises:
            ConfigurationError: what cannot be, and what would be right.
        """
        limits = self.limits(arm)
        shared = (f.name for f in fields(ServoSettings) if hasattr(self, f.name))
        values = {name: getattr(self, name) for name in shared}
        for name in ("lead", "stiffness", "damping"):
            values[name] = per_joint(name, values[name], arm)
        values["duration"] = self.duration or np.inf
        scheme = scheme if scheme is not None else self.make_scheme()
        if goal is None:
            goal = self.load_goal().for_cameras({self.read_by(scheme)[0]: arm, **others})
            if self.tracker == OUTLINE:  # other points than its corners are for trackers to teach
                goal = by_geometry(goal, scheme)
        if flies(arm):  # what slides is the camera: its lengths are the scene's
            for name in ("lead", "arrived"):
                slides = np.where(arm.prismatic, goal.scale, 1.0)
                given = values.get(name, getattr(ServoSettings, name))
                values[name] = tuple((slides * np.asarray(given, float)).tolist())
        near = goal.posture(arm) if isinstance(self.start, Mapping) else None
        start = start_joints(self.start, arm, self.package, near)
        values["start"] = None if start is None else tuple(start.tolist())
        return Servo(
            scheme,
            arm,
            goal,
            self.resolver(arm, limits, goal) if resolver is None else resolver,
            ServoSettings(**values),
            clock,
            self.scheme,
        )

    def rig(
        self,
        arms: Mapping[str, MovedBy | None],
        scheme: Scheme | JointController,
        goal: Goal | None = None,
    ) -> Rig:
        """What makes observations for that scheme.

        Args:
            arms: what moves the cameras that it reads, by name, the control camera first.
            goal: as the loop has it.
        """
        depth = frozenset((Need.DEPTH,)) if self.depth_image else frozenset()
        control = next(iter(arms))
        plane, held = (self._outline_plane(), {}) if goal is None else (None, goal.cameras)
        return Rig(
            Observer(
                arm, scheme.needs_of(*(("", name) if name == control else (name,))) | depth,
                PipelineSettings(self.make_segmentation()),
                self.make_tracker(held[name].marker if name in held else ""),
                held[name].plane_from if name in held else plane, name,
            )
            for name, arm in arms.items()
        )  # fmt: skip

    def _outline_plane(self) -> Callable[[np.ndarray], Plane] | None:
        """Tells the plane of the model's outline as seen from world_T_camera (4, 4), by the pose
        that it starts from; None where that is not known, and no goal is taught by it."""
        if not self.model or "pose" not in self.model_start:
            return None
        from aras_visual_servo_camera.silhouette import OutlinePlane

        solid, place = self.make_tracker().tracking.solid, self.model_start["pose"]
        return OutlinePlane(
            solid.vertices, transform(place[:3], place[3:]), Path(self.model).name
        ).seen_from

    def make_segmentation(self, where: str = "parameter ~") -> Segmentation:
        """How the target's pixels are told; ConfigurationError for what is wrong with it."""
        where = f"{where}segmentation"
        try:
            given = self.segmentation
            if self.marker and "marker" not in given:
                given = {"marker": self.marker, **given}
            found = build(Segmentation, given, where, ConfigurationError)
        except SegmentationError as error:
            raise ConfigurationError(f"{where}: {error}") from error
        if found.component == "mask":
            raise ConfigurationError(
                f"{where}.component 'mask' is for the camera node, which has the mask image: give "
                "all, largest or nearest"
            )
        return found

    def make_tracker(self, marker: str = "") -> Tracker | None:
        """What finds the points of the target; None: the outline's corners.

        Args:
            marker: that the goal was taught by, for the tracker 'marker' where none is chosen.
        """
        name = self.tracker
        if self.model or "model" in re.split(r"[+@]", self.scheme):
            name = MODEL
        if name == OUTLINE:
            return None
        from aras_visual_servo_camera.trackers import TRACKERS

        given = vars(self) | {"marker": self.marker or marker}
        try:
            known = [parameter.name for parameter in TRACKERS.parameters(name)]
            return TRACKERS.create(name, **{key: given[key] for key in known if key in given})
        except (VisionError, DescriptionError) as error:
            raise ConfigurationError(str(error)) from None


def flies(arm: Arm) -> bool:
    """Whether it is a camera that flies, without joints of an arm."""
    return getattr(arm, "free", False)


def per_joint(name: str, value: Any, arm: Arm) -> Any:
    """One number, or numbers in the arm's order, from what may be given by joint name."""
    if not isinstance(value, Mapping):
        return value
    for joint in value:
        if joint not in arm.names:
            raise ConfigurationError(
                f"parameter ~{name} names the joint {joint}: {nearest(joint, arm.names)}"
            )
    other = default_of(Settings.__dataclass_fields__[name])
    return tuple(float(value.get(joint, other)) for joint in arm.names)
