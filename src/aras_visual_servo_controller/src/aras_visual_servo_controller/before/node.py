"""The controller node: features in, joint commands out, at the camera's rate.

A thin skin: messages become the loop's plain data, its answers become messages. Everything that
decides is in `servo.py`.
"""

import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import rospkg
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from aras_visual_servo_ros.master_watch import MasterWatch
from aras_visual_servo_ros.shutdown import end_on_signals

from ..errors import ConfigurationError
from ..kinematics import JOINT_NAMES, MOUNTING
from ..msg import ServoState
from . import conversions, mounting
from .before import servo
from .before.joint_history import JointHistory
from .before.servo import Servo, ServoCommand
from .settings import Settings

NAMESPACE = "/aras_visual_servo"
CONTROLLERS = {
    "gantry": "gantry",
    "J1": "joint1",
    "J2": "joint2",
    "J3": "joint3",
    "J5": "joint5",
    "J6": "joint6",
}
# Approaching is driven by the joint states; its report need not be faster than the camera's.
APPROACH_REPORT_PERIOD = 1.0 / 30.0
LISTENERS_TIMEOUT = 5.0  # s of wall time
REPEAT_WARNING = 5.0


class ControllerNode:
    """Subscribes, asks the loop, publishes; one lock around the loop."""

    def __init__(self, settings: Settings, loop: Servo) -> None:
        self._settings = settings
        self._loop = loop
        self._lock = threading.Lock()
        self._positions: np.ndarray | None = None
        self._history = JointHistory()
        self._unanswered: tuple[ImageMoments, list[float] | None] | None = None
        self._joint_stamp: float | None = None
        self._image_stamp: float | None = None
        self._moments: ImageMoments | None = None
        self._joints_heard = self._images_heard = time.monotonic()
        self._sent: np.ndarray | None = None
        self._reported = -1.0
        self._said: tuple[str, str] = ("", "")
        self._said_at = 0.0
        self._master = MasterWatch(rospy.get_name())
        self.status = 0

        self._commands = [
            rospy.Publisher(
                f"{NAMESPACE}/{CONTROLLERS[name]}_position_controller/command",
                Float64,
                queue_size=1,
            )
            for name in JOINT_NAMES
        ]
        self._state = rospy.Publisher(f"{NAMESPACE}/controller/state", ServoState, queue_size=5)
        self._twist = rospy.Publisher(
            f"{NAMESPACE}/controller/camera_twist", TwistStamped, queue_size=5
        )
        self._await_listeners()
        rospy.Subscriber(
            f"{NAMESPACE}/joint_states",
            JointState,
            self._on_joints,
            queue_size=10 if settings.lockstep else 1,
            tcp_nodelay=True,
        )
        rospy.Subscriber(
            f"{NAMESPACE}/camera/moments",
            ImageMoments,
            self._on_moments,
            queue_size=1,
            tcp_nodelay=True,
        )
        if loop.scheme.source == "kernel":
            rospy.Subscriber(
                f"{NAMESPACE}/camera/data",
                Float64MultiArray,
                self._on_data,
                queue_size=1,
                tcp_nodelay=True,
            )

    def _await_listeners(self) -> None:
        """Give a recorder the time to connect; nothing has been subscribed to or sent yet."""
        deadline = time.monotonic() + LISTENERS_TIMEOUT
        while self._state.get_num_connections() < self._settings.listeners:
            if rospy.is_shutdown():
                return
            if time.monotonic() > deadline:
                rospy.logwarn(
                    "controller/state has %d of %g listeners after %g s: beginning without them",
                    self._state.get_num_connections(),
                    self._settings.listeners,
                    LISTENERS_TIMEOUT,
                )
                return
            time.sleep(0.02)

    def spin(self) -> None:
        """Watch for silence until ROS shuts down. Runs on wall time: simulated time may stop."""
        while not rospy.is_shutdown():
            time.sleep(0.1)
            if reason := self._master.lost():
                # Logging goes through rosout, which needs the master: say it directly.
                print(f"aras_visual_servo_controller: {reason}: ending", file=sys.stderr)
                rospy.signal_shutdown(reason)
                return
            with self._lock:
                self._check_silence()

    def _on_joints(self, message: JointState) -> None:
        with self._lock:
            stamp = message.header.stamp.to_sec()
            if self._joint_stamp is not None and stamp < self._joint_stamp:
                self._restart(stamp)
            if self._joint_stamp is None:
                self._remount()
            self._joint_stamp = stamp
            self._joints_heard = time.monotonic()
            try:
                self._positions = conversions.joint_positions(message.name, message.position)
            except KeyError as error:
                self._positions = None
                self._say(servo.WAITING, f"joint_states lacks the joints {error.args[0]}")
                return
            except ValueError as error:
                self._positions = None
                self._say(servo.WAITING, f"joint_states is malformed: {error}")
                return
            if self._settings.lockstep:
                self._history.add(stamp, self._positions)
                if self._unanswered is not None:
                    self._step(*self._unanswered)
                return  # there every command answers an image
            if self._loop.approaching:
                command = self._loop.joints(self._positions, stamp)
                self._send(command.joint_commands)
                if not 0.0 <= stamp - self._reported < APPROACH_REPORT_PERIOD:
                    self._report(command, message.header.stamp)
            else:
                self._send(self._loop.streamed(stamp), repeat=False)

    def _on_moments(self, message: ImageMoments) -> None:
        with self._lock:
            self._moments = message
            if self._loop.scheme.source == "moments":
                self._step(message, None)

    def _on_data(self, message: Float64MultiArray) -> None:
        with self._lock:
            if self._moments is not None:
                self._step(self._moments, message.data)

    def _step(self, message: ImageMoments, kernel: list[float] | None) -> None:
        """One image: ask the loop and publish what it says."""
        stamp = message.header.stamp.to_sec()
        if self._joint_stamp is not None and stamp > self._joint_stamp + 1.0:
            return  # left over from before a reset
        if self._image_stamp is not None and stamp < self._image_stamp:
            self._restart(stamp)
        if stamp == self._image_stamp:
            return
        positions = self._positions
        self._unanswered = None
        if self._settings.lockstep:
            if not self._history.complete_to(stamp):
                self._unanswered = message, kernel
                return
            positions = self._history.at(stamp)
        self._image_stamp = stamp
        self._images_heard = time.monotonic()
        if self._loop.approaching and not self._settings.lockstep:
            return
        command = self._loop.step(conversions.measurement(message, kernel), positions)
        if self._settings.lockstep:
            self._send(command.joint_commands)
        else:
            self._send(self._loop.streamed(max(stamp, self._joint_stamp or stamp)))
        self._report(command, message.header.stamp)

    def _restart(self, stamp: float) -> None:
        """The simulated clock went back: the world was reset or the simulator restarted."""
        rospy.loginfo("simulated time went back to %.3f s: beginning anew", stamp)
        self._loop.reset()
        self._positions = self._joint_stamp = self._image_stamp = self._unanswered = None
        self._history.clear()
        self._reported = -1.0

    def _remount(self) -> None:
        """The robot may have come after this node, or another one than before: look at its camera.

        Its description is on the parameter server before its joint states are.
        """
        try:
            seen = find_mounting()
            if mounting.same(seen, self._loop.resolver.kinematics.mounting):
                return
            self._loop = self._settings.build(seen)
        except ConfigurationError as error:
            rospy.logfatal("%s", error)
            self.status = 1
            rospy.signal_shutdown(str(error))
        except OSError:
            return  # the master is gone: `spin` will say so
        else:
            _tell_mounting(self._loop)

    def _send(self, values: np.ndarray | None, repeat: bool = True) -> None:
        """Publish the six commands; without `repeat` only when they are new."""
        if values is None or not np.isfinite(values).all():
            return
        if not repeat and self._sent is not None and np.array_equal(values, self._sent):
            return
        self._sent = values
        for publisher, value in zip(self._commands, values, strict=True):
            _publish(publisher, Float64(float(value)))

    def _report(self, command: ServoCommand, stamp: rospy.Time) -> None:
        self._reported = command.stamp
        message = conversions.fill_state(ServoState(), command, self._settings.scheme)
        message.header.stamp = stamp
        _publish(self._state, message)
        twist = TwistStamped(header=message.header)
        conversions.fill_twist(twist.twist, command.twist)
        _publish(self._twist, twist)
        self._say(command.phase, command.reason)

    def _say(self, phase: str, reason: str) -> None:
        """Log a new phase once, and what is wrong when it changes kind or every few seconds."""
        now = time.monotonic()
        new_phase = phase != self._said[0]
        trouble = phase in (servo.WAITING, servo.HOLDING) or (reason and phase != servo.SERVOING)
        if new_phase and not trouble:
            rospy.loginfo("%s%s", phase, f" ({reason})" if reason else "")
        elif trouble and (new_phase or now - self._said_at >= REPEAT_WARNING):
            rospy.logwarn("%s: %s", phase, reason)
        elif reason and now - self._said_at >= REPEAT_WARNING:
            rospy.loginfo("%s: %s", phase, reason)
        else:
            return
        self._said, self._said_at = (phase, reason), now

    def _check_silence(self) -> None:
        now = time.monotonic()
        missing = []
        if now - self._joints_heard > self._settings.joint_timeout:
            missing.append(f"joint states on {NAMESPACE}/joint_states (is the simulator running?)")
        if now - self._images_heard > self._settings.image_timeout:
            topic = "data" if self._loop.scheme.source == "kernel" else "moments"
            missing.append(
                f"features on {NAMESPACE}/camera/{topic} (is the camera node running?)"
            )
        if self._loop.approaching and len(missing) == 1 and "features" in missing[0]:
            return  # the eyes are shut on the way to the start pose
        if missing and now - self._said_at >= 1.0:
            command = self._loop.stalled(rospy.get_time(), "no " + " and no ".join(missing))
            self._report(command, rospy.Time.now())


def _publish(publisher: rospy.Publisher, message: Any) -> None:
    """Publish, but not into topics that the shutdown has closed while we were computing."""
    try:
        publisher.publish(message)
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():
            raise


def find_mounting() -> np.ndarray:
    """`flange_T_optical` (4, 4) of the robot_description there is; the robot's own where none is.

    Raises:
        ConfigurationError: the description has no camera on its flange.
    """
    urdf = rospy.get_param("robot_description", "")
    return mounting.from_description(urdf) if urdf else MOUNTING


def _tell_mounting(loop: Servo) -> None:
    flange_T_optical = loop.resolver.kinematics.mounting
    if not mounting.same(flange_T_optical, MOUNTING):
        rospy.loginfo(
            "camera at %s of %s, as robot_description says; desired: %s",
            mounting.words(flange_T_optical),
            mounting.FLANGE,
            loop.scheme.desired.name,
        )


def main() -> int:
    """Run the node; returns its exit status."""
    rospy.init_node("aras_visual_servo_controller")
    end_on_signals()
    package = Path(rospkg.RosPack().get_path("aras_visual_servo_controller"))
    try:
        given = rospy.get_param("~", {})
        given.setdefault("lockstep", rospy.get_param("/gazebo/speed_mode", "") == "lockstep")
        settings = Settings.from_mapping(given, package)
        loop = settings.build(find_mounting())
    except ConfigurationError as error:
        rospy.logfatal("%s", error)
        return 1
    rospy.loginfo(
        "scheme %s, start %s, desired %s", settings.scheme, settings.start, settings.desired_path()
    )
    _tell_mounting(loop)
    node = ControllerNode(settings, loop)
    node.spin()
    return node.status
