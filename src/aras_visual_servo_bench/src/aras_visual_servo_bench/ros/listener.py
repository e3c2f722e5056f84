"""Tells a Story what a graph says; begins anew with another robot, or a clock that goes back."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence

import genpy
import numpy as np
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from aras_visual_servo_controller.msg import ServoReport, ServoState
from geometry_msgs.msg import PolygonStamped, PoseStamped
from sensor_msgs.msg import CameraInfo, JointState

from aras_visual_servo_base.poses import Pose, normalised
from aras_visual_servo_base.urdf import robot_name
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.messages import outline_of
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.errors import MeasurementError
from aras_visual_servo_controller.records.state import ServoState as State
from aras_visual_servo_controller.ros.description import DescriptionWatch
from aras_visual_servo_controller.ros.given import package
from aras_visual_servo_controller.ros.read_back import state_of
from aras_visual_servo_controller.settings import Settings

from ..drawing.story import NOTHING, Story
from ..drawing.track import Pace

SILENCE = 2.0  # s of wall time without a joint state after which nothing is known of the pace


class Listener:
    """Subscribers of one robot's topics, and the story that they tell."""

    def __init__(self, settings: Settings) -> None:
        """`settings`: where the controller's topics, camera and description are."""
        self.settings = settings
        self.hear: Callable[[State, Sequence[float]], None] | None = None  # of each state
        self.robot, self.robots = "", 0  # its name, and how many there have been
        self.story: Story | None = None
        self.urdf = ""
        self.beginnings = 0  # how often the robot, or its clock, began anew
        self.positions: np.ndarray | None = None  # (n,) of the joints, in the arm's order
        self.velocities: np.ndarray | None = None
        self.report: ServoReport | None = None
        self.stamp = 0.0  # of the latest joint states, s
        self.unseen = ""  # why the latest image shows no target; '' where it does
        self.lock = threading.RLock()
        self._description = DescriptionWatch(settings.description)
        self._pace, self._joints, self._heard = Pace(), b"", -math.inf
        self._goal: np.ndarray | None = None
        self._outline = np.zeros((0, 2))
        self._camera: CameraModel | None = None
        space = settings.namespace.rstrip("/")
        for topic, kind, hear, many in (
            # Not read before somebody looks: they come a hundred times a second.
            (f"{space}/joint_states", rospy.AnyMsg, self._on_joints, 1),
            (f"{space}/controller/state", ServoState, self._on_state, 10),
            (f"{space}/controller/diagnosis", ServoReport, self._on_report, 1),
            (f"{space}/controller/goal", PoseStamped, self._on_goal, 1),
            (f"{space}/controller/desired_outline", PolygonStamped, self._on_outline, 1),
            (f"{space}/camera/moments", ImageMoments, self._on_moments, 10),
            (f"{settings.camera_namespace.rstrip('/')}/camera_info", CameraInfo, self._on_info, 1),
        ):
            rospy.Subscriber(topic, kind, hear, queue_size=many, tcp_nodelay=True)

    def look(self) -> Story | None:
        """The story, with the joints where they are now; None while there is no robot.

        Raises:
            ConfigurationError: a description that cannot be used.
        """
        watched = None if self.story is None else self.beginnings
        if urdf := self._description.new(watched):
            name = robot_name(urdf)
            arm = self.settings.for_robot(name, ()).arm(urdf)
            with self.lock:
                self.urdf, self.story, self.robot = urdf, Story(arm), name
                self.robots += 1
                self.positions = self.velocities = None
                self.beginnings += 1
        return self.look_again()

    def look_again(self) -> Story | None:
        """The same without looking for another robot."""
        story = self.story
        if story is None:
            return None
        with self.lock:
            story.goal, story.outline, story.camera = self._goal, self._outline, self._camera
            self._read_joints(story)
            silent = time.monotonic() - self._heard > SILENCE
            story.factor = None if silent else self._pace.factor
        return story

    def forget(self) -> None:
        """No controller is there any more: what it told last holds no longer."""
        with self.lock:
            self.report = None
            if self.story is not None:
                self.story.told = NOTHING

    def _read_joints(self, story: Story) -> None:
        content, self._joints = self._joints, b""
        if not content:
            return
        message = JointState()
        try:
            message.deserialize(content)
            sample = story.arm.sample(message.name, message.position, message.velocity)
        except (MeasurementError, genpy.MessageException, ValueError):
            return  # the controller says so; what is on the topic may be of any type
        stamp = message.header.stamp.to_sec()
        if stamp < self.stamp:
            story.clear()
            self.beginnings += 1
        self.stamp = stamp
        self._pace.add(time.monotonic(), stamp)
        self.positions, self.velocities = sample.positions, sample.velocities
        story.joints(sample.positions)

    def _on_joints(self, message: rospy.AnyMsg) -> None:
        self._heard, self._joints = time.monotonic(), message._buff

    def _on_report(self, message: ServoReport) -> None:
        self.report = message

    def _on_state(self, message: ServoState) -> None:
        report = self.report
        same = report is not None and report.phase == message.phase
        told = state_of(message, report if same else None)
        with self.lock:
            if self.story is not None:
                ours = told.joints is not None and told.joints.names == self.story.arm.names
                joints = told.joints.positions if ours else ()
                self.story.say(told, joints)
                if self.hear is not None:
                    self.hear(told, joints)

    def _on_goal(self, message: PoseStamped) -> None:
        place, turn = message.pose.position, message.pose.orientation
        with contextlib.suppress(ZeroDivisionError):  # a quaternion of no length
            quat = normalised((turn.x, turn.y, turn.z, turn.w))
            pose = Pose((place.x, place.y, place.z), quat).matrix()
            if np.isfinite(pose).all():
                self._goal = pose

    def _on_outline(self, message: PolygonStamped) -> None:
        with contextlib.suppress(VisionError):
            self._outline = np.array(outline_of(message)).reshape(-1, 2)

    def _on_moments(self, message: ImageMoments) -> None:
        self.unseen = "" if message.valid else message.reason
        if message.valid and len(message.m) > 2 and message.m[0] > 0.0:
            with self.lock:
                if self.story is not None:
                    x, y = message.m[1] / message.m[0], message.m[2] / message.m[0]
                    self.story.see("centre", x, y)

    def _on_info(self, message: CameraInfo) -> None:
        with contextlib.suppress(VisionError):  # the camera node says what is wrong with it
            self._camera = CameraModel.from_message(message)


def listener_settings(given: dict[str, object]) -> Settings:
    """Settings of a node that listens: of its parameters those that say where the robot is.

    Raises:
        ConfigurationError: one line for a parameter that cannot be.
    """
    return Settings.from_mapping(given, package())
