"""Controller node on a real graph, with the simulated robot of played_robot.py.

What disturbs a run: test_controller_disturbed.py.
"""

from __future__ import annotations

import subprocess
import time

import actionlib
import numpy as np
import pytest
import rosbag
import rospy
from actionlib_msgs.msg import GoalStatus
from aras_visual_servo_controller.msg import ServoReport, ServoToTargetAction, ServoToTargetGoal
from geometry_msgs.msg import TwistStamped
from played_robot import (
    ARM,
    CONTROLLERS,
    NAMESPACE,
    STARTS,
    URDF,
    described,
    forgotten,
    image_of,
    phase_is,
)
from ros_graph import PATIENCE, wait_for
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from aras_visual_servo_controller.kinematics import Arm

pytest_plugins = ["played_robot"]


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


def test_simulator_restarted_mid_run(plant, start, states):
    node = start("_start:=2015")
    wait_for(phase_is(states, "servoing"), 20.0, "servoing")
    plant.restart()
    wait_for(phase_is(states, "approaching"), 5.0, "beginning anew")
    wait_for(phase_is(states, "converged"), 20.0, "convergence after the restart")
    assert "simulated time went back" in node.output()
    assert np.isfinite(plant.received).all()


@pytest.mark.parametrize("during", ["approaching", "converged"])
def test_another_node_s_commands_are_named_and_the_loop_continues_after_them(
    plant, start, states, during
):
    """The loop sent nothing any more and blamed the controllers."""
    start("_gain:=3.0", "_start:=2015", "_approach_speed:=1.0")
    wait_for(phase_is(states, during), 60, during)
    joint = f"{NAMESPACE}/{CONTROLLERS['J6']}/command"
    other = rospy.Publisher(joint, Float64, queue_size=1, tcp_nodelay=True)
    parked = Float64(plant.q[5] + 0.2)

    def named():
        other.publish(parked)
        return f"{rospy.get_name()} commands J6" in states.messages[-1].reason

    wait_for(named, 60, "the reason that names the other node")
    count = len(plant.received)
    for _ in range(50):
        other.publish(parked)
        time.sleep(0.01)
    assert sum(q[5] != parked.data for q in plant.received[count:]) < 20  # on their way before
    states.messages.clear()
    wait_for(phase_is(states, "converged"), 60, "convergence once the other node is silent")
    assert rospy.get_name() not in states.messages[-1].reason
    other.unregister()


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
    wait_for(lambda: all(plant.connections()), 20.0, "the node")
    before = plant.connections()
    rospy.set_param("/robot_description", moved)
    plant.joints = plant.images = True
    wait_for(phase_is(states, "converged"), 30.0, "convergence")
    assert node.output().count("scheme moments") == 2
    assert plant.connections() == before  # rospy may not take up one that ends and comes again
    distance, angle = plant.off()
    assert distance < 0.5e-3
    assert angle < np.radians(0.3)


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


def test_services_and_an_action_start_stop_and_hold(plant, start, states):
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
    described()
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
        forgotten()
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
