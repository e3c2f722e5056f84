"""Subscribers with which the demo observes a run: state of the controller, joint states."""

import contextlib
import time
import xmlrpc.client
from dataclasses import dataclass
from pathlib import Path

import rosgraph


@dataclass
class RunProgress:
    """Progress of a run. All stamps are in s.

    Attributes:
        phase, reason: phase and reason in the controller's latest state; '' before its first state.
        start_stamp: stamp at the start of servoing; None before.
        convergence_stamp: stamp at which the controller converged; None if it is not converged now.
        stamp: stamp of the controller's latest state.
        has_joint_states: True after the first joint state.
    """

    phase: str = ""
    reason: str = ""
    start_stamp: float | None = None
    convergence_stamp: float | None = None
    stamp: float = 0.0
    has_joint_states: bool = False


class ControllerWatch:
    """Subscribers of the demo process, which update a RunProgress.

    The process uses wall time, not simulated time.
    """

    def __init__(self) -> None:
        import rospy
        from aras_visual_servo_controller.msg import ServoState
        from sensor_msgs.msg import JointState

        from aras_visual_servo_ros.log_folder import check_log_folder
        from aras_visual_servo_ros.rospy_patches import find_publishers

        self.progress = RunProgress()
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
        self.progress.has_joint_states = True
        self._joints.unregister()

    def _on_state(self, message) -> None:
        progress, stamp = self.progress, message.header.stamp.to_sec()
        progress.phase, progress.reason, progress.stamp = message.phase, message.reason, stamp
        if progress.start_stamp is None and message.phase in ("servoing", "converged"):
            progress.start_stamp = stamp
        if message.phase != "converged":
            progress.convergence_stamp = None
        elif progress.convergence_stamp is None:
            progress.convergence_stamp = stamp


def wait_for_master(uri: str, is_alive, timeout: float) -> bool:
    """Wait until a ROS master answers, and return whether it does.

    Args:
        uri: URI of the master.
        is_alive: function that returns whether the process of the master is running; if it is not,
            waiting ends.
        timeout: longest waiting time, s.
    """
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline and is_alive():
        with contextlib.suppress(OSError):
            if rosgraph.is_master_online(uri):
                return True
        time.sleep(0.1)
    return False


def stop_recorder(uri: str, bag: Path, timeout: float = 15.0) -> bool:
    """Stop the node `record`, and return whether its bag is closed within `timeout`, s."""
    active = bag.with_name(bag.name + ".active")
    if not active.exists():
        return bag.exists()
    with contextlib.suppress(OSError, rosgraph.MasterException, xmlrpc.client.Error):
        node = rosgraph.Master("/aras_visual_servo_demo", uri).lookupNode("/record")
        xmlrpc.client.ServerProxy(node).shutdown("/aras_visual_servo_demo", "the run has ended")
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        if bag.exists() and not active.exists():
            return True
        time.sleep(0.1)
    return False
