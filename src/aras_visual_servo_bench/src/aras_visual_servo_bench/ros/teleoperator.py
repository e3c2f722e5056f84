"""The arm driven by hand, by whoever asks: a thread that sends what a Jog says."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import rospy

from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.kinematics import DifferentialIK
from aras_visual_servo_controller.ros.commands import CommandTopics, stop_controller
from aras_visual_servo_controller.settings import Settings
from aras_visual_servo_controller.teleop.jog import Jog

from ..errors import RefusedError
from .graph_listener import GraphListener

PERIOD = 0.02  # s of wall time between two commands


class Teleoperator:
    """One person's hand on one robot."""

    def __init__(self, listener: GraphListener, settings: Settings) -> None:
        self._listener, self._settings = listener, settings
        self._lock = threading.Lock()
        self._jog: Jog | None = None
        self._topics: CommandTopics | None = None
        self._wake = threading.Event()
        threading.Thread(target=self._run, name="driving", daemon=True).start()

    def move_camera(self, twist: Sequence[float]) -> str:
        """Move the camera in its own frame, (6,) m/s and rad/s, for a moment."""
        jog = self._start_jog() if any(twist) else self._jog
        if jog is None:
            return ""
        with self._lock:
            jog.set_twist(twist, time.monotonic())
        self._wake.set()
        return jog.reason

    def move_joint(self, name: str, fraction: float) -> str:
        """Move one joint with a part of its greatest speed, for a moment."""
        jog = self._start_jog()
        with self._lock:
            jog.set_joint_speed(name, fraction, time.monotonic())
        self._wake.set()
        return jog.reason

    def _start_jog(self) -> Jog:
        """The jog of the robot that is there now, the controller being stopped."""
        story = self._listener.run_trace
        if story is None or self._listener.positions is None:
            raise RefusedError("there are no joint states: is the robot there?")
        if story.state.phase not in ("", "stopped"):
            stop_controller(self._settings.namespace.rstrip("/"))
        if self._jog is None or self._jog.arm is not story.arm:
            settings = self._settings.for_robot(self._listener.robot_name, ())
            limits = settings.make_limits(story.arm)
            try:
                topics = CommandTopics(settings, story.arm.names, "position")
            except ConfigurationError as error:
                raise RefusedError(str(error)) from None
            with self._lock:
                if self._topics is not None:
                    self._topics.close()
                self._jog = Jog(story.arm, limits, DifferentialIK(story.arm, limits))
                self._topics = topics
        return self._jog

    def _run(self) -> None:
        while not rospy.is_shutdown():
            self._wake.wait(0.5)
            with self._lock:
                jog, positions = self._jog, self._listener.positions
                command = None
                if jog is not None and positions is not None:
                    command = jog.update(time.monotonic(), positions)
                    if command is not None:
                        self._topics.send(command)
            if command is None:
                self._wake.clear()
                continue
            time.sleep(PERIOD)
