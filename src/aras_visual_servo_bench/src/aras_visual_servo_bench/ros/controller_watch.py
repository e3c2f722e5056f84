"""Subscribers with which the demo observes a run: state of the controller, joint states."""

import contextlib
import xmlrpc.client
from collections.abc import Callable
from pathlib import Path

import rosgraph

from .ros_launch import wait_until

CLOSE_TIMEOUT = 15.0  # longest time for which the recorder closes its bag, s of wall time


class ControllerWatch:
    """Subscribers of the demo process, which store the progress of a run. All stamps are in s.

    The process uses wall time, not simulated time.

    Attributes:
        phase, reason: phase and reason in the controller's latest state; '' before its first state.
        start_stamp: stamp at the start of servoing; None before.
        convergence_stamp: stamp at which the controller converged; None if it is not converged now.
        stamp: stamp of the controller's latest state.
        has_joint_states: True after the first joint state.
    """

    def __init__(self) -> None:
        import rospy
        from aras_visual_servo_controller.msg import ServoState
        from sensor_msgs.msg import JointState

        from aras_visual_servo_ros.log_folder import check_log_folder
        from aras_visual_servo_ros.rospy_patches import find_publishers

        self.phase = self.reason = ""
        self.start_stamp: float | None = None
        self.convergence_stamp: float | None = None
        self.stamp = 0.0
        self.has_joint_states = False
        find_publishers()
        check_log_folder("aras_visual_servo_demo")
        rospy.init_node(
            "aras_visual_servo_demo", anonymous=True, disable_signals=True, disable_rostime=True
        )
        rospy.Subscriber(
            "/aras_visual_servo/controller/state", ServoState, self._on_state, queue_size=10
        )
        self._joints = rospy.Subscriber(
            "/aras_visual_servo/joint_states", JointState, self._on_joints, queue_size=1
        )

    def _on_joints(self, message) -> None:
        self.has_joint_states = True
        self._joints.unregister()

    def _on_state(self, message) -> None:
        stamp = message.header.stamp.to_sec()
        self.phase, self.reason, self.stamp = message.phase, message.reason, stamp
        if self.start_stamp is None and message.phase in ("servoing", "converged"):
            self.start_stamp = stamp
        if message.phase != "converged":
            self.convergence_stamp = None
        elif self.convergence_stamp is None:
            self.convergence_stamp = stamp


def wait_for_master(uri: str, is_alive: Callable[[], bool], timeout: float) -> bool:
    """Wait until a ROS master answers, and return whether it does.

    Args:
        uri: URI of the master.
        is_alive: function that returns whether the process of the master is running; if it is not,
            waiting ends.
        timeout: longest waiting time, s.
    """

    def is_online() -> bool:
        with contextlib.suppress(OSError):
            return rosgraph.is_master_online(uri)
        return False

    return wait_until(lambda: not is_alive() or is_online(), timeout) and is_alive()


def stop_recorder(uri: str, bag: Path) -> bool:
    """Stop the node `record`, and return whether its bag is closed within CLOSE_TIMEOUT."""
    active = bag.with_name(bag.name + ".active")
    if not active.exists():
        return bag.exists()
    with contextlib.suppress(OSError, rosgraph.MasterException, xmlrpc.client.Error):
        node = rosgraph.Master("/aras_visual_servo_demo", uri).lookupNode("/record")
        xmlrpc.client.ServerProxy(node).shutdown("/aras_visual_servo_demo", "the run has ended")
    return wait_until(lambda: bag.exists() and not active.exists(), CLOSE_TIMEOUT)
