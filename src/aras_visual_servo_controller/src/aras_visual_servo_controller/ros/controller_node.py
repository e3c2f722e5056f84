"""ROS interface of the controller node: it creates the control loop and supervises it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import rospy

from aras_visual_servo_base.urdf import read_robot_name
from aras_visual_servo_ros.shutdown import iterate_at_period

from ..runner.loop_runner import LoopRunner
from ..settings import ControllerSettings
from .description import DescriptionWatch, find_e_stop_topic
from .goal_publishers import GoalPublishers
from .loop_services import LoopServices
from .loop_subscribers import LoopSubscribers
from .reconfigure import GainServer
from .ros_publisher import RosPublisher

if TYPE_CHECKING:
    from aras_visual_servo_camera.camera_node import CameraNode

WATCH_PERIOD = 0.02  # wall time between two checks of the robot description and of the timeouts, s
SHUTDOWN_TIME = 0.2  # wall time that rospy's threads get for sending the last messages, s


class ControllerNode:
    """The node, which creates the loop when the robot description is available, and supervises it.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        raw_settings: dict[str, object],
        camera: CameraNode | None = None,
    ) -> None:
        """Create the node without a loop.

        Args:
            settings: settings of the loop.
            raw_settings: parameters that the user has given.
            camera: camera node that runs in this process, or None.
        """
        self._camera = camera
        self._settings, self._raw_settings = settings, raw_settings
        self.runner: LoopRunner | None = None
        self.publisher: RosPublisher | None = None
        self._loop_services: LoopServices | None = None
        self._description = DescriptionWatch(settings.description)
        self._goal_publishers = GoalPublishers(settings.namespace.rstrip("/"))

    def build_loop(self, urdf: str) -> None:
        """Create the loop and its topics.

        Raises:
            ConfigurationError: the settings do not fit the robot.
        """
        settings = self._settings.for_robot(read_robot_name(urdf), self._raw_settings)
        arm = settings.make_arm(urdf)
        others = settings.make_other_cameras(urdf, arm)
        servo = settings.make_servo(arm, clock=time.thread_time, other_cameras=others)
        if self.runner is not None:
            self._inputs.close()
        before, self.publisher = self.publisher, RosPublisher(settings, arm.names, arm.camera_frame)
        if before is not None:
            # The old topics are closed last. A topic that is closed and reopened at the same time
            # can lose its subscribers.
            before.close()
        arms = {settings.list_cameras(servo.scheme)[0]: arm, **others}
        rig = settings.make_camera_rig(arms, servo.scheme, servo.goal)
        foreign = self.publisher.foreign_commands
        self.runner = LoopRunner(
            servo, rig, settings, self.publisher, rospy.get_time, foreign=foreign
        )
        self.publisher.wait_for_listeners()
        rospy.loginfo(
            "scheme %s, start %s, goal %s; frame %s is moved by the joints %s", settings.scheme,
            settings.start, settings.find_goal_file(), arm.camera_frame, ", ".join(arm.names),
        )  # fmt: skip
        if self._loop_services is None:
            self._loop_services = LoopServices(settings.namespace.rstrip("/"), self)
            self._gain_server = GainServer(self)
        self._goal_publishers.publish(servo)
        self._inputs = LoopSubscribers(
            settings, self.runner, find_e_stop_topic(urdf, settings.namespace), self._camera
        )

    def spin(self) -> None:
        """Supervise the loop until ROS shuts down.

        The loop is checked at intervals of wall time, because simulated time can stop.

        Raises:
            ConfigurationError: the settings do not fit a robot.
        """
        for _ in iterate_at_period(WATCH_PERIOD):
            start_count = None if self.runner is None else self.runner.start_count
            if urdf := self._description.find_new(start_count):
                self.build_loop(urdf)
            if self.runner is not None:
                self.runner.check_timeouts()
            if self._camera is not None:
                self._camera.check_images()

    def close(self) -> None:
        """Command zero velocities or efforts, if these are the output of the loop."""
        if self.runner is not None and self.runner.settings.output != "position":
            self._inputs.close()
            self.runner.shut_down("the node ends")
            time.sleep(SHUTDOWN_TIME)
