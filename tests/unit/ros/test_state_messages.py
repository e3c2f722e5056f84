"""States of the loop are restored from their messages, and are sent to subscribers."""

import math
from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from run_messages import ARM, JOINTS, SETTINGS, K, joint_states, made_state, position, same, told
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo

from aras_visual_servo_bench.ros.graph_listener import GraphListener
from aras_visual_servo_controller.records.outcomes import ArrivalStatus
from aras_visual_servo_controller.records.state import JointCommand, ServoState
from aras_visual_servo_controller.settings import ControllerSettings


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


def test_every_field_of_a_state_is_sent_and_read_again(graph, face):
    from aras_visual_servo_controller.ros.recorded_messages import read_state

    state = made_state(3.217654321)
    message, report = told(graph, face, state)
    for one in (message, report):
        assert one.header.stamp == rospy.Time(3, 217654321)
        assert one.header.frame_id == "camera_optical_frame" and one.joint_names == list(JOINTS)
    assert message.scheme == "points" and (report.reason, report.remedy) == ("slow", "wait")
    back = read_state(message, report)
    for name in ("phase", "outcome", "reason", "remedy", "scheme", "computation_time", "names",
                 "stamp"):
        assert getattr(back, name) == getattr(state, name), name
    for name in ("desired_twist", "achieved_twist", "singular_values_L", "command", "error"):
        same(getattr(back, name), getattr(state, name))
    for name in ("features", "desired", "filtered_error"):
        same(getattr(back.scheme_output, name), getattr(state.scheme_output, name))
    for name in ("velocities", "singular_values", "scale", "manipulability"):
        same(getattr(back.ik_solution, name), getattr(state.ik_solution, name))
    same(back.joints.positions, state.joints.positions)
    assert back.joints.names == JOINTS and back.arrival_status == state.arrival_status
    for name in ("margins", "null_direction"):
        same(getattr(report, name), getattr(state.ik_solution, name))
    lost = report.infeasible_twist
    same([lost.linear.x, lost.linear.y, lost.linear.z, lost.angular.x, lost.angular.y,
          lost.angular.z], state.ik_solution.infeasible_twist)  # fmt: skip
    assert (report.rank, report.rank_lj) == (3, 2)
    same(report.singular_values_lj, message.singular_values)
    said = {topic: one for topic, one in graph.told().items() if "/controller/" in topic}
    assert len(said) == 3 and {one[1:] for one in said.values()} == {(5, False)}
    twist = graph.publishers["/two/controller/camera_twist"].sent[-1]
    assert twist.twist == message.camera_twist and twist.header == message.header
    for message in told(graph, face, state):  # or a field would be 0 or empty for ever
        blank = type(message)()
        unset = [name for name in message.__slots__
                 if getattr(message, name) == getattr(blank, name)]  # fmt: skip
        assert not unset, f"{type(message).__name__}: set {', '.join(unset)} in ros/messages.py"


def test_what_a_state_has_not_is_not_made_up(graph, face):
    from aras_visual_servo_controller.ros.recorded_messages import read_state

    bare = ServoState(2.5, "holding", reason="no image", arrival_status=ArrivalStatus())
    message, report = told(graph, face, bare)
    assert message.feature_names == [] and message.joint_velocities == [0.0, 0.0]
    assert report.scale == 1.0 and math.isnan(report.open_distance)
    back = read_state(message, report)
    assert back.scheme_output is back.ik_solution is back.joints is back.command is None
    assert not back.arrival_status.is_reached and back.reason == "no image"
    alone = read_state(told(graph, face, made_state(1.0))[0])  # of a bag without reports
    assert (alone.outcome, alone.remedy) == ("", "") and math.isnan(alone.computation_time)
    assert np.isnan(alone.achieved_twist).all() and not alone.arrival_status.is_reached
    assert alone.scheme_output.filtered_error is None
    parts = {"features": ["scheme_output", "ik_solution"],
             "desired_features": ["scheme_output", "ik_solution"],
             "error": ["scheme_output", "ik_solution"], "joint_positions": ["joints"],
             "joint_commands": ["command"], "singular_values": ["ik_solution"]}
    for field, without in parts.items():  # as somebody else's message may be
        message, report = told(graph, face, made_state(1.0))
        setattr(message, field, [])
        back = read_state(message, report)
        assert [part for part in ("scheme_output", "ik_solution", "joints", "command")
                if getattr(back, part) is None] == without, field
    message, report = told(graph, face, made_state(1.0))
    report.filtered_error = report.filtered_error[:2]
    assert read_state(message, report).scheme_output.filtered_error is None


def test_states_are_logged_when_they_are_new(graph, face, clock, monkeypatch):
    levels = []
    for name in ("loginfo", "logwarn", "logerr"):
        monkeypatch.setattr(rospy, name, lambda text, *a, name=name: levels.append(
            (name, text % a)))
    for phase, reason, wait in (
        ("servoing", "", 0), ("servoing", "", 9), ("servoing", "slow", 1), ("servoing", "slow", 3),
        ("holding", "no image", 0), ("holding", "another", 4), ("holding", "third", 1.5),
        ("converged", "", 0), ("approaching", "far", 0),
    ):  # fmt: skip
        clock[0] += wait
        face.report(made_state(1.0, phase, reason=reason))
    assert levels == [("loginfo", "servoing"), ("loginfo", "servoing: slow"),
                      ("logwarn", "holding: no image"), ("logwarn", "holding: third"),
                      ("loginfo", "converged"), ("loginfo", "approaching: far")]
    face.log("one line")
    face.log("Traceback\n  of a fault")
    assert levels[-2:] == [("loginfo", "one line"), ("logerr", "Traceback\n  of a fault")]


def test_commands_reach_their_controllers_in_their_order(graph, face, clock, monkeypatch):
    from aras_visual_servo_controller.ros.command_publishers import CommandPublishers, publish

    group = graph.publishers["/two/both"]
    group.resolved_name = "/two/both"
    assert group.options == {"queue_size": 10}
    for _ in range(4):
        face.send(JointCommand(1.0, JOINTS, np.array([0.1, 0.2])))
        face.send(JointCommand(1.0, JOINTS))
        clock[0] += 3.0
    assert [list(one.data) for one in group.sent] == [[0.1, 0.2]] * 4
    assert graph.lines == [
        "no controller subscribes to /two/both: start that controller (rosrun controller_manager "
        "controller_manager list), or name another one in ~controllers"]
    face.close()
    assert not graph.publishers
    kind = "position_controllers/Joint{}Controller"
    graph.parameters |= {"/two/all/type": kind.format("GroupPosition"),
                         "/two/all/joints": ["elbow", "slide"]}
    settings = ControllerSettings(namespace="/two")
    CommandPublishers(settings, JOINTS, "position").send(np.array([0.1, 0.2]), "slide")
    assert graph.publishers["/two/all/command"].options == {"queue_size": 10}
    assert [list(one.data) for one in graph.publishers["/two/all/command"].sent] == [[0.2, 0.1]]
    graph.parameters |= {"/two/s/type": kind.format("Position"), "/two/s/joint": "slide"}
    graph.parameters.pop("/two/all/type")
    topics = CommandPublishers(settings, JOINTS, "position")
    each = [graph.publishers[f"/two/{name}/command"] for name in ("s", "elbow_position_controller")]
    assert {one.options["queue_size"] for one in each} == {10}
    topics.send(np.array([0.3, 0.4]))
    topics.send(np.array([0.5, 0.6]), "elbow")
    assert [[m.data for m in one.sent] for one in each] == [[0.3], [0.4, 0.6]]
    for one in each:
        one.resolved_name = one.topic
    each[0].impl.connections = [None]
    assert topics.list_unsubscribed() == ["/two/elbow_position_controller/command"]
    topics.close()
    with pytest.raises(rospy.ROSException, match="closed topic"):
        publish(each[0], None)
    monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: True)
    publish(each[0], None)  # while the node ends nobody is told


def test_a_recorder_is_waited_for_no_longer_than_it_takes(graph, clock, monkeypatch):
    from aras_visual_servo_controller.ros.ros_publisher import RosPublisher

    monkeypatch.setattr("time.sleep", lambda seconds: clock.__setitem__(0, clock[0] + seconds))
    two = RosPublisher(ControllerSettings(namespace="/two", command_topic="both", listeners=2),
                       JOINTS, "eye")
    two.state_publisher.impl.connections = [None]
    two.wait_for_listeners()
    assert 105.0 < clock[0] < 105.1 and "has 1 of 2 subscribers after 5 s" in graph.lines[0]
    two.state_publisher.impl.connections = [None, None]
    two.wait_for_listeners()
    assert clock[0] < 105.1 and len(graph.lines) == 1


@pytest.fixture
def listener(graph, clock):
    it = GraphListener(SETTINGS)
    graph.parameters["/robot_description"] = ARM
    it.update()
    return it


def hear(graph, topic, message):
    if topic == "/two/joint_states":
        content = BytesIO()
        message.serialize(content)
        message = SimpleNamespace(_buff=content.getvalue())
    graph.subscribers[topic](message)


def test_a_listener_knows_what_the_graph_said_last(graph, listener, face):
    from aras_visual_servo_camera.msg import ImageMoments

    from aras_visual_servo_controller.ros.goal_publishers import (
        make_outline_message,
        make_pose_message,
    )

    assert (listener.robot_name, listener.robot_count, listener.restart_count) == ("two", 1, 1)
    assert listener.stamp == 0.0 and listener.run_trace.arm.names == JOINTS
    hear(graph, "/two/joint_states", joint_states(1.5))
    story = listener.refresh()
    same(listener.positions, position(1.5))
    same(listener.velocities, [-0.11, 0.2])
    waiting = {topic: more.pop("queue_size") for topic, (_, more) in graph.heard.items()}
    each = {"/two/controller/state", "/two/camera/moments"}  # of which a path is drawn
    assert {topic for topic, many in waiting.items() if many == 10} == each
    assert {many for topic, many in waiting.items() if topic not in each} == {1}
    assert all(more == {"tcp_nodelay": True} for _, more in graph.heard.values())
    same(story.pose, story.arm.pose(position(1.5)))
    assert listener.stamp == 1.5
    goal = np.eye(4)
    goal[:3, :3] = Rotation.from_rotvec([0.3, -2.0, 0.5]).as_matrix()
    goal[:3, 3] = (0.4, 0.5, 0.6)
    outline = np.array([(0.1, 0.2), (0.3, -0.4), (-0.5, 0.6)])
    hear(graph, "/two/controller/goal", make_pose_message(goal, "base"))
    hear(graph, "/two/controller/desired_outline", make_outline_message(outline, "eye"))
    hear(graph, "/eye/camera/camera_info", CameraInfo(
        width=64, height=48, K=K, D=[0.0] * 5, distortion_model="plumb_bob"))
    story = listener.refresh()
    same(story.goal, goal)
    np.testing.assert_allclose(story.outline, outline, atol=1e-7)
    assert (story.camera.width, story.camera.K) == (64, K)
    heard = []
    listener.on_state = lambda state, joints: heard.append((state, list(joints)))
    message, report = told(graph, face, made_state(1.6))
    hear(graph, "/two/controller/diagnosis", report)
    hear(graph, "/two/controller/state", message)
    assert listener.report is report and story.state.outcome == "running"
    (state, joints), = heard
    same(joints, position(1.6))
    same(state.achieved_twist, made_state(1.6).achieved_twist)
    other = told(graph, face, made_state(1.7, "holding"))[0]  # the report is of another phase
    hear(graph, "/two/controller/state", other)
    assert story.state.phase == "holding" and story.state.outcome == ""
    hear(graph, "/two/controller/state", message)
    seen = []
    story.add_image_point = lambda *given: seen.append(given)
    for valid, m in ((True, [4.0, 1.0, -2.0]), (False, [4.0, 1.0, -2.0]), (True, [0.0, 1.0, 2.0]),
                     (True, [4.0, 1.0])):  # fmt: skip
        hear(graph, "/two/camera/moments", ImageMoments(valid=valid, m=m, reason="dark"))
        assert listener.no_target_reason == ("" if valid else "dark")
    assert seen == [("centre", 0.25, -0.5)]
    listener.clear_controller()
    assert listener.report is None and story.state.phase == ""


def test_a_clock_that_goes_back_and_another_robot_begin_anew(graph, listener, clock):
    for stamp in (1.0, 1.5):
        hear(graph, "/two/joint_states", joint_states(stamp))
        story = listener.refresh()
        clock[0] += 0.5
    assert story.factor == pytest.approx(1.0)
    clock[0] += 1.5
    assert listener.refresh().factor == pytest.approx(1.0)  # heard 2 s ago
    clock[0] += 0.001
    assert listener.refresh().factor is None
    cleared = []
    story.clear = lambda: cleared.append(True)
    hear(graph, "/two/joint_states", joint_states(1.5))
    listener.refresh()
    assert listener.restart_count == 1 and not cleared
    hear(graph, "/two/joint_states", joint_states(0.2))
    listener.refresh()
    assert listener.restart_count == 2 and cleared and listener.stamp == pytest.approx(0.2)
    clock[0] += 2.5
    assert listener.refresh().factor is None  # nothing was heard for so long
    hear(graph, "/two/joint_states", SimpleNamespace(serialize=lambda f: f.write(b"\1")))
    listener.refresh()  # no message: it is as before
    same(listener.positions, position(0.2))
    graph.parameters["/robot_description"] = ARM.replace('"two"', '"three"')
    clock[0] += 1.0
    assert listener.update() is not story
    assert (listener.robot_name, listener.robot_count, listener.restart_count) == ("three", 2, 3)
    assert listener.positions is None
