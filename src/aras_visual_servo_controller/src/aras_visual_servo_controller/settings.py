"""Settings of the controller, and the construction of the control loop from them.

The node, the offline runner and the tests all construct the loop from these `ControllerSettings`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.settings import convert_fields, list_defaults
from aras_visual_servo_base.urdf import parse_tree
from aras_visual_servo_base.yaml_files import read_yaml

from .camera_settings import CameraSettings
from .errors import ConfigurationError, UnreachableError
from .goals.goal import Goal
from .goals.starts import find_start_joints
from .kinematics import Arm, CommandLimits, DifferentialIK, IKSettings
from .kinematics.arm import is_free_camera
from .kinematics.elbow import find_elbows
from .laws import Law, create_law
from .loop.servo import Servo
from .observation.camera_rig import (
    CameraKinematics,
    FixedCameraKinematics,
    make_camera_kinematics,
)
from .parameters import (
    BY_JOINT,
    GRAPH_NAMES,
    LEGAL_NAME,
    OUTLINE_TRACKER,
    ControllerParameters,
    expand_per_joint,
)
from .records.state import ServoSettings
from .schemes import JointController, Scheme, create_scheme

if TYPE_CHECKING:

    from .kinematics import SecondaryTask

NO_CAMERAS: Mapping[str, Any] = {}


@dataclass(frozen=True)
class ControllerSettings(CameraSettings):
    """Checked parameters of the controller, with methods that construct the parts of the loop."""

    documented_by = (ControllerParameters, ServoSettings)

    @classmethod
    def from_mapping(
        cls, raw: Mapping[str, Any], package: Path = Path("."), file: str = ""
    ) -> ControllerSettings:
        """Construct the settings from parameters, and check them.

        Args:
            raw: values of the parameters by name, as on the ROS parameter server.
            package: directory of this package, which contains config/.
            file: file from which the parameters come, for messages; '' for the parameter server.

        Raises:
            ConfigurationError: a parameter is wrong; the message names it, what is wrong and what
                is allowed.
        """
        where = f"{file}: parameter ~" if file else "parameter ~"
        values = convert_fields(cls, raw, where, ConfigurationError)
        known = list_defaults(cls)
        for name, value in values.items():
            if value == "" and known[name] != "":
                raise ConfigurationError(f"{where}{name} is '', must be a text that is not empty")
            if name in GRAPH_NAMES and not LEGAL_NAME.fullmatch(value or "x"):
                raise ConfigurationError(
                    f"{where}{name} is '{value}', which is not a ROS graph name: use letters, "
                    "digits, _ and /"
                )
        settings = cls(**values, package=package)
        settings.make_segmentation(where)
        settings.check_cameras(where)
        return settings

    def for_robot(
        self, name: str, raw_settings: Mapping[str, Any] | None = None
    ) -> ControllerSettings:
        """Return these settings with the values of config/robots/NAME.yaml, if this file exists.

        Parameters that the user has given keep their values.

        Args:
            name: name of the robot in its description.
            raw_settings: parameters that the user has given, by name. None if they are not known:
                then the parameters that differ from their defaults keep their values.
        """
        path = self.package / "config" / "robots" / f"{Path(name).name}.yaml"
        if not name or not path.is_file():
            return self
        robot_settings = ControllerSettings.from_mapping(
            read_yaml(path, ConfigurationError), self.package, str(path)
        )
        defaults = ControllerSettings(package=self.package)
        if raw_settings is None:
            raw_settings = [
                f.name for f in fields(self) if getattr(self, f.name) != getattr(defaults, f.name)
            ]
        raw_settings = set(raw_settings)
        known = {
            f.name: getattr(robot_settings, f.name)
            for f in fields(self)
            if f.name not in raw_settings
            and getattr(robot_settings, f.name) != getattr(defaults, f.name)
        }
        # In parameters that are given by joint name, keep only the values of joints that are used.
        for key in BY_JOINT if self.joints else ():
            if isinstance(value := known.get(key), Mapping):
                known[key] = {name: v for name, v in value.items() if name in self.joints} or (
                    getattr(defaults, key)
                )
        return replace(self, **known)

    def make_arm(self, urdf: str) -> Arm:
        """Construct the arm from a robot description.

        Raises:
            ConfigurationError: the description does not fit, or `controllers` names an unknown
                joint.
        """
        name = ""
        # If there are several cameras, the scheme determines which one is the control camera. The
        # name '' denotes the only camera.
        if self.cameras:
            name = self.list_cameras(self.make_scheme())[0]
        arm = self._make_camera_arm(urdf, name)
        for joint, controller in self.controllers.items():
            known = arm.names if joint in arm.names else parse_tree(urdf).joints
            if joint not in known:
                raise ConfigurationError(
                    f"parameter ~controllers has the unknown joint {joint}: {suggest(joint, known)}"
                )
            if not (isinstance(controller, str) and LEGAL_NAME.fullmatch(controller)):
                raise ConfigurationError(
                    f"parameter ~controllers: the value for {joint} is {controller!r}, must be the "
                    f"name of a controller, such as {joint}_{self.output}_controller"
                )
        return arm

    def _make_camera_arm(self, urdf: str, camera: str) -> Arm:
        entry = self.get_camera(camera)
        return Arm.from_urdf(
            urdf, entry.frame, self.base_frame, self.joints or None, entry.target_frame
        )

    def make_other_cameras(self, urdf: str, arm: Arm) -> dict[str, CameraKinematics]:
        """Return the kinematics of all cameras of the scheme except the control camera, by name.

        Raises:
            ConfigurationError: different joints move two of the cameras or their targets; or the
                scheme cannot use a camera that is fixed and whose target the arm does not move.
        """
        others: dict[str, CameraKinematics] = {}
        scheme = self.make_scheme()
        for name in self.list_cameras(scheme)[1:]:
            one, place = self.get_camera(name), None
            if not one.target_frame:
                place = Arm.find_fixed_pose(urdf, one.frame, self.base_frame)
            if place is None:
                others[name] = make_camera_kinematics(
                    urdf, arm, self._make_camera_arm(urdf, name), name
                )
            else:
                from .features.remote_camera_feature import check_controllability

                check_controllability(getattr(scheme, "features", ()), name)
                others[name] = FixedCameraKinematics(place)
        return others

    def make_law(self) -> Law:
        """Construct the control law.

        Raises:
            ConfigurationError: the law does not accept a parameter.
        """
        options = dict(self.law_options)
        for key in ("gain", "continuous_start", "ramp"):
            if key in options:
                raise ConfigurationError(
                    f"parameter ~law_options.{key} is not allowed: set ~{key} instead"
                )
        if self.gain is not None:
            options["gain"] = self.gain
        if wrong := [key for key in options if not isinstance(key, str)]:
            raise ConfigurationError(
                f"parameter ~law_options: {wrong[0]!r} is not a parameter of a law"
            )
        return create_law(self.law, self.continuous_start, self.ramp, **options)

    def make_scheme(self) -> Scheme | JointController:
        """Construct the scheme with its law.

        Raises:
            ConfigurationError: the name of the scheme or of the law is unknown.
        """
        return create_scheme(
            self.scheme,
            self.make_law(),
            self.weights or None,
            interaction=self.interaction,
            smoothing=self.smoothing,
        )

    def make_limits(self, arm: Arm) -> CommandLimits:
        """Return the joint limits of the commands.

        Raises:
            ConfigurationError: a limit does not fit the arm, or a joint has no speed limit.
        """
        limits = CommandLimits.for_arm(
            arm, self.lower, self.upper, self.max_velocity, self.max_acceleration
        )
        if isinstance(arm, Arm) and not np.isfinite(limits.velocity).all():
            name = arm.names[int(np.flatnonzero(~np.isfinite(limits.velocity))[0])]
            raise ConfigurationError(
                f"{name} has no speed limit: add a velocity to its <limit> in the robot "
                "description, or set ~max_velocity (rad/s, m/s)"
            )
        return limits

    def find_goal_file(self) -> Path:
        """Return the path of the goal's YAML file."""
        name = self.desired
        if name == "auto":
            name = self.start if isinstance(self.start, str) else ""
            if not self._find_shipped_goal(name).is_file():
                name = "2016"
        shipped = self._find_shipped_goal(name)
        return shipped if shipped.is_file() else Path(name).expanduser()

    def load_goal(self) -> Goal:
        """Read the goal from its file.

        Raises:
            ConfigurationError: the name is unknown, or the file is wrong.
        """
        path = self.find_goal_file()
        if not path.suffix and len(path.parts) == 1 and not path.exists():
            shipped = self._find_shipped_goal("").parent.glob("goal_*.yaml")
            names = sorted(file.stem.removeprefix("goal_") for file in shipped)
            raise ConfigurationError(
                f"unknown goal '{path}': {suggest(str(path), names)} (or the path of a YAML "
                "file)"
            )
        return Goal.load(path)

    def _find_shipped_goal(self, name: str) -> Path:
        return self.package / "config" / f"goal_{Path(name).name}.yaml"

    def make_differential_ik(
        self, arm: Arm, limits: CommandLimits, goal: Goal | None = None
    ) -> DifferentialIK:
        """Construct the differential inverse kinematics with its secondary tasks.

        Args:
            arm: arm to control.
            limits: joint limits of the commands.
            goal: goal; for a free-flying camera, its distance scales the lengths in IKSettings.

        Raises:
            ConfigurationError: a parameter names an unknown joint.
        """
        sides = self.elbow
        elbows = find_elbows(arm)
        if isinstance(sides, float):
            sides = {arm.names[elbow.joint]: sides for elbow in elbows}
        if not isinstance(sides, Mapping | None):
            raise ConfigurationError(
                f"parameter ~elbow is {list(sides)}, must be -1 or 1, or {{joint: -1 or 1}}"
            )
        # Ignore the side given for a joint that is no elbow, which can be the case if some joints
        # are not used.
        if sides and self.joints:
            elbow_names = [arm.names[elbow.joint] for elbow in elbows]
            sides = {n: s for n, s in sides.items() if n in elbow_names or n not in arm.names}
        if sides:
            elbows = find_elbows(arm, sides)
        tasks: list[SecondaryTask] = []
        if self.posture or self.limit_avoidance or self.singularity_avoidance:
            from .kinematics import JointLimitAvoidance, PostureTask, SingularityAvoidance

            if self.posture:
                tasks.append(PostureTask(arm, self.posture, self.posture_gain))
            if self.limit_avoidance:
                tasks.append(JointLimitAvoidance(limits))
            if self.singularity_avoidance:
                tasks.append(SingularityAvoidance(arm))
        numbers = IKSettings(hold_gain=self.hold_gain)
        if goal is not None and is_free_camera(arm):
            numbers = IKSettings.for_free_camera(goal.distance, self.hold_gain)
        return DifferentialIK(arm, limits, tasks, numbers, elbows)

    def make_servo(
        self,
        arm: Arm,
        goal: Goal | None = None,
        clock: Callable[[], float] | None = None,
        scheme: Scheme | JointController | None = None,
        differential_ik: DifferentialIK | None = None,
        other_cameras: Mapping[str, CameraKinematics] = NO_CAMERAS,
    ) -> Servo:
        """Construct the control loop that these parameters describe.

        Args:
            arm: arm to control.
            goal: goal; None for the goal that the parameter `desired` names.
            clock: function that returns the time in s, with which the computation time of the
                scheme is measured.
            scheme: scheme; None for the scheme that the parameter `scheme` names.
            differential_ik: inverse kinematics; None to construct it from these parameters.
            other_cameras: kinematics of the other cameras that the scheme uses, by name.

        Raises:
            ConfigurationError: a parameter is wrong; the message names it and what is allowed.
        """
        limits = self.make_limits(arm)
        shared = (f.name for f in fields(ServoSettings) if hasattr(self, f.name))
        values = {name: getattr(self, name) for name in shared}
        for name in ("lead", "stiffness", "damping"):
            values[name] = expand_per_joint(name, values[name], arm)
        values["duration"] = self.duration or np.inf
        scheme = scheme if scheme is not None else self.make_scheme()
        if goal is None:
            goal = self.load_goal().for_cameras(
                {self.list_cameras(scheme)[0]: arm, **other_cameras}
            )
            # A missing entry of the goal can be computed from the target's geometry only for
            # corners of its outline; other points have to be taught.
            if self.tracker == OUTLINE_TRACKER:
                from .loop.teaching import complete_by_geometry

                goal = complete_by_geometry(goal, scheme)
        # For the prismatic joints of a free-flying camera, lengths such as `lead` and `arrived` are
        # proportional to the size of the scene.
        if is_free_camera(arm):
            for name in ("lead", "arrived"):
                slides = np.where(arm.is_prismatic, goal.scale, 1.0)
                given = values.get(name, getattr(ServoSettings, name))
                values[name] = tuple((slides * np.asarray(given, float)).tolist())
        near = None
        if isinstance(self.start, Mapping):
            with contextlib.suppress(UnreachableError):
                near = goal.find_posture(arm)
        start = find_start_joints(self.start, arm, self.package, near)
        values["start"] = None if start is None else tuple(start.tolist())
        return Servo(
            scheme,
            arm,
            goal,
            self.make_differential_ik(arm, limits, goal)
            if differential_ik is None
            else differential_ik,
            ServoSettings(**values),
            clock,
            self.scheme,
        )
