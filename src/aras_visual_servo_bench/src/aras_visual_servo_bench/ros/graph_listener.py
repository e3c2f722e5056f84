"""Subscribers of one robot's topics, which update the RunDrawing of its run.

The trace restarts when another robot is spawned or the clock is reset.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence

import genpy
import numpy as np
import rosgraph
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from aras_visual_servo_controller.msg import ServoReport, ServoState
from geometry_msgs.msg import PolygonStamped, PoseStamped
from sensor_msgs.msg import CameraInfo, JointState

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros.conversions import from_pose
from aras_visual_servo_base.urdf import read_robot_name
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.messages import read_outline_message
from aras_visual_servo_controller.errors import MeasurementError
from aras_visual_servo_controller.records.state import ServoState as State
from aras_visual_servo_controller.ros.description import DescriptionWatch
from aras_visual_servo_controller.ros.node_settings import find_package_folder
from aras_visual_servo_controller.ros.recorded_messages import read_state
from aras_visual_servo_controller.settings import ControllerSettings

from ..visualization.run_drawing import NO_STATE, RunDrawing
from .real_time_factor import RealTimeFactor

# Time without a joint state after which the real-time factor is unknown, s of wall time.
SILENCE_TIMEOUT = 2.0
HOW_TO_START = (
    "To start a simulation: roslaunch aras_visual_servo_gazebo aras_visual_servo.launch "
    "dashboard:=true (it prints the address of a new page)"
)


class GraphListener:
    """Subscribers of one robot's topics, which store the latest values and a trace of the run.

    Attributes:
        on_state: function that is called with each state of the controller and its joint positions;
            None for no function.
        robot_name: name of the robot.
        robot_count: number of robots since the start, including the current robot.
        run_trace: trace of the run; None if there is no robot.
        urdf: description of the robot; '' if there is no robot.
        restart_count: number of new robots and of clock resets since the start.
        positions, velocities: (n,) latest joint positions and velocities in the order of the arm's
            joints; None before the first joint state.
        stamp: stamp of the latest joint state, s.
        no_target_reason: why the target is not detected in the latest image; '' if it is.
        joints_topic: topic of the joint states.
    """

    def __init__(self, settings: ControllerSettings) -> None:
        """Subscribe to the robot's topics.

        settings: settings of the controller, which define the names of the topics.
        """
        self.settings = settings
        self.on_state: Callable[[State, Sequence[float]], None] | None = None
        self.robot_name, self.robot_count = "", 0
        self.run_trace: RunDrawing | None = None
        self.urdf = ""
        self.restart_count = 0
        self.positions: np.ndarray | None = None
        self.velocities: np.ndarray | None = None
        self.report: ServoReport | None = None
        self.stamp = 0.0
        self.no_target_reason = ""
        self.lock = threading.RLock()
        self._description = DescriptionWatch(settings.description)
        self._real_time_factor = RealTimeFactor()
        self._joints_message, self._last_joints_time = b"", -math.inf
        self._goal: np.ndarray | None = None
        self._outline = np.zeros((0, 2))
        self._camera: CameraModel | None = None
        space = settings.namespace.rstrip("/")
        self.joints_topic = f"{space}/joint_states"
        # Joint states arrive at 100 Hz. To save time, `refresh` deserializes only the latest one.
        self._joints_subscriber = rospy.Subscriber(
            self.joints_topic, rospy.AnyMsg, self._on_joints, queue_size=1, tcp_nodelay=True
        )
        for topic, kind, callback, queue_size in (
            (f"{space}/controller/state", ServoState, self._on_state, 10),
            (f"{space}/controller/diagnosis", ServoReport, self._on_report, 1),
            (f"{space}/controller/goal", PoseStamped, self._on_goal, 1),
            (f"{space}/controller/desired_outline", PolygonStamped, self._on_outline, 1),
            (f"{space}/camera/moments", ImageMoments, self._on_moments, 10),
            (f"{settings.camera_namespace.rstrip('/')}/camera_info", CameraInfo, self._on_info, 1),
        ):
            rospy.Subscriber(topic, kind, callback, queue_size=queue_size, tcp_nodelay=True)

    def update(self) -> RunDrawing | None:
        """Check whether another robot was spawned, and return the updated trace.

        Return None if there is no robot.

        Raises:
            ConfigurationError: the robot description is invalid.
        """
        watched = None if self.run_trace is None else self.restart_count
        if urdf := self._description.find_new(watched):
            name = read_robot_name(urdf)
            arm = self.settings.for_robot(name, ()).make_arm(urdf)
            with self.lock:
                self.urdf, self.run_trace, self.robot_name = urdf, RunDrawing(arm), name
                self.robot_count += 1
                self.positions = self.velocities = None
                self.restart_count += 1
        return self.refresh()

    def refresh(self) -> RunDrawing | None:
        """Return the trace, updated from the latest messages; return None if there is no robot."""
        trace = self.run_trace
        if trace is None:
            return None
        with self.lock:
            trace.goal, trace.outline, trace.camera = self._goal, self._outline, self._camera
            self._read_joints(trace)
            trace.factor = None if self.is_silent else self._real_time_factor.factor
        return trace

    @property
    def is_silent(self) -> bool:
        """True if no joint state has arrived for the time SILENCE_TIMEOUT."""
        return time.monotonic() - self._last_joints_time > SILENCE_TIMEOUT

    def find_missing(self) -> str:
        """Return what the graph lacks and why, as text; '' if a robot sends joint states."""
        parameter, topic = self.settings.description, self.joints_topic
        try:
            has_description = rospy.has_param(parameter)
        except OSError:
            return (
                f"The ROS master at {rosgraph.get_master_uri()} does not answer: the simulation "
                f"has ended, or the network is interrupted. {HOW_TO_START}"
            )
        if not has_description and self.is_silent:
            return (
                f"There is no robot: parameter {parameter} is not set, because no simulation runs "
                f"or its robot was removed. {HOW_TO_START}"
            )
        if not self.is_silent:
            return ""
        if not self._joints_subscriber.get_num_connections():
            return (
                f"No node publishes the joint states ({topic}): the simulation has ended, or its "
                f"joint state controller is not loaded. {HOW_TO_START}"
            )
        return f"No joint states arrive on {topic}: the simulation is paused (press Resume)."

    def clear_controller(self) -> None:
        """Delete the last state and diagnosis of the controller after its node has ended."""
        with self.lock:
            self.report = None
            if self.run_trace is not None:
                self.run_trace.state = NO_STATE

    def _read_joints(self, run_trace: RunDrawing) -> None:
        content, self._joints_message = self._joints_message, b""
        if not content:
            return
        message = JointState()
        try:
            message.deserialize(content)
            sample = run_trace.arm.read_joints(message.name, message.position, message.velocity)
        except (MeasurementError, genpy.MessageException, ValueError):
            return  # ignore an invalid message or one of another type; the controller reports it
        stamp = message.header.stamp.to_sec()
        if stamp < self.stamp:
            run_trace.clear()
            self.restart_count += 1
        self.stamp = stamp
        self._real_time_factor.add(time.monotonic(), stamp)
        self.positions, self.velocities = sample.positions, sample.velocities
        run_trace.set_joints(sample.positions)

    def _on_joints(self, message: rospy.AnyMsg) -> None:
        self._last_joints_time, self._joints_message = time.monotonic(), message._buff

    def _on_report(self, message: ServoReport) -> None:
        self.report = message

    def _on_state(self, message: ServoState) -> None:
        report = self.report
        same = report is not None and report.phase == message.phase
        state = read_state(message, report if same else None)
        with self.lock:
            if self.run_trace is not None:
                joints = ()
                if state.joints is not None and state.joints.names == self.run_trace.arm.names:
                    joints = state.joints.positions
                self.run_trace.add_state(state, joints)
                if self.on_state is not None:
                    self.on_state(state, joints)

    def _on_goal(self, message: PoseStamped) -> None:
        with contextlib.suppress(WorldError):  # ignore a pose with invalid numbers
            self._goal = from_pose(message.pose, "goal", zero_is_identity=False).matrix()

    def _on_outline(self, message: PolygonStamped) -> None:
        with contextlib.suppress(VisionError):
            self._outline = np.array(read_outline_message(message)).reshape(-1, 2)

    def _on_moments(self, message: ImageMoments) -> None:
        self.no_target_reason = "" if message.valid else message.reason
        if message.valid and len(message.m) > 2 and message.m[0] > 0.0:
            with self.lock:
                if self.run_trace is not None:
                    x, y = message.m[1] / message.m[0], message.m[2] / message.m[0]
                    self.run_trace.add_image_point("centre", x, y)

    def _on_info(self, message: CameraInfo) -> None:
        # ignore invalid intrinsics, because the camera node reports them
        with contextlib.suppress(VisionError):
            self._camera = CameraModel.from_message(message)


def make_listener_settings(parameters: dict[str, object]) -> ControllerSettings:
    """Return the settings of the controller whose topics a node subscribes to.

    parameters: parameters of this node.

    Raises:
        ConfigurationError: a parameter is invalid.
    """
    return ControllerSettings.from_mapping(parameters, find_package_folder())
