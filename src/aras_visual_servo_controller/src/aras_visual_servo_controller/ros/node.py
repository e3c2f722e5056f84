"""The controller node: one driver, its faces, and a thread that watches."""

from __future__ import annotations

import time

import rospy

from aras_visual_servo_base.compiled import compile_all
from aras_visual_servo_base.urdf import robot_name
from aras_visual_servo_ros.shutdown import beats, node_main

from ..driving.driver import Driver
from ..errors import ConfigurationError
from ..settings import Settings
from .control import Control
from .description import DescriptionWatch, e_stop_topic
from .face import RosFace
from .given import given_settings
from .goal_topics import GoalTopics
from .inputs import Inputs
from .reconfigure import GainServer

WATCH_PERIOD = 0.02  # s of wall time
LAST_WORDS = 0.2  # s of wall time: rospy sends from threads of its own


class ControllerNode:
    """Builds the loop when the robot's description is there, and watches it."""

    def __init__(self, settings: Settings, given: dict[str, object]) -> None:
        self._settings, self._given = settings, given
        self.driver: Driver | None = None
        self.face: RosFace | None = None
        self._control: Control | None = None
        self._description = DescriptionWatch(settings.description)
        self._goal = GoalTopics(settings.namespace.rstrip("/"))

    def build(self, urdf: str) -> None:
        """The loop and its faces; ConfigurationError for what cannot be."""
        settings = self._settings.for_robot(robot_name(urdf), self._given)
        arm = settings.arm(urdf)
        others = settings.others(urdf, arm)
        servo = settings.build(arm, clock=time.thread_time, others=others)
        if self.driver is not None:
            self._inputs.close()
        before, self.face = self.face, RosFace(settings, arm.names, arm.camera_frame)
        if before is not None:
            # Only now: subscribers may miss a topic that is closed and opened again at once.
            before.close()
        arms = {settings.read_by(servo.scheme)[0]: arm, **others}
        rig = settings.rig(arms, servo.scheme, servo.goal)
        self.driver = Driver(
            servo, rig, settings, self.face, rospy.get_time, foreign=self.face.foreign
        )
        self.face.await_listeners()
        rospy.loginfo(
            "scheme %s, start %s, goal %s; %s moved by %s", settings.scheme, settings.start,
            settings.goal_path(), arm.camera_frame, ", ".join(arm.names),
        )  # fmt: skip
        if self._control is None:
            self._control = Control(settings.namespace.rstrip("/"), self)
            self._gains = GainServer(self)
        self._goal.announce(servo)
        self._inputs = Inputs(settings, self.driver, e_stop_topic(urdf, settings.namespace))

    def spin(self) -> None:
        """Watch until ROS shuts down, on wall time: simulated time may stop.

        Raises:
            ConfigurationError: a robot that no loop can be built for.
        """
        for _ in beats(WATCH_PERIOD):
            began = None if self.driver is None else self.driver.beginnings
            if urdf := self._description.new(began):
                self.build(urdf)
            if self.driver is not None:
                self.driver.watch()

    def close(self) -> None:
        """Leave no speed and no effort behind."""
        if self.driver is not None and self.driver.settings.output != "position":
            self._inputs.close()
            self.driver.end("the node ends")  # in whatever thread it still answers or watches
            time.sleep(LAST_WORDS)


def main() -> int:
    """Run the node; returns its exit status."""
    compile_all()
    return node_main("aras_visual_servo_controller", __doc__, _run, ConfigurationError)


def _run() -> None:
    node = ControllerNode(*given_settings())
    rospy.on_shutdown(node.close)
    node.spin()
