"""Parameters of the controller: each one listed once, with unit and default."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.settings import get_default, parameter

from .errors import ConfigurationError
from .kinematics import Arm
from .laws.base import MAX_GAIN
from .records.state import PerJoint, ServoSettings, joint_parameter

# Parameters that are said for some of the joints, by name.
BY_JOINT = ("max_velocity", "max_acceleration", "lower", "upper", "posture", "elbow", "lead",
            "stiffness", "damping", "controllers")  # fmt: skip
MODEL_TRACKER = "model"  # the tracker of a known mesh
MARKER_TRACKER = "marker"  # the tracker of an ArUco or AprilTag marker, or of a board of them
OUTLINE_TRACKER = "outline"  # the tracker that takes the corners of what was segmented
# Parameters that are names on a ROS graph.
GRAPH_NAMES = ("namespace", "camera_namespace", "command_topic", "description")
LEGAL_NAME = re.compile(r"[~/]?[A-Za-z][\w/]*", re.ASCII)


def copy_loop_parameter(name: str) -> Any:
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
class Parameters:
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

    scheme: str = parameter("moments", name=True)
    interaction: str = parameter("current")
    tracker: str = parameter(OUTLINE_TRACKER)
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
    hold: float = copy_loop_parameter("hold")
    duration: float = parameter(0.0, "s", least=0.0)
    max_velocity: PerJoint | None = joint_parameter(None, "m/s, rad/s")
    max_acceleration: PerJoint | None = joint_parameter(None, "m/s^2, rad/s^2")
    lower: PerJoint | None = joint_parameter(None, "m, rad")
    upper: PerJoint | None = joint_parameter(None, "m, rad")
    hold_gain: float = parameter(3.0, "1/s", least=0.0, most=MAX_GAIN)
    posture: Mapping[str, float] = parameter({}, "m, rad")
    posture_gain: float = parameter(1.0, "1/s", least=0.0, most=MAX_GAIN)
    limit_avoidance: bool = parameter(True)
    singularity_avoidance: bool = parameter(False)
    elbow: PerJoint | None = joint_parameter(None)
    lead: PerJoint = copy_loop_parameter("lead")
    lag: float = copy_loop_parameter("lag")
    approach_speed: float = copy_loop_parameter("approach_speed")
    delay: float = copy_loop_parameter("delay")
    watchdog: float = copy_loop_parameter("watchdog")
    wall_watchdog: float = parameter(5.0, "s", above=0.0)
    scheme_timeout: float = copy_loop_parameter("scheme_timeout")
    stop_time: float = copy_loop_parameter("stop_time")
    output: str = copy_loop_parameter("output")
    stiffness: PerJoint = copy_loop_parameter("stiffness")
    damping: PerJoint = copy_loop_parameter("damping")
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

    def get_camera(self, name: str) -> CameraEntry:
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

    def check_cameras(self, where: str) -> None:
        """ConfigurationError for two cameras of one topic: they would be one."""
        for key, topic in (("namespace", "image_raw"), ("features", "moments")):
            heard: dict[str, str] = {}
            for name in self.cameras:
                space = getattr(self.get_camera(name), key)
                if (other := heard.setdefault(space, name)) != name:
                    raise ConfigurationError(
                        f"{where}cameras: {other} and {name} both listen to {space}/{topic}: give "
                        f"each a {key} of its own"
                    )


def expand_per_joint(name: str, value: Any, arm: Arm) -> Any:
    """One number, or numbers in the arm's order, from what may be given by joint name."""
    if not isinstance(value, Mapping):
        return value
    for joint in value:
        if joint not in arm.names:
            raise ConfigurationError(
                f"parameter ~{name} names the joint {joint}: {suggest(joint, arm.names)}"
            )
    other = get_default(Parameters.__dataclass_fields__[name])
    return tuple(float(value.get(joint, other)) for joint in arm.names)
