"""Parameters of the controller, each with its unit and default."""

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

# Parameters that accept a mapping from joint names to values.
BY_JOINT = ("max_velocity", "max_acceleration", "lower", "upper", "posture", "elbow", "lead",
            "stiffness", "damping", "controllers")  # fmt: skip
MODEL_TRACKER = "model"  # name of the tracker that measures the pose of a known mesh
# Name of the tracker that detects an ArUco or AprilTag marker, or a board of markers.
MARKER_TRACKER = "marker"
# Parameters of the controller that are also parameters of a tracker.
TRACKER_PARAMETERS = ("marker", "model", "model_scale", "model_start")
OUTLINE_TRACKER = "outline"  # name of the tracker that uses the corners of the segmented outline
# Parameters whose values are ROS graph names.
GRAPH_NAMES = ("namespace", "camera_namespace", "command_topic", "description")
LEGAL_NAME = re.compile(r"[~/]?[A-Za-z][\w/]*", re.ASCII)


def copy_loop_parameter(name: str) -> Any:
    """Declare a parameter with the default, unit and bounds of the ServoSettings field `name`."""
    field = ServoSettings.__dataclass_fields__[name]
    return parameter(field.default, **field.metadata)


@dataclass(frozen=True)
class CameraEntry:
    """Frame and topics of one camera, for nodes with several cameras.

    frame: optical frame of the camera in the robot description; if empty, NAME_optical_frame.
    namespace: namespace of image_raw, camera_info and depth/image_raw; if empty, /NAME.
    features: namespace in which a camera node publishes moments and kernel features of this camera;
        if empty, camera/NAME in the namespace of the arm.
    target_frame: link that carries the target of this camera, if the arm moves the target; if
        empty, the target_frame of the node.
    """

    frame: str = ""
    namespace: str = ""
    features: str = ""
    target_frame: str = ""


@dataclass(frozen=True)
class ControllerParameters:
    """Parameters of the control loop and its node; lengths in m, angles in rad.

    A parameter of the joints is one number for all joints, a list with a number for each joint in
    the order of the arm, or a mapping from joint names to numbers. ServoSettings describes the
    parameters of the loop itself.

    scheme: name of a scheme or feature, several features joined by '+', or 'package.module:Class'.
    interaction: interaction matrix of the scheme: current, desired, mean or estimated.
    tracker: tracker that finds the points of the target: outline, another tracker's name, or
        'package.module:Class'.
    tracker_options: other parameters of the tracker, by name.
    marker: marker that is the target: a number such as 5, a dictionary and number such as
        DICT_5X5_100:5, or a board; if empty, the marker of the goal.
    model: mesh file of the target (STL, OBJ, DAE), in m; the tracker 'model' tracks its pose.
    model_scale: factor on the lengths of the mesh file; 0.001 for a file in mm.
    model_start: initial pose of the mesh: {pose: x y z roll pitch yaw in the base}, {marker: {size,
        pose}} or {clicks: rows x y z u v}.
    segmentation: method that finds the pixels of the target: {method, threshold, near_colour,
        label, ...}, with the same keys as in the camera node.
    depth_image: take the plane of the target from the camera's depth image instead of the goal and
        the kinematics.
    weights: for a scheme with several features, one weight for each; if empty, all weights are
        equal.
    smoothing: s, time constant of a low-pass filter on the errors; 0 for no filter.
    law: name of a control law, or 'package.module:Class'.
    gain: 1/s, gain of the law; none for the default of the law.
    law_options: other parameters of the law, by name.
    continuous_start: 1/s, rate at which the camera velocity rises from 0 at the start; 0 for a
        velocity step.
    ramp: s, time constant with which the gain rises at the start; 0 for no ramp.
    start: initial pose: a name from config/starts.yaml, joint positions, the camera pose {xyz,
        rpy}, or none to start at the present pose. For a camera pose, the joint positions nearest
        to those at the goal are used.
    desired: goal: the name of a goal, a YAML file, or auto for the goal with the same name as
        `start`, or for the goal 2016 if there is none.
    duration: s, servoing time after which the run ends with the outcome timed_out; 0 for no limit.
    max_velocity: m/s, rad/s, maximum speed of each joint; none for the speed limit in the robot
        description.
    max_acceleration: m/s^2, rad/s^2, maximum acceleration of each joint; none for no limit.
    lower: m, rad, lower position limit of each joint; none for the limit in the robot description.
    upper: m, rad, upper position limit of each joint; none for the limit in the robot description.
    hold_gain: 1/s, gain with which the camera returns to the goal's pose in directions that the
        scheme does not control.
    posture: m, rad, joint positions by joint name, to which a secondary task attracts the joints.
    posture_gain: 1/s, gain of the secondary task `posture`.
    limit_avoidance: use a secondary task that keeps joints away from their limits.
    singularity_avoidance: use a secondary task that increases the manipulability of the arm.
    elbow: side to which stretched elbows bend: -1 or 1 for all elbows, or for each by joint name.
    wall_watchdog: s, wall time without a processed image after which the arm is stopped.
    scheme_timeout: s, wall time that one call of the scheme's code may take; the arm is then held
        as after an error of the scheme.
    camera_frame: frame of the camera in the robot description.
    cameras: several cameras by name, instead of camera_frame and camera_namespace: see CameraEntry.
    base_frame: link that is the arm's base; if empty, the root link.
    target_frame: link that carries the target, if the arm moves the target.
    joints: names of the joints to use; if empty, all joints that move the camera.
    namespace: namespace of joint states, features and commands.
    camera_namespace: namespace of image_raw, camera_info and depth/image_raw, for schemes that need
        images.
    controllers: name of each joint's controller, in `namespace`.
    command_topic: command topic of a controller for the whole group of joints, instead of one topic
        for each joint.
    description: name of the ROS parameter that contains the URDF.
    listeners: number of subscribers of controller/state that the node waits for at its start, for
        at most 5 s.
    image_timeout: s, time without images before the node reports it.
    joint_timeout: s, time without joint states before the node reports it.
    lockstep: send one command for each image. The default is true if the speed_mode of the
        simulator is lockstep.
    autostart: start servoing immediately; if false, wait for the service `start` or the action
        `servo_to_target`.
    dry: send no commands, for example to try a scheme on a recorded bag.
    package: directory of this package.
    """

    scheme: str = parameter("moments", name=True)
    interaction: str = parameter("current")
    tracker: str = parameter(OUTLINE_TRACKER)
    tracker_options: Mapping[str, Any] = parameter({})
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
        """Return the frame and the topics of the camera `name`, with all defaults filled in."""
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
        """Raise ConfigurationError if two cameras would use the same topic."""
        for key, topic in (("namespace", "image_raw"), ("features", "moments")):
            used_by: dict[str, str] = {}
            for name in self.cameras:
                namespace = getattr(self.get_camera(name), key)
                if (other := used_by.setdefault(namespace, name)) != name:
                    raise ConfigurationError(
                        f"{where}cameras: {other} and {name} both listen to {namespace}/{topic}: "
                        f"give each its own value of `{key}`"
                    )


def expand_per_joint(name: str, value: Any, arm: Arm) -> Any:
    """Return the value of a parameter that has one number for all joints or one for each joint.

    A mapping of joint names to numbers becomes a tuple in the order of `arm.names`; joints that it
    does not name have the default of the parameter. Any other `value` is returned unchanged.

    Raises:
        ConfigurationError: the mapping names a joint that the arm does not have.
    """
    if not isinstance(value, Mapping):
        return value
    for joint in value:
        if joint not in arm.names:
            raise ConfigurationError(
                f"parameter ~{name} has the unknown joint {joint}: {suggest(joint, arm.names)}"
            )
    other = get_default(ControllerParameters.__dataclass_fields__[name])
    return tuple(float(value.get(joint, other)) for joint in arm.names)
