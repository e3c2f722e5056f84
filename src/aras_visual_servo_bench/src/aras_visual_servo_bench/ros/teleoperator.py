"""Jogging of the arm from the live page, by a thread that sends commands to the joints."""

from __future__ import annotations

import threading
import time

import rospy

from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.ros.command_publishers import CommandPublishers, stop_controller
from aras_visual_servo_controller.settings import ControllerSettings
from aras_visual_servo_controller.teleop.jog import Jog

from ..errors import RefusedRequestError
from .graph_listener import GraphListener

PERIOD = 0.02  # time between two commands, s of wall time


class Teleoperator:
    """Moves the arm of one robot for a short time after each request of the page."""

    def __init__(self, listener: GraphListener, settings: ControllerSettings) -> None:
        self._listener, self._settings = listener, settings
        self._lock = threading.Lock()
        self._jog: Jog | None = None
        self._topics: CommandPublishers | None = None
        self._wake = threading.Event()
        threading.Thread(target=self._run, name="teleoperator", daemon=True).start()

    def move_camera(
        self, vx: float, vy: float, vz: float, wx: float, wy: float, wz: float
    ) -> str:
        """Move the camera for a short time.

        Args:
            vx, vy, vz: velocity of the camera in its optical frame, m/s.
            wx, wy, wz: angular velocity of the camera in its optical frame, rad/s.

        Returns:
            The reason why the motion is limited, or ''.
        """
        twist = (vx, vy, vz, wx, wy, wz)
        jog = self._start_jog() if any(twist) else self._jog
        if jog is None:
            return ""
        with self._lock:
            jog.set_twist(twist, time.monotonic())
        self._wake.set()
        return jog.reason

    def move_joint(self, joint: str, speed: float) -> str:
        """Move one joint for a short time.

        Args:
            joint: name of the joint.
            speed: velocity as a fraction of the joint's largest velocity for jogging, -1 to 1.

        Returns:
            The reason why the motion is limited, or ''.
        """
        jog = self._start_jog()
        with self._lock:
            jog.set_joint_speed(joint, speed, time.monotonic())
        self._wake.set()
        return jog.reason

    def _start_jog(self) -> Jog:
        """Stop the controller, and return the Jog, which computes the commands for the robot's arm.

        Raises:
            RefusedRequestError: there is no robot, or its controller cannot be stopped.
        """
        trace = self._listener.run_trace
        if trace is None or self._listener.positions is None:
            raise RefusedRequestError("no joint states are received: is the robot running?")
        if trace.state.phase not in ("", "stopped"):
            stop_controller(self._settings.namespace.rstrip("/"))
        if self._jog is None or self._jog.arm is not trace.arm:
            settings = self._settings.for_robot(self._listener.robot_name, ())
            limits = settings.make_limits(trace.arm)
            try:
                topics = CommandPublishers(settings, trace.arm.names, "position")
            except ConfigurationError as error:
                raise RefusedRequestError(str(error)) from None
            with self._lock:
                if self._topics is not None:
                    self._topics.close()
                self._jog = Jog(trace.arm, limits)
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
