"""Robot that the tests of the controller node simulate, and the node in a separate process.

The played robot has exact vision and lagging joints. A test module that wants them writes
`pytest_plugins = ["played_robot"]`.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from aras_visual_servo_controller.msg import ServoState
from ros_graph import PATIENCE, RosMaster
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_base.yaml_files import read_yaml
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm

PERIOD = 1.0 / 90.0  # of the joint states; every third carries an image
SOURCES = Path(__file__).parents[2] / "src"
CONFIG = SOURCES / "aras_visual_servo_controller" / "config"
URDF = (SOURCES / "aras_visual_servo_gazebo/robots/aras_visual_servo.urdf").read_text()
NAMESPACE = "/aras_visual_servo"
ARM = Arm.from_urdf(URDF)
CONTROLLERS = read_yaml(CONFIG / "robots" / "aras_visual_servo.yaml", ValueError)["controllers"]
STARTS = {
    name: np.array([joints[joint] for joint in ARM.names])
    for name, joints in read_yaml(CONFIG / "starts.yaml", ValueError).items()
}
GOAL = Goal.load(CONFIG / "goal_2016.yaml")
NODE = [
    sys.executable,
    "-c",
    "import sys; from aras_visual_servo_controller.ros.node import main; sys.exit(main())",
]
LAG = 0.03  # s with which the played joints follow


def image_of(arm: Arm, q: np.ndarray, stamp: rospy.Time) -> ImageMoments:
    """Return the image moments of the target from an exact camera at these joints."""
    moments = Moments.from_polygon(GOAL.target.compute_outline(arm.pose(q)), 3)
    message = ImageMoments(valid=True, order=3, width=320, height=240)
    message.header.stamp = stamp
    message.K = [100.0, 0, 160, 0, 100, 120, 0, 0, 1]
    message.m, message.mu = moments.m_array.tolist(), moments.mu_array.tolist()
    return message


class Plant:
    """Simulated robot: publishes joint states and image moments, and follows six joint commands."""

    def __init__(self, arm: Arm = ARM) -> None:
        self.arm, self.q = arm, np.zeros(6)
        self.command = np.zeros(6)
        self.received: list[np.ndarray] = []
        self.valid = True
        self.images = self.joints = self.time = True
        self.K = [100.0, 0, 160, 0, 100, 120, 0, 0, 1]
        self.strange: float | None = None  # a position that no joint can have
        self.ticks = self.offset = self._tick = 0
        self._end = threading.Event()
        self._clock = rospy.Publisher("/clock", Clock, queue_size=10)
        self._joints = rospy.Publisher(f"{NAMESPACE}/joint_states", JointState, queue_size=1)
        self._moments = rospy.Publisher(f"{NAMESPACE}/camera/moments", ImageMoments, queue_size=1)
        self._subscribers = [
            rospy.Subscriber(
                f"{NAMESPACE}/{CONTROLLERS[name]}/command",
                Float64,
                self._on_command,
                callback_args=index,
                tcp_nodelay=True,
            )
            for index, name in enumerate(ARM.names)
        ]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _on_command(self, message: Float64, index: int) -> None:
        self.command[index] = message.data
        self.received.append(self.command.copy())

    def _run(self) -> None:
        start, n = time.monotonic(), 0
        order = np.argsort([name.lower() if name != "gantry" else "z" for name in ARM.names])
        while not self._end.wait(max(0.0, start + n * PERIOD - time.monotonic())):
            n += 1
            if not self.time:
                continue
            self.ticks += 1
            tick = self._tick = self.ticks
            stamp = rospy.Time.from_sec(1.0 + (tick - self.offset) * PERIOD)
            before, decay = self.q, 1.0 - np.exp(-PERIOD / LAG)
            self.q = self.q + decay * (self.command - self.q)
            self._clock.publish(Clock(stamp))
            if self.joints:
                position = self.q[order]
                if self.strange is not None:
                    position = np.full(6, self.strange)
                message = JointState(
                    name=[ARM.names[i] for i in order],
                    position=position.tolist(),
                    velocity=((self.q - before) / PERIOD)[order].tolist(),
                )
                message.header.stamp = stamp
                self._joints.publish(message)
            if self.images and tick % 3 == 0:
                self._moments.publish(self._image(stamp))

    def _image(self, stamp: rospy.Time) -> ImageMoments:
        message = image_of(self.arm, self.q, stamp)
        message.K = self.K
        if not self.valid:
            message.valid, message.m, message.mu = False, [], []
            message.reason = "no target in the image"
        return message

    def connections(self) -> list[list]:
        """Return the connections through which commands arrive, for each joint."""
        return [subscriber.impl.connections for subscriber in self._subscribers]

    def off(self, year: str = "2016") -> tuple[float, float]:
        """Return the distance (m) and angle (rad) of the camera from a goal."""
        joints = Goal.load(CONFIG / f"goal_{year}.yaml").get_joints(ARM.names)
        return pose_difference(self.arm.pose(joints), self.arm.pose(self.q))

    def restart(self) -> None:
        """Behave like a restarted simulator: zero pose, and the clock starts at 0."""
        self.q = np.zeros(6)
        self.command = np.zeros(6)
        self.offset = self._tick

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._clock.unregister()
        self._joints.unregister()
        self._moments.unregister()


class Node:
    """Controller node in a separate process."""

    def __init__(self, master: RosMaster, *arguments: str, path: Path | None = None) -> None:
        environment = dict(master.environment)
        if path is not None:
            environment["PYTHONPATH"] = f"{path}:{environment.get('PYTHONPATH', '')}"
        self.log = master.directory / f"controller-{time.monotonic_ns()}.txt"
        self._output = self.log.open("w")
        self.process = subprocess.Popen(
            [*NODE, "__name:=aras_visual_servo_controller", *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
        )
        self._master = master

    def output(self) -> str:
        return self.log.read_text()

    def stop(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        status = self.process.wait(10.0 * PATIENCE)
        self._output.close()
        if self._master.api.is_online():
            self._master.clean()
        return status


def described() -> None:
    """Set the parameters of the robot that a simulator sets before a node starts."""
    rospy.set_param("/robot_description", URDF)
    rospy.set_param("/use_sim_time", True)


def forgotten() -> None:
    for name in ("/robot_description", "/use_sim_time", "/aras_visual_servo_controller"):
        if rospy.has_param(name):
            rospy.delete_param(name)


@pytest.fixture
def plant(ros_node):
    described()
    played = Plant()
    yield played
    played.close()
    forgotten()


@pytest.fixture
def start(ros_master):
    nodes = []

    def run(*arguments, master=ros_master, path=None):
        nodes.append(Node(master, *arguments, path=path))
        return nodes[-1]

    yield run
    for node in nodes:
        node.stop()


@pytest.fixture
def states(collect):
    return collect(f"{NAMESPACE}/controller/state", ServoState)


def phase_is(states, phase):
    return lambda: states.messages and states.messages[-1].phase == phase
