"""Teleoperation of a running robot by keyboard and gamepad."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from pathlib import Path

import numpy as np
import rospy
from sensor_msgs.msg import JointState, Joy

from aras_visual_servo_base.names import describe_unknown
from aras_visual_servo_ros.log_folder import check_log_folder
from aras_visual_servo_ros.rospy_patches import find_publishers

from ..errors import ConfigurationError, MeasurementError, ServoError
from ..teleop import keyboard
from ..teleop.gamepad import HELP, JoyDevice, compute_twist
from ..teleop.jog import Jog
from .command_publishers import CommandPublishers, stop_controller
from .node_settings import read_robot_settings

PERIOD = 0.02  # wall time between two commands, s


class Teleop:
    """Teleoperation of one arm by one operator at a terminal."""

    def __init__(self) -> None:
        """Connect to the robot.

        Raises:
            ConfigurationError: there is no robot, or a joint is unknown.
        """
        settings, arm = read_robot_settings({})
        self._arm = arm
        self._limits, self._namespace = settings.make_limits(arm), settings.namespace.rstrip("/")
        self._joints = {
            way: str(rospy.get_param(f"~{way}", name))
            for way, name in keyboard.choose_step_joints(arm.names).items()
        }
        for name in self._joints.values():
            if name not in arm.names:
                raise ConfigurationError(describe_unknown("joint", name, arm.names))
        self._jog = Jog(arm, self._limits)
        self._keys = keyboard.KeyboardState(arm.names)
        self._command_publishers = CommandPublishers(settings, arm.names, "position")
        self._measured: np.ndarray | None = None
        self._has_joint_state, self._jog_lock = threading.Event(), threading.Lock()
        self._has_stopped_controller, self._last_reason = False, ""
        self._gamepad: JoyDevice | None = None
        topic = f"{self._namespace}/joint_states"
        rospy.Subscriber(topic, JointState, self._on_joints, queue_size=1)
        rospy.Subscriber(str(rospy.get_param("~joy", "/joy")), Joy, self._on_joy, queue_size=1)
        device = Path(str(rospy.get_param("~joystick", "/dev/input/js0")))
        with contextlib.suppress(OSError):  # without a gamepad, the keyboard is sufficient
            self._gamepad = JoyDevice(device)

    def run(self) -> int:
        """Run until q or ^C is pressed, and return the exit status."""
        print(keyboard.__doc__)
        if self._gamepad is not None:
            print(HELP)
        while not self._has_joint_state.wait(2.0):
            print(f"waiting for joint states on {self._namespace}/joint_states")
        command = self._measured
        with keyboard.raw_terminal():
            while not rospy.is_shutdown():
                for key in keyboard.read_keys(PERIOD):
                    if key in ("q", "\x04"):
                        return 0
                    command = self._handle_key(key, command)
                if self._gamepad is not None:
                    self._handle_gamepad(self._gamepad.axes, self._gamepad.buttons)
                if self._send_command():
                    command = self._measured
        return 0

    def _handle_key(self, key: str, command: np.ndarray) -> np.ndarray:
        if key == "h":
            print(keyboard.__doc__ + (HELP if self._gamepad is not None else ""))
        elif key == " ":
            print("  ".join(f"{n} {v:.3f}" for n, v in
                            zip(self._arm.names, self._measured, strict=True)))  # fmt: skip
            if self._jog.reason:
                print(self._jog.reason)
        elif key in keyboard.KEYS:
            command, text = keyboard.step_joint(key, command, self._limits, self._joints)
            print(text)
            way = keyboard.KEYS[key][0]
            self._command_publishers.send(command, self._joints[way])
        else:
            moves, text = self._keys.press(key, self._jog, time.monotonic())
            if moves:
                self._stop_controller()
            if text:
                print(text)
        return command

    def _send_command(self) -> bool:
        """Send the current command, if the arm has to move; return whether it was sent."""
        with self._jog_lock:
            command = self._jog.update(time.monotonic(), self._measured)
        if command is None:
            return False
        self._command_publishers.send(command)
        if self._jog.reason and self._jog.reason != self._last_reason:
            print(self._jog.reason)
        self._last_reason = self._jog.reason
        return True

    def _handle_gamepad(self, axes: list[float], buttons: list[int]) -> None:
        twist = compute_twist(axes, buttons)
        if twist is None:
            return
        self._stop_controller()
        with self._jog_lock:
            self._jog.set_twist(twist, time.monotonic())

    def _stop_controller(self) -> None:
        """Stop the controller before the first motion, because it also commands the joints."""
        if self._has_stopped_controller:
            return
        self._has_stopped_controller = True
        if stop_controller(self._namespace):
            print("the controller is stopped; its service start resumes it")

    def _on_joints(self, message: JointState) -> None:
        with contextlib.suppress(MeasurementError):
            self._measured = self._arm.read_joints(message.name, message.position).positions
            self._has_joint_state.set()

    def _on_joy(self, message: Joy) -> None:
        if self._has_joint_state.is_set():
            self._handle_gamepad(list(message.axes), list(message.buttons))


def main() -> int:
    """Run until q or ^C is pressed, and return the exit status."""
    if not sys.stdin.isatty():
        print("aras_teleop reads keys from a terminal: start it with rosrun", file=sys.stderr)
        return 1
    find_publishers()
    check_log_folder("aras_teleop")
    rospy.init_node("aras_teleop", anonymous=True, disable_signals=True)
    try:
        return Teleop().run()
    except ServoError as error:
        print(f"aras_teleop: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0
