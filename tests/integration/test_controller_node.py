"""The controller node in a real graph, in front of a robot that is played by this test.

The played robot has exact vision and lagging joints; its clock runs faster than the wall's.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from aras_visual_servo_controller.msg import ServoState
from geometry_msgs.msg import TwistStamped
from ros_graph import RosMaster, wait_for
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.before.node import CONTROLLERS, NAMESPACE
from aras_visual_servo_controller.before.settings import STARTS
from aras_visual_servo_controller.goals import DESIRED_JOINTS, from_geometry
from aras_visual_servo_controller.kinematics import (
    JOINT_NAMES,
    MOUNTING,
    Kinematics,
    pose_difference,
    transform,
)
from aras_visual_servo_controller.mounting import to_xyz_rpy
from aras_visual_servo_controller.target import outline
from aras_visual_servo_controller.virtual_robot import VirtualRobot

SPEED = 2.0  # simulated seconds per second of wall time
PERIOD = 1.0 / 90.0  # of the joint states; every third carries an image
NODE = [
    sys.executable,
    "-c",
    "import sys; from aras_visual_servo_controller.before.node import main; sys.exit(main())",
]


class Plant:
    """Publishes joint states and image moments, follows the six commands."""

    def __init__(self) -> None:
        self.robot = VirtualRobot(np.zeros(6))
        self.command = np.zeros(6)
        self.received: list[np.ndarray] = []
        self.valid = True
        self.images = self.joints = True
        self.offset = self._tick = 0
        self._end = threading.Event()
        self._joints = rospy.Publisher(f"{NAMESPACE}/joint_states", JointState, queue_size=1)
        self._moments = rospy.Publisher(f"{NAMESPACE}/camera/moments", ImageMoments, queue_size=1)
        self._subscribers = [
            rospy.Subscriber(
                f"{NAMESPACE}/{CONTROLLERS[name]}_position_controller/command",
                Float64,
                self._on_command,
                callback_args=index,
                tcp_nodelay=True,
            )
            for index, name in enumerate(JOINT_NAMES)
        ]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _on_command(self, message: Float64, index: int) -> None:
        self.command[index] = message.data
        self.received.append(self.command.copy())

    def _run(self) -> None:
        tick, start = 0, time.monotonic()
        order = np.argsort([name.lower() if name != "gantry" else "z" for name in JOINT_NAMES])
        while not self._end.wait(max(0.0, start + tick * PERIOD / SPEED - time.monotonic())):
            tick += 1
            self._tick = tick
            stamp = rospy.Time.from_sec(1.0 + (tick - self.offset) * PERIOD)
            decay = 1.0 - np.exp(-PERIOD / self.robot.lag)
            self.robot.q = self.robot.q + decay * (self.command - self.robot.q)
            if self.joints:
                message = JointState(
                    name=[JOINT_NAMES[i] for i in order], position=self.robot.q[order].tolist()
                )
                message.header.stamp = stamp
                self._joints.publish(message)
            if self.images and tick % 3 == 0:
                self._moments.publish(self._image(stamp))

    def _image(self, stamp: rospy.Time) -> ImageMoments:
        message = ImageMoments(valid=self.valid, order=3, width=320, height=240)
        message.header.stamp = stamp
        message.K = [100.0, 0, 160, 0, 100, 120, 0, 0, 1]
        if self.valid:
            view = outline(self.robot.kinematics.pose(self.robot.q))
            moments = Moments.from_polygon(view, 3)
            message.m, message.mu = moments.m_array.tolist(), moments.mu_array.tolist()
        else:
            message.reason = "no target in the image"
        return message

    def restart(self) -> None:
        """As a simulator killed and started again: zero pose, clock back to its beginning."""
        self.robot.q = np.zeros(6)
        self.command = np.zeros(6)
        self.offset = self._tick

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._joints.unregister()
        self._moments.unregister()


class Node:
    """The controller node as a process of its own."""

    def __init__(self, master: RosMaster, *arguments: str) -> None:
        self.log = master.directory / f"controller-{time.monotonic_ns()}.txt"
        self._output = self.log.open("w")
        self.process = subprocess.Popen(
            [*NODE, "__name:=aras_visual_servo_controller", *arguments],
            env=master.environment,
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
        status = self.process.wait(10.0)
        self._output.close()
        if self._master.api.is_online():
            self._master.clean()
        return status


@pytest.fixture
def plant(ros_node):
    played = Plant()
    yield played
    played.close()
    if rospy.has_param("/robot_description"):
        rospy.delete_param("/robot_description")


@pytest.fixture
def start(ros_master):
    nodes = []

    def run(*arguments, master=ros_master):
        nodes.append(Node(master, *arguments))
        return nodes[-1]

    yield run
    for node in nodes:
        node.stop()


@pytest.fixture
def states(collect):
    return collect(f"{NAMESPACE}/controller/state", ServoState)


def phase_is(states, phase):
    return lambda: states.messages and states.messages[-1].phase == phase


def test_goes_to_the_start_servoes_and_converges(plant, start, states, collect):
    twists = collect(f"{NAMESPACE}/controller/camera_twist", TwistStamped)
    node = start("_scheme:=moments", "_start:=2016")
    wait_for(phase_is(states, "approaching"), 20.0, "the approach")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    first = next(m for m in states.messages if m.phase == "servoing")
    np.testing.assert_allclose(first.joint_positions, STARTS["2016"], atol=0.02)
    wait_for(phase_is(states, "converged"), 20.0, "convergence")

    last = states.messages[-1]
    assert last.feature_names == ["xn", "yn", "an", "alpha"]
    assert (np.abs(last.error) < (0.001, 0.003, 0.005, 0.01)).all()
    assert last.joint_names == list(JOINT_NAMES)
    assert last.header.frame_id == "camera_optical_frame"
    assert len(last.singular_values) == 5
    assert twists.messages[-1].header.frame_id == "camera_optical_frame"
    goal = plant.robot.kinematics.pose(np.array(DESIRED_JOINTS["2016"]))
    distance, angle = pose_difference(goal, plant.robot.kinematics.pose(plant.robot.q))
    assert distance < 0.5e-3
    assert angle < np.radians(0.3)
    assert node.stop() == 0
    assert "Traceback" not in node.output()


def test_lost_target_holds_and_resumes(plant, start, states):
    node = start("_start:=none")
    plant.command = plant.robot.q = np.array(STARTS["2015"])
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.valid = False
    wait_for(phase_is(states, "holding"), 5.0, "holding")
    assert states.messages[-1].reason == "no target in the image"
    commands = {tuple(c) for c in plant.received[-30:]}
    time.sleep(0.3)
    assert {tuple(c) for c in plant.received[-30:]} <= commands
    plant.valid = True
    wait_for(phase_is(states, "converged"), 20.0, "convergence after the loss")
    assert "holding: no target in the image" in node.output()


def test_silence_is_named_and_waited_through(plant, start, states):
    node = start("_start:=none", "_image_timeout:=0.3", "_joint_timeout:=0.3")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.images = False
    wait_for(phase_is(states, "waiting"), 5.0, "waiting for images")
    assert "no features on /aras_visual_servo/camera/moments" in states.messages[-1].reason
    plant.joints = False
    wait_for(
        lambda: "no joint states" in states.messages[-1].reason, 5.0, "waiting for joint states"
    )
    plant.images = plant.joints = True
    wait_for(lambda: states.messages[-1].phase in ("servoing", "converged"), 5.0, "going on")
    assert node.output().count("waiting: ") < 10


def test_simulator_restarted_mid_run(plant, start, states):
    node = start("_start:=2015")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.restart()
    wait_for(phase_is(states, "approaching"), 5.0, "beginning anew")
    wait_for(phase_is(states, "converged"), 20.0, "convergence after the restart")
    assert "simulated time went back" in node.output()
    assert np.isfinite(plant.received).all()


def test_a_camera_moved_in_a_description_that_comes_later(plant, start, states):
    """The node goes by the robot_description there is when joint states begin."""
    mounting = MOUNTING @ transform((-0.03, 0.0, 0.0), (0.0, 0.0, np.pi))
    plant.joints = plant.images = False
    plant.robot.kinematics = Kinematics(mounting=mounting)
    node = start("_start:=2016")
    wait_for(lambda: "scheme moments" in node.output(), 20.0, "the node")
    xyz, rpy = (" ".join(map(repr, part)) for part in to_xyz_rpy(mounting))
    rospy.set_param(
        "/robot_description",
        '<robot name="r"><joint name="eye" type="fixed"><parent link="link6"/>'
        f'<child link="camera_optical_frame"/><origin xyz="{xyz}" rpy="{rpy}"/></joint></robot>',
    )
    plant.joints = plant.images = True
    wait_for(phase_is(states, "converged"), 20.0, "convergence")
    assert "camera at xyz" in node.output()
    goal = plant.robot.kinematics.pose(np.array(DESIRED_JOINTS["2016"]))
    distance, angle = pose_difference(goal, plant.robot.kinematics.pose(plant.robot.q))
    assert distance < 0.5e-3
    assert angle < np.radians(0.3)


def test_a_goal_of_another_mounting_ends_the_node_in_one_line(ros_node, start, tmp_path):
    moved = Kinematics(mounting=MOUNTING @ transform((0.03, 0.0, 0.0), (0.0, 0.0, 0.0)))
    file = tmp_path / "mine.yaml"
    file.write_text(from_geometry(DESIRED_JOINTS["2016"], "x", moved).to_yaml("for a test"))
    node = start(f"_desired:={file}")
    assert node.process.wait(20.0) == 1
    lines = [line for line in node.output().splitlines() if line.strip()]
    assert len(lines) == 1
    assert "mine.yaml were taught with the camera at xyz" in lines[0]
    assert "teach them anew" in lines[0]


def test_kernel_scheme_wants_its_layout(plant, start, states, tmp_path):
    from aras_visual_servo_controller.desired import Desired, DesiredKernel

    exact = from_geometry(DESIRED_JOINTS["2015"], "x")
    K = np.array([[100.0, 0, 160], [0, 100, 120], [0, 0, 1]])
    kernel = DesiredKernel(320, 240, K, np.array([0.06, 0.03, 16.0, -1.4]))
    file = tmp_path / "desired.yaml"
    file.write_text(Desired(**{**vars(exact), "kernel": kernel}).to_yaml("for a test"))
    data = rospy.Publisher(f"{NAMESPACE}/camera/data", Float64MultiArray, queue_size=1)
    start("_scheme:=kernel", "_start:=none", f"_desired:={file}")

    def refused():
        data.publish(Float64MultiArray(data=[0.1, 0.2, 900.0, 0.0]))
        time.sleep(0.05)
        return states.messages and "got 4: set the camera node's ~layout" in (
            states.messages[-1].reason
        )

    wait_for(refused, 20.0, "the refusal of four numbers")
    data.unregister()


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("_gian:=3", "unknown parameter ~gian: did you mean 'gain'"),
        ("_scheme:=nothing", "scheme 'nothing' is unknown"),
        ("_desired:=/nowhere.yaml", "cannot read the desired features /nowhere.yaml"),
    ],
)
def test_wrong_parameters_end_the_node_in_one_line(ros_node, start, argument, words):
    node = start(argument)
    assert node.process.wait(20.0) == 1
    lines = [line for line in node.output().splitlines() if line.strip()]
    assert len(lines) == 1
    assert words in lines[0]


def test_master_gone_ends_the_node(start, tmp_path):
    master = RosMaster(tmp_path)
    try:
        node = start(master=master)
        wait_for(lambda: "/aras_visual_servo_controller" in master.nodes(), 20.0, "the node")
        time.sleep(2.5)  # it has asked the living master at least once
    finally:
        master._process.terminate()
        master._process.wait()
    assert node.process.wait(20.0) == 0
    assert "the ROS master does not answer any more: ending" in node.output()
    assert "Traceback" not in node.output()
    master._output.close()
