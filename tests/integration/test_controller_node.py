"""The controller node in a real graph, in front of a robot that is played by this test.

The played robot has exact vision and lagging joints; its clock runs faster than the wall's.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import actionlib
import numpy as np
import pytest
import rosbag
import rospy
from actionlib_msgs.msg import GoalStatus
from aras_visual_servo_camera.msg import ImageMoments, KernelFeatures
from aras_visual_servo_controller.msg import (
    ServoReport,
    ServoState,
    ServoToTargetAction,
    ServoToTargetGoal,
)
from dynamic_reconfigure.client import Client
from geometry_msgs.msg import TwistStamped
from ros_graph import PATIENCE, RosMaster, wait_for
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_base.yaml_files import read_yaml
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.goals.goal import Goal

SPEED = 1.0  # simulated seconds per second of wall time
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
    """What an exact camera sees of the target from these joints."""
    moments = Moments.from_polygon(GOAL.target.outline(arm.pose(q)), 3)
    message = ImageMoments(valid=True, order=3, width=320, height=240)
    message.header.stamp = stamp
    message.K = [100.0, 0, 160, 0, 100, 120, 0, 0, 1]
    message.m, message.mu = moments.m_array.tolist(), moments.mu_array.tolist()
    return message


class Plant:
    """Publishes joint states and image moments, follows the six commands."""

    def __init__(self, arm: Arm = ARM) -> None:
        self.arm, self.q = arm, np.zeros(6)
        self.command = np.zeros(6)
        self.received: list[np.ndarray] = []
        self.valid = True
        self.images = self.joints = self.time = True
        self.K = [100.0, 0, 160, 0, 100, 120, 0, 0, 1]
        self.late = 0.0  # s by which stamps of images are too old
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
        while not self._end.wait(max(0.0, start + n * PERIOD / SPEED - time.monotonic())):
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
                self._moments.publish(self._image(stamp - rospy.Duration.from_sec(self.late)))

    def _image(self, stamp: rospy.Time) -> ImageMoments:
        message = image_of(self.arm, self.q, stamp)
        message.K = self.K
        if not self.valid:
            message.valid, message.m, message.mu = False, [], []
            message.reason = "no target in the image"
        return message

    def off(self, year: str = "2016") -> tuple[float, float]:
        """How far the camera is from a goal: m, rad."""
        joints = Goal.load(CONFIG / f"goal_{year}.yaml").joint_values(ARM.names)
        return pose_difference(self.arm.pose(joints), self.arm.pose(self.q))

    def restart(self) -> None:
        """As a simulator killed and started again: zero pose, clock back to its beginning."""
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
    """The controller node as a process of its own."""

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


@pytest.fixture
def plant(ros_node):
    rospy.set_param("/robot_description", URDF)
    rospy.set_param("/use_sim_time", True)
    played = Plant()
    yield played
    played.close()
    for name in ("/robot_description", "/use_sim_time", "/aras_visual_servo_controller"):
        if rospy.has_param(name):
            rospy.delete_param(name)


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


def test_goes_to_the_start_servoes_and_converges(plant, start, states, collect):
    twists = collect(f"{NAMESPACE}/controller/camera_twist", TwistStamped)
    reports = collect(f"{NAMESPACE}/controller/diagnosis", ServoReport)
    node = start("_scheme:=moments", "_start:=2016")
    wait_for(phase_is(states, "approaching"), 20.0, "the approach")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    first = next(m for m in states.messages if m.phase == "servoing")
    np.testing.assert_allclose(first.joint_positions, STARTS["2016"], atol=0.02)
    wait_for(phase_is(states, "converged"), 20.0, "convergence")

    last = states.messages[-1]
    assert last.feature_names == ["xn", "yn", "an", "alpha"]
    assert (np.abs(last.error) < (0.001, 0.003, 0.005, 0.01)).all()
    assert last.joint_names == list(ARM.names)
    assert last.header.frame_id == "camera_optical_frame"
    assert len(last.singular_values) == 4  # of L J
    assert twists.messages[-1].header.frame_id == "camera_optical_frame"
    report = wait_for(
        lambda: [m for m in reports.messages if m.outcome.startswith("converged")], 5.0, "reports"
    )[-1]
    assert report.rank == report.rank_lj == 4 and len(report.margins) == 6
    assert report.scale == 1.0 and report.joint_names == list(ARM.names)
    distance, angle = plant.off()
    assert distance < 0.5e-3
    assert angle < np.radians(0.3)
    assert node.stop() == 0
    assert "Traceback" not in node.output()


def test_lost_target_holds_and_resumes(plant, start, states):
    node = start("_start:=none")
    plant.command = plant.q = STARTS["2015"].copy()
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.valid = False
    wait_for(phase_is(states, "holding"), 5.0, "holding")
    assert states.messages[-1].reason == "no target in the image"
    time.sleep(0.3)  # smoothly to rest
    commands = {tuple(c) for c in plant.received[-6:]}
    time.sleep(0.3)
    assert {tuple(c) for c in plant.received[-6:]} <= commands
    plant.valid = True
    wait_for(phase_is(states, "converged"), 20.0, "convergence after the loss")
    assert "holding: no target in the image" in node.output()


def test_silence_is_named_and_waited_through(plant, start, states):
    node = start("_start:=none", "_image_timeout:=0.3", "_joint_timeout:=0.3")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.images = False
    wait_for(
        lambda: "no features on /aras_visual_servo/camera/moments" in states.messages[-1].reason,
        5.0,
        "waiting for images",
    )
    assert states.messages[-1].phase == "waiting"
    plant.joints = False
    wait_for(
        lambda: "no joint states" in states.messages[-1].reason, 5.0, "waiting for joint states"
    )
    plant.images = plant.joints = True
    wait_for(lambda: states.messages[-1].phase in ("servoing", "converged"), 5.0, "going on")
    assert node.output().count("waiting: ") < 10


@pytest.mark.parametrize("silent", ["images", "joints"])
def test_silence_stops_the_arm_smoothly(plant, start, states, silent):
    """By a thread of its own: within 0.2 s or three image periods, at a bounded deceleration."""
    start("_start:=none", "_gain:=1.0")
    plant.command = plant.q = STARTS["2016"].copy()
    wait_for(lambda: len(states.messages) > 15 and phase_is(states, "servoing")(), 20.0, "servoing")
    speed = np.abs(plant.received[-1] - plant.received[-13]).max()
    assert speed > 0.0
    setattr(plant, silent, False)
    time.sleep(1.0 / SPEED)
    rest = plant.command.copy()
    time.sleep(0.5)
    assert np.array_equal(plant.command, rest)


def test_paused_time_holds_until_it_goes_on(plant, start, states):
    start("_start:=none", "_wall_watchdog:=0.5")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.time = False
    time.sleep(1.2)
    rest = plant.command.copy()
    time.sleep(0.2)
    assert np.array_equal(plant.command, rest)
    plant.time = True
    wait_for(phase_is(states, "converged"), 20.0, "convergence after the pause")


def test_simulator_restarted_mid_run(plant, start, states):
    node = start("_start:=2015")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.restart()
    wait_for(phase_is(states, "approaching"), 5.0, "beginning anew")
    wait_for(phase_is(states, "converged"), 20.0, "convergence after the restart")
    assert "simulated time went back" in node.output()
    assert np.isfinite(plant.received).all()


@pytest.mark.parametrize("late", [0.02, 100.0])
def test_late_and_unstamped_images_do_not_restart_the_run(plant, start, states, late):
    node = start("_start:=none")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.late = late if late < 1.0 else (rospy.Time(0).to_sec() + 1.0)
    time.sleep(0.3)
    plant.late = 0.0
    wait_for(phase_is(states, "converged"), 20.0, "convergence")
    assert "went back" not in node.output()


def test_joints_that_cannot_be_measured_stop_the_arm(plant, start, states):
    node = start("_start:=none")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.strange = 1e308
    wait_for(phase_is(states, "holding"), 5.0, "holding")
    assert "gantry measured at 1e+308" in states.messages[-1].reason
    time.sleep(0.3)
    plant.strange = None
    assert np.abs(plant.received).max() < 10.0
    wait_for(phase_is(states, "converged"), 20.0, "convergence afterwards")
    assert "Traceback" not in node.output()


def test_a_camera_moved_in_a_description_that_comes_later(plant, start, states):
    """The node goes by the robot_description there is when joint states begin."""
    moved = URDF.replace(
        '<origin xyz="0 0 0.0334" rpy="3.14 -1.57 0"/>',
        '<origin xyz="0 0.03 0.0334" rpy="3.14 -1.57 0.3"/>',
    )
    assert moved != URDF
    plant.joints = plant.images = False
    plant.arm = Arm.from_urdf(moved)
    node = start("_start:=2016")
    wait_for(lambda: "scheme moments" in node.output(), 20.0, "the node")
    rospy.set_param("/robot_description", moved)
    plant.joints = plant.images = True
    wait_for(phase_is(states, "converged"), 30.0, "convergence")
    distance, angle = plant.off()
    assert distance < 0.5e-3
    assert angle < np.radians(0.3)


def test_without_a_description_it_waits_for_one(plant, start, states):
    rospy.delete_param("/robot_description")
    node = start("_start:=2016")
    wait_for(lambda: "no robot description on parameter" in node.output(), 20.0, "the complaint")
    rospy.set_param("/robot_description", URDF)
    wait_for(phase_is(states, "approaching"), 20.0, "the approach")


def test_kernel_scheme_wants_its_twenty_numbers_of_the_same_image(plant, start, states, collect):
    images = collect(f"{NAMESPACE}/camera/moments", ImageMoments)
    kernel = rospy.Publisher(f"{NAMESPACE}/camera/kernel", KernelFeatures, queue_size=1)
    plant.K = Goal.load(CONFIG / "goal_2015.yaml").kernel.K.ravel().tolist()
    start("_scheme:=kernel", "_start:=none", "_desired:=2015")

    def refused():
        stamps = [m.header.stamp for m in images.messages[-3:]]
        for stamp in stamps:
            message = KernelFeatures(data=[0.1, 0.2, 900.0, 0.0])
            message.header.stamp = stamp
            kernel.publish(message)
        time.sleep(0.05)
        return states.messages and "got 4" in states.messages[-1].reason

    wait_for(refused, 20.0, "the refusal of four numbers")
    kernel.unregister()


BROKEN = """
from aras_visual_servo_controller.features.moments import ImageMoments


class Broken(ImageMoments):
    seen = 0

    def measure(self, observation, goal):
        Broken.seen += 1
        if Broken.seen > 20:
            raise SystemExit("no more")
        return super().measure(observation, goal)
"""


def test_a_scheme_s_fault_holds_the_arm_and_is_told_once(plant, start, states, tmp_path):
    (tmp_path / "broken_scheme.py").write_text(BROKEN)
    node = start("_start:=none", "_scheme:=broken_scheme:Broken", path=tmp_path)
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    wait_for(phase_is(states, "holding"), 10.0, "holding")
    faulty = next(m for m in states.messages if m.phase == "holding")
    assert "scheme broken_scheme:Broken raised SystemExit: no more" in faulty.reason
    before = [m for m in states.messages if m.header.stamp < faulty.header.stamp][-1]
    assert (faulty.header.stamp - before.header.stamp).to_sec() < 0.08
    time.sleep(0.5)
    assert node.output().count("Traceback") == 1
    assert node.process.poll() is None


def test_start_stop_and_hold_are_services(plant, start, states):
    start("_start:=none", "_autostart:=false")
    wait_for(phase_is(states, "stopped"), 20.0, "standing by")
    assert not plant.received
    for name, phase in (
        ("start", "servoing"), ("hold", "holding"), ("start", "servoing"), ("stop", "stopped")
    ):  # fmt: skip
        service = f"{NAMESPACE}/controller/{name}"
        rospy.wait_for_service(service, 10.0)
        assert rospy.ServiceProxy(service, Trigger)().success
        wait_for(phase_is(states, phase), 10.0, phase)


def test_the_action_servoes_to_the_target_and_can_be_preempted(plant, start, states):
    start("_start:=none", "_autostart:=false")
    plant.command = plant.q = STARTS["2016"].copy()
    wait_for(phase_is(states, "stopped"), 20.0, "standing by")
    client = actionlib.SimpleActionClient(f"{NAMESPACE}/servo_to_target", ServoToTargetAction)
    assert client.wait_for_server(rospy.Duration(10.0))
    seen = []
    client.send_goal(ServoToTargetGoal(), feedback_cb=seen.append)
    wait_for(lambda: [f for f in seen if f.phase == "servoing"], 10.0, "feedback")
    client.cancel_goal()
    assert wait_for(client.get_result, 10.0, "the preemption").outcome == "stopped"
    assert client.get_state() == GoalStatus.PREEMPTED
    wait_for(phase_is(states, "stopped"), 5.0, "standing")
    client.send_goal(ServoToTargetGoal(timeout=20.0), feedback_cb=seen.append)
    result = wait_for(client.get_result, 30.0, "success")
    assert client.get_state() == GoalStatus.SUCCEEDED
    assert result.outcome.startswith("converged")
    assert (np.abs(result.error) < (0.001, 0.003, 0.005, 0.01)).all()
    last = [f for f in seen if f.margins][-1]
    assert last.rank == 4 and len(last.margins) == 6 and len(last.error) == 4


def test_gains_can_be_changed_while_it_runs(plant, start, states):
    start("_start:=none", "_gain:=0.5")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    client = Client("/aras_visual_servo_controller/gains", timeout=10.0)
    assert client.get_configuration(timeout=5.0)["gain"] == 0.5
    assert client.update_configuration({"gain": 6.0})["gain"] == 6.0
    wait_for(phase_is(states, "converged"), 10.0, "convergence")
    client.close()


def test_a_dry_run_sends_nothing(plant, start, states):
    start("_start:=none", "_dry:=true")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    time.sleep(0.5)
    assert not plant.received
    assert np.abs(states.messages[-1].camera_twist.linear.x) >= 0.0
    assert any(np.abs(m.joint_velocities).max() > 0.0 for m in states.messages)


def test_a_dry_run_over_a_recorded_bag_answers_its_images_and_sends_nothing(
    ros_node, ros_master, start, states, collect, tmp_path
):
    """What was recorded while another loop servoed: this one says what it would have done."""
    q, path = STARTS["2016"], tmp_path / "run.bag"
    with rosbag.Bag(str(path), "w") as bag:
        for tick in range(360):
            stamp = rospy.Time.from_sec(10.0 + tick / 90.0)
            joints = JointState(name=list(ARM.names), position=q.tolist(), velocity=[0.0] * 6)
            joints.header.stamp = stamp
            bag.write(f"{NAMESPACE}/joint_states", joints, stamp)
            if tick % 3 == 0:
                bag.write(f"{NAMESPACE}/camera/moments", image_of(ARM, q, stamp), stamp)
    rospy.set_param("/robot_description", URDF)
    rospy.set_param("/use_sim_time", True)
    heard = [collect(f"{NAMESPACE}/{CONTROLLERS[name]}/command", Float64) for name in ARM.names]
    start("_start:=none", "_desired:=2016", "_dry:=true")
    wait_for(lambda: "/aras_visual_servo_controller" in ros_master.nodes(), 20.0, "the node")
    play = subprocess.Popen(
        ["rosbag", "play", "--clock", "--quiet", "--delay", "1", str(path)],
        env=dict(ros_master.environment), stdin=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        answered = wait_for(
            lambda: [m for m in states.messages if m.phase == "servoing"][30:], 30.0, "answers"
        )
    finally:
        play.terminate()
        play.wait(10.0 * PATIENCE)
        for name in ("/robot_description", "/use_sim_time"):
            rospy.delete_param(name)
    assert all(np.abs(m.joint_velocities).max() > 0.01 for m in answered)
    assert all(10.0 <= m.header.stamp.to_sec() <= 14.0 for m in answered)
    np.testing.assert_allclose(answered[-1].joint_positions, q, atol=1e-9)
    assert not any(topic.messages for topic in heard)


def test_velocity_output_ends_with_zero(plant, start, states, collect):
    """Controllers by parameter; what is left behind when the node dies is zero."""
    topic = f"{NAMESPACE}/group_velocity_controller/command"
    speeds = collect(topic, Float64MultiArray)
    node = start("_start:=none", "_output:=velocity", f"_command_topic:={topic}")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    wait_for(lambda: speeds.messages and np.any(speeds.messages[-1].data), 10.0, "speeds")
    assert len(speeds.messages[-1].data) == 6 and not plant.received
    assert node.stop() == 0
    wait_for(lambda: not np.any(speeds.messages[-1].data), 5.0, "zero")


@pytest.fixture
def controllers():
    """Puts parameters of controllers where a robot's are, and takes them away."""
    put = []

    def add(name, kind, **joints):
        put.append(f"{NAMESPACE}/{name}")
        rospy.set_param(put[-1], {"type": f"effort_controllers/Joint{kind}Controller", **joints})

    yield add
    for name in put:
        rospy.delete_param(name)


def test_controllers_are_found_by_joint_and_type(plant, start, states, collect, controllers):
    """Beside those of positions, which the robot's own file names; who is not there is named."""
    for name in ARM.names:
        controllers(CONTROLLERS[name], "Position", joint=name)
        controllers(f"turns_{name}", "Velocity", joint=name)
    heard = {n: collect(f"{NAMESPACE}/turns_{n}/command", Float64) for n in ARM.names[:-1]}
    node = start("_start:=none", "_output:=velocity")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    wait_for(lambda: all(topic.messages for topic in heard.values()), 10.0, "speeds")
    wait_for(lambda: "nobody takes the commands" in node.output(), 20.0, "a warning")
    (told, *_) = [line for line in node.output().splitlines() if "nobody takes" in line]
    assert f"on {NAMESPACE}/turns_{ARM.names[-1]}/command: start that controller" in told
    assert not plant.received


def test_a_group_gets_the_numbers_in_its_own_order(plant, start, states, controllers):
    order = (*ARM.names[2:], *ARM.names[:2])
    controllers("whole", "GroupPosition", joints=list(order))

    def taken(message):
        for name, value in zip(order, message.data, strict=True):
            plant.command[ARM.names.index(name)] = value

    topic = rospy.Subscriber(f"{NAMESPACE}/whole/command", Float64MultiArray, taken)
    start("_start:=2016")
    try:
        wait_for(phase_is(states, "converged"), 30.0, "the goal")
    finally:
        topic.unregister()
    assert not plant.received
    distance, angle = plant.off()
    assert distance < 1e-3 and angle < 0.01


def test_controllers_of_another_kind_end_the_node_in_one_line(plant, start, controllers):
    controllers(CONTROLLERS["J2"], "Position", joint="J2")
    node = start("_output:=velocity")
    assert node.process.wait(20.0 * PATIENCE) == 1
    lines = [line for line in node.output().splitlines() if line.strip()]
    assert len(lines) == 1 and (
        f"takes velocity commands for J2 ({CONTROLLERS['J2']} takes position)" in lines[0]
    )


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("_gian:=3", "unknown parameter ~gian: did you mean 'gain'"),
        ("_scheme:=nothing", "unknown scheme 'nothing'"),
        ("_desired:=/nowhere.yaml", "/nowhere.yaml"),
        ("_desired:=/dev/zero", "/dev/zero"),
        ("_law:=adaptve", "did you mean 'adaptive'"),
    ],
)
def test_wrong_parameters_end_the_node_in_one_line(ros_node, start, argument, words):
    node = start(argument)
    assert node.process.wait(20.0 * PATIENCE) == 1
    lines = [line for line in node.output().splitlines() if line.strip()]
    assert len(lines) == 1
    assert words in lines[0]


def test_what_does_not_fit_the_robot_ends_the_node_in_one_line(plant, start):
    node = start("_camera_frame:=camera_lnk")
    assert node.process.wait(20.0 * PATIENCE) == 1
    lines = [line for line in node.output().splitlines() if line.strip()]
    assert len(lines) == 1 and "no link camera_lnk; did you mean 'camera_link'" in lines[0]


def test_master_gone_ends_the_node(start, tmp_path):
    master = RosMaster(tmp_path)
    try:
        node = start(master=master)
        wait_for(lambda: "/aras_visual_servo_controller" in master.nodes(), 20.0, "the node")
        time.sleep(2.5)  # it has asked the living master at least once
    finally:
        master._process.terminate()
        master._process.wait()
    assert node.process.wait(20.0 * PATIENCE) == 0
    assert "the ROS master does not answer any more: ending" in node.output()
    assert "Traceback" not in node.output()
    master._output.close()
