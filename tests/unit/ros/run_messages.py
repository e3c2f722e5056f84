"""States of a run and their messages, for an arm with two different joints.

On the graph the joints are in another order than the arm's; numbers are all different.
"""

import numpy as np
import rospy
from sensor_msgs.msg import JointState

from aras_visual_servo_controller.kinematics.ik_solution import IKSolution
from aras_visual_servo_controller.kinematics.joint_sample import JointSample
from aras_visual_servo_controller.kinematics.task import Task
from aras_visual_servo_controller.records.outcomes import ArrivalStatus, PoseUncertainty
from aras_visual_servo_controller.records.state import ServoState
from aras_visual_servo_controller.schemes.base import SchemeOutput
from aras_visual_servo_controller.settings import ControllerSettings

JOINTS = ("slide", "elbow")
ARM = """<robot name="two"><link name="base"/><link name="cart"/><link name="hand"/>
<link name="camera_optical_frame"/>
<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/>
  <origin xyz="0.1 0.2 0.3" rpy="0.2 -0.1 0.4"/><axis xyz="1 0 0"/>
  <limit lower="-0.5" upper="0.7" effort="10" velocity="0.3"/></joint>
<joint name="elbow" type="revolute"><parent link="cart"/><child link="hand"/>
  <origin xyz="0 0.1 0.2"/><axis xyz="0 0 1"/>
  <limit lower="-1.5" upper="2" effort="5" velocity="1.9"/></joint>
<joint name="eye" type="fixed"><parent link="hand"/><child link="camera_optical_frame"/>
  <origin xyz="0.05 0 0" rpy="-1.9 0.1 -1.3"/></joint></robot>"""
SETTINGS = ControllerSettings(namespace="/two", camera_namespace="/eye/camera",
                              command_topic="both", scheme="points")
K = (510.0, 0.0, 33.0, 0.0, 433.0, 21.0, 0.0, 0.0, 1.0)
NAMES = ("x0", "y0", "Z")


def position(stamp: float) -> np.ndarray:
    """Return the joint positions (2,) at a time, m and rad."""
    return np.array([0.3 - 0.11 * stamp, 0.2 * stamp - 0.4])


def made_state(stamp: float, phase: str = "servoing", **more: object) -> ServoState:
    """Return a state of the loop in which every part has different values."""
    random = np.random.default_rng(round(1e6 * stamp))
    features, desired = random.normal(size=(2, 3))
    L, jacobian = random.normal(size=(3, 6)), random.normal(size=(6, 2))
    task = Task.from_interaction(L, random.normal(size=3))
    resolution = IKSolution(random.normal(size=2), np.zeros(2), task.twist, random.normal(size=6),
                            random.normal(size=6), float(random.uniform(0.3, 0.9)),
                            random.uniform(0.1, 0.2, 2), (), "", (), task.L, jacobian,
                            np.ones(6, bool))
    return ServoState(**{
        "stamp": stamp, "phase": phase, "outcome": "running", "reason": "slow", "remedy": "wait",
        "scheme_output": SchemeOutput(NAMES, features, desired, features - desired, task,
                             filtered_error=0.9 * (features - desired)),
        "ik_solution": resolution, "joints": JointSample.from_values(stamp, JOINTS,
            position(stamp)),
        "command": position(stamp) + 0.01, "computation_time": 0.0017 + 1e-3 * random.random(),
        "scheme": "points", "arrival_status": ArrivalStatus(True,
            pose_uncertainty=PoseUncertainty(3e-4, 0.012)), **more})


def joint_states(stamp: float, *, velocity: bool = True) -> JointState:
    """Return joint states in another order than the arm's, with a joint of another device."""
    message = JointState(name=["elbow", "finger", "slide"])
    message.header.stamp = rospy.Time.from_sec(stamp)
    slide, elbow = position(stamp)
    message.position = [elbow, 9.0, slide]
    message.velocity = [0.2, 8.0, -0.11] if velocity else []
    return message


def told(graph, face, state):
    """Return the state and report messages of one state."""
    graph.publishers["/two/controller/diagnosis"].impl.connections = [None]
    face.report(state)
    return tuple(graph.publishers[f"/two/controller/{name}"].sent[-1]
                 for name in ("state", "diagnosis"))  # fmt: skip


def same(one: object, other: object) -> None:
    np.testing.assert_allclose(np.asarray(one), np.asarray(other), atol=1e-12)
