"""Controllers on the graph: command topic, reconfiguration of a PID, goals, and errors.

What each type computes: tests/unit/control; what is told of it: tests/unit/ros.

The robots and the world that they stand in: see controller_rig.py.
"""

from __future__ import annotations

import math
import sys

import actionlib
import pytest
import rospy
from actionlib_msgs.msg import GoalStatus
from control_msgs.msg import (
    FollowJointTrajectoryAction,
    FollowJointTrajectoryGoal,
    FollowJointTrajectoryResult,
    JointControllerState,
    JointTrajectoryControllerState,
    PidState,
)
from control_msgs.srv import QueryTrajectoryState
from controller_rig import DT, MASS, call, step
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from genpy import Message
from ros_graph import wait_for
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytest_plugins = ["controller_rig"]

UNDER_WAY = (GoalStatus.PENDING, GoalStatus.ACTIVE)
WRONG_TYPE = """
import sys, time, rospy
from std_msgs.msg import String

rospy.init_node("wrong", anonymous=True)
publisher = rospy.Publisher(sys.argv[1], String, queue_size=1, latch=True)
publisher.publish("5.0")
time.sleep(0.5)
print(publisher.get_num_connections(), "connections")
"""
NAMES = ["cart", "servo", "slide", "table", "wheel", "dummy"]  # as joint_states has them


def test_joint_states_are_alphabetical_with_extra_joints(rig):
    message = rig.at(step(1))
    assert message.name == NAMES
    assert message.position[-1] == 0.5
    assert message.header.frame_id == ""


def test_effort_controller_pushes_with_its_force(rig):
    rig.start("push")
    rig.send("push", 3.0)
    rig.until("cart", "effort", lambda f: f == 3.0)
    before = rig.see("cart", "velocity")
    assert rig.see("cart", "velocity", 100) - before == pytest.approx(3.0 / MASS * 0.1, rel=1e-6)
    rig.send("push", 500.0)  # beyond the limit of 100 N
    rig.until("cart", "effort", lambda f: f == 100.0)
    rig.send("push", 0.0)
    rig.until("cart", "effort", lambda f: f == 0.0)


def test_effort_position_controller_and_its_pid(rig, collect):
    rig.start("turn")
    states = collect("/rig/turn/state", JointControllerState)
    terms = collect("/rig/turn/pid/state", PidState)
    for topic in (states, terms):
        wait_for(topic.connected, 5.0, topic.topic)
    rig.send("turn", 3.5)  # the short way round is -2.78
    step(1)
    state = wait_for(
        lambda: step(10) and [m for m in states.messages if m.set_point == 3.5], 5.0, "state"
    )[-1]
    short = 3.5 - 2.0 * math.pi
    assert state.error == pytest.approx(short - state.process_value, abs=1e-9)
    step(1)
    term = terms.wait(1, 5.0, where=lambda m: m.error < -0.5)
    assert term.p_term == pytest.approx(20.0 * term.error)
    assert term.d_term == pytest.approx(4.0 * term.error_dot)
    assert term.output == pytest.approx(term.p_term + term.i_term + term.d_term)
    assert term.timestep.to_sec() == pytest.approx(DT)
    request = Config(doubles=[DoubleParameter("p", 30.0)])
    call("/rig/turn/pid/set_parameters", Reconfigure, request)
    assert rospy.get_param("/rig/turn/pid/p") == 30.0
    states.clear()
    step(20)
    assert states.wait(1, 5.0, where=lambda m: m.p == 30.0).d == 4.0
    assert rig.see("table", steps=4000) == pytest.approx(short, abs=1e-3)


def test_wrong_type_and_nan_on_a_command_topic(rig, rig_world, ros_master):
    rig.start("push")
    # In a process of its own: rospy has one type a topic and process.
    seen = ros_master.run([sys.executable, "-c", WRONG_TYPE, "/rig/push/command"])
    assert seen.stdout.strip() == "0 connections"
    assert rig.see("cart", "effort", 5) == 0.0
    rig.send("push", 2.0)
    rig.until("cart", "effort", lambda f: f == 2.0)
    for value in (math.nan, math.inf):
        rig.send("push", value)
    wait_for(lambda: "is not finite" in rig_world.output(), 5.0, "the complaint")
    assert rig.see("cart", "effort", 3) == 2.0


def goal_for(names, points, **fields) -> FollowJointTrajectoryGoal:
    """A goal of (time [s], positions) pairs."""
    trajectory = JointTrajectory(joint_names=names)
    for time, positions in points:
        point = JointTrajectoryPoint(positions=positions)
        point.time_from_start = rospy.Duration.from_sec(time)
        trajectory.points.append(point)
    return FollowJointTrajectoryGoal(trajectory=trajectory, **fields)


def client_of(controller: str) -> actionlib.SimpleActionClient:
    client = actionlib.SimpleActionClient(
        f"{controller}/follow_joint_trajectory", FollowJointTrajectoryAction
    )
    assert client.wait_for_server(rospy.Duration(10.0))
    return client


def finish(client: actionlib.SimpleActionClient, steps: int = 20) -> Message:
    """Step until the goal has ended."""
    wait_for(lambda: step(steps) and client.get_state() not in UNDER_WAY, 10.0, "the goal's end")
    client.wait_for_result(rospy.Duration(2.0))
    return client.get_result()


def test_trajectory_goal_is_followed_and_can_be_queried(rig, collect):
    rig.start("path")
    states = collect("/rig/path/state", JointTrajectoryControllerState)
    wait_for(states.connected, 5.0, "state topic")
    feedback = []
    step(1)  # it has a next update only after the first
    client = client_of("/rig/path")
    # The order of the joints is the goal's own.
    goal = goal_for(["servo", "slide"], [(0.4, [0.4, 0.2]), (0.8, [0.0, 0.4])])
    client.send_goal(goal, feedback_cb=feedback.append)
    wait_for(lambda: client.get_state() == GoalStatus.ACTIVE, 5.0, "the goal's acceptance")
    begin = step(1)
    step(200)
    at = rospy.Time.from_sec(begin / 1e9 + 0.2)
    seen = call("/rig/path/query_state", QueryTrajectoryState, at)
    assert seen.name == ["slide", "servo"]
    assert seen.position == pytest.approx([0.1, 0.2], abs=1e-9)
    assert seen.velocity == pytest.approx([0.5, 1.0], abs=1e-9)
    state = states.wait(1, 5.0, where=lambda m: m.header.stamp.to_nsec() >= begin + 100_000_000)
    assert state.joint_names == ["slide", "servo"]
    elapsed = (state.header.stamp.to_nsec() - begin) / 1e9
    assert state.desired.positions == pytest.approx([0.5 * elapsed, elapsed], abs=1e-9)
    assert state.error.positions[0] == pytest.approx(
        state.desired.positions[0] - state.actual.positions[0]
    )
    result = finish(client)
    assert client.get_state() == GoalStatus.SUCCEEDED, result.error_string
    assert result.error_code == FollowJointTrajectoryResult.SUCCESSFUL
    assert len(feedback) >= 5
    assert rig.see("slide") == pytest.approx(0.4, abs=1e-3)


def test_a_goal_is_cancelled(rig):
    rig.start("path")
    client = client_of("/rig/path")
    client.send_goal(goal_for(["slide", "servo"], [(2.0, [0.5, 0.5])]))
    wait_for(lambda: client.get_state() == GoalStatus.ACTIVE, 5.0, "the goal's acceptance")
    held = rig.see("slide", steps=100)
    client.cancel_goal()
    wait_for(lambda: client.get_state() not in UNDER_WAY, 5.0, "the goal's end, while time stands")
    assert client.get_state() == GoalStatus.PREEMPTED
    # It holds where it was read last, and has gone on from there for one step, as in ros_control.
    assert rig.see("slide") > held + 1e-4
    for steps in (1, 100):
        assert rig.see("slide", steps=steps) == pytest.approx(held, abs=1e-6)


def test_log_holds_no_traceback(rig_world):
    assert "Traceback" not in rig_world.output()
