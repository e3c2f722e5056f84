"""The controller node: one driver, its faces, and a thread that watches."""

from __future__ import annotations

import sys
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import rospkg
import rospy

from aras_visual_servo_ros.master_watch import MasterWatch
from aras_visual_servo_ros.shutdown import end_on_signals

from ..driver import Driver
from ..errors import ConfigurationError
from ..goal import Goal
from ..settings import Settings
from .control import Control
from .face import RosFace
from .inputs import Inputs
from .reconfigure import NAMESPACE as GAINS
from .reconfigure import GainServer

WATCH_PERIOD = 0.02  # s of wall time
# s of wall time: rospy sends from threads of its own, and closes the topics after the last hook
LAST_WORDS = 0.2


class ControllerNode:
    """Builds the loop when the robot's description is there, and watches it."""

    def __init__(self, settings: Settings, given: dict[str, object]) -> None:
        self._settings, self._given = settings, given
        self._master = MasterWatch(rospy.get_name())
        self.driver: Driver | None = None
        self.face: RosFace | None = None
        self._control: Control | None = None
        self._urdf = self._waited = ""
        self._beginnings, self._looked = 0, -1e9

    def build(self, urdf: str) -> None:
        """The loop and its faces; ConfigurationError for what cannot be."""
        try:
            name = ElementTree.fromstring(urdf).get("name", "")
        except ElementTree.ParseError:
            name = ""  # what is wrong with it, the arm says
        settings = self._settings.for_robot(name, self._given)
        arm = settings.arm(urdf)
        servo = settings.build(arm, clock=time.thread_time)
        if self.driver is not None:
            self._inputs.close()
            self.face.close()
        self._urdf, self._beginnings = urdf, 0
        self.face = RosFace(settings, arm.names)
        observer = settings.observer(arm, servo.scheme)
        self.driver = Driver(servo, observer, settings, self.face, rospy.get_time)
        self.face.await_listeners()
        rospy.loginfo(
            "scheme %s, start %s, goal %s; %s moved by %s", settings.scheme, settings.start,
            settings.goal_path(), arm.camera_frame, ", ".join(arm.names),
        )  # fmt: skip
        if self._control is None:
            self._control = Control(settings.namespace.rstrip("/"), self)
            self._gains = GainServer(self)
        self._inputs = Inputs(settings, self.driver)

    def spin(self) -> int:
        """Watch until ROS shuts down, on wall time: simulated time may stop. Exit status."""
        while not rospy.is_shutdown():
            if reason := self._master.lost():
                # Logging goes through rosout, which needs the master: say it directly.
                print(f"{rospy.get_name()[1:]}: {reason}: ending", file=sys.stderr)
                rospy.signal_shutdown(reason)
                break
            try:
                self._look_for_robot()
                if self.driver is not None:
                    self.driver.watch()
            except ConfigurationError as error:
                rospy.logfatal("%s", error)
                return 1
            time.sleep(WATCH_PERIOD)
        return 0

    def close(self) -> None:
        """Leave no speed and no effort behind."""
        if self.driver is not None and self._settings.output != "position":
            self._inputs.close()  # nothing that still comes in may answer after the zeros
            self.driver.stop("the node ends")
            self.face.put(np.zeros(len(self.face.names)))
            time.sleep(LAST_WORDS)

    def _look_for_robot(self) -> None:
        """Build when there is a robot, and anew when another one begins to send joint states."""
        began = 0 if self.driver is None else self.driver.beginnings
        now = time.monotonic()
        if self.driver is not None and began == self._beginnings or now - self._looked < 0.2:
            return
        self._looked = now
        try:
            urdf = str(rospy.get_param(self._settings.description, ""))
        except OSError:
            return  # the master is gone: `spin` will say so
        if urdf and urdf != self._urdf:
            self.build(urdf)
        elif not urdf and not self._waited:
            self._waited = f"no robot description on parameter {self._settings.description} yet"
            rospy.logwarn("waiting: %s", self._waited)
        else:
            self._beginnings = began


def main() -> int:
    """Run the node; returns its exit status."""
    rospy.init_node("aras_visual_servo_controller")
    end_on_signals()
    package = Path(rospkg.RosPack().get_path("aras_visual_servo_controller"))
    try:
        given = rospy.get_param("~", {})
        given.pop(GAINS[1:], None)
        given.setdefault("lockstep", rospy.get_param("/gazebo/speed_mode", "") == "lockstep")
        settings = Settings.from_mapping(given, package)
        settings.make_scheme()  # what is wrong with it needs no robot to be told
        if settings.desired != "auto":
            Goal.load(settings.goal_path())
    except ConfigurationError as error:
        rospy.logfatal("%s", error)
        return 1
    node = ControllerNode(settings, given)
    rospy.on_shutdown(node.close)
    return node.spin()
