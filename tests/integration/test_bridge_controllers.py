"""Every controller type on the graph, against numbers worked out by hand from ros_control's rules.

The robots and the world that they stand in: see controller_rig.py.
"""

from __future__ import annotations

import math
import sys
from contextlib import suppress
from itertools import pairwise

import actionlib
import pytest
import rospy
from actionlib_msgs.msg import GoalStatus
from control_msgs.msg import (
    FollowJointTrajectoryAction,
    FollowJointTrajectoryGoal,
    FollowJointTrajectoryResult,
    GripperCommand,
    GripperCommandAction,
    GripperCommandGoal,
    JointControllerState,
    JointTolerance,
    JointTrajectoryControllerState,
    PidState,
)
from control_msgs.srv import QueryTrajectoryState
from controller_rig import DT, INERTIA, MASS, call, step
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from genpy import Message
from ros_graph import GraphError, wait_for
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytest_plugins = ["controller_rig"]

WRONG_TYPE = """
import sys, time, rospy
from std_msgs.msg import String

rospy.init_node("wrong", anonymous=True)
publisher = rospy.Publisher(sys.argv[1], String, queue_size=1, latch=True)
publisher.publish("5.0")
time.sleep(0.5)
print(publisher.get_num_connections(), "connections")
"""
NAMES = ["cart", "motor", "servo", "slide", "table", "wheel", "dummy"]  # as joint_states has them


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


def test_stopping_an_effort_controller_leaves_its_effort(rig):
    rig.start("push")
    rig.send("push", 1.0)
    rig.until("cart", "effort", lambda f: f == 1.0)
    assert rig.switch([], ["push"])
    assert rig.see("cart", "effort", 5) == 1.0
    assert rig.switch(["push"])  # starting() commands 0
    assert rig.see("cart", "effort", 3) == 0.0


def test_effort_velocity_controller_is_a_pid_on_velocity(rig, collect):
    rig.start("spin")
    states = collect("/rig/spin/state", JointControllerState)
    wait_for(states.connected, 5.0, "state topic")
    rig.send("spin", 1.0)
    rig.until("table", "effort", lambda f: f > 0.5)
    step(50)
    state = states.wait(4, 5.0, where=lambda m: m.set_point == 1.0)
    assert state.command == pytest.approx(2.0 * (1.0 - state.process_value))
    assert state.error == pytest.approx(1.0 - state.process_value)
    assert state.process_value_dot == 0.0
    assert (state.p, state.i, state.d, state.time_step) == (2.0, 0.0, 0.0, DT)
    # v' = p (1 - v) / I: the gap shrinks by (1 - p dt / I) a step, and states come every tenth.
    gaps = [m.error for m in states.messages if m.set_point == 1.0][1:]
    shrink = (1.0 - 2.0 * DT / INERTIA) ** 10
    assert [b / a for a, b in pairwise(gaps)] == pytest.approx([shrink] * (len(gaps) - 1))


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


def test_position_controller_sets_positions_within_the_limits(rig):
    rig.start("slide_to")
    rig.send("slide_to", 0.5)
    begin = rig.until("slide", "position", lambda x: x > 0.0)
    assert rig.see("slide", steps=10) - begin == pytest.approx(10 * 2.0 * DT)  # max_velocity 2
    assert rig.see("slide", steps=400) == pytest.approx(0.5, abs=1e-9)
    rig.send("slide_to", 5.0)
    rig.until("slide", "position", lambda x: x > 0.5)
    assert rig.see("slide", steps=600) == pytest.approx(1.0, abs=1e-9)
    assert rig.switch([], ["slide_to"])
    assert rig.see("slide", steps=10) == pytest.approx(1.0, abs=1e-9)


def test_position_joint_with_gains_is_driven_by_their_pid(rig, collect):
    gains = "/rig/gazebo_ros_control/pid_gains/servo"
    rig.start("servo_to")
    terms = collect(f"{gains}/state", PidState)
    wait_for(terms.connected, 5.0, "pid state")
    rig.send("servo_to", 1.0)
    rig.until("servo", "effort", lambda f: f > 1.0)
    step(2)
    term = terms.wait(1, 5.0, where=lambda m: m.error > 0.01)
    assert term.output == pytest.approx(40.0 * term.error + 8.0 * term.error_dot)
    assert rig.see("servo", steps=3000) == pytest.approx(1.0, abs=1e-3)
    call(f"{gains}/set_parameters", Reconfigure, Config(doubles=[DoubleParameter("p", 50.0)]))
    assert rospy.get_param(f"{gains}/p") == 50.0
    terms.clear()
    rig.send("servo_to", 1.5)
    rig.until("servo", "effort", lambda f: f > 1.0)
    step(2)
    term = terms.wait(1, 5.0, where=lambda m: m.error > 0.01)
    assert term.p_term == pytest.approx(50.0 * term.error)
    call(f"{gains}/set_parameters", Reconfigure, Config(doubles=[DoubleParameter("p", 40.0)]))


def test_velocity_controllers_with_and_without_gains(rig):
    rig.start("roll", "motor_roll")
    rig.send("roll", 1.5)
    rig.send("motor_roll", -2.0)
    rig.until("wheel", "velocity", lambda v: v > 1.0)
    rig.until("motor", "effort", lambda f: f < -1.0)
    begin = rig.see("wheel", steps=10)
    assert rig.see("wheel", steps=100) - begin == pytest.approx(0.15, rel=1e-6)
    assert rig.see("motor", "velocity", 3000) == pytest.approx(-2.0, abs=1e-3)
    rig.send("roll", 50.0)  # the limit is 20 rad/s
    rig.until("wheel", "velocity", lambda v: v > 2.0)
    assert rig.see("wheel", "velocity", 200) == pytest.approx(20.0)


def test_velocity_position_controller_commands_a_velocity(rig, collect):
    rig.start("roll_to")
    states = collect("/rig/roll_to/state", JointControllerState)
    wait_for(states.connected, 5.0, "state topic")
    rig.send("roll_to", 0.8)
    rig.until("wheel", "velocity", lambda v: v > 0.1)
    step(11)
    state = states.wait(1, 5.0, where=lambda m: m.set_point == 0.8)
    assert state.command == pytest.approx(5.0 * state.error)
    assert rig.see("wheel", steps=3000) == pytest.approx(0.8, abs=1e-3)


def test_group_controllers_forward_to_each_joint(rig, rig_world):
    rig.start("efforts", "positions", "velocities")
    rig.send("efforts", [2.0, 3.0])
    rig.until("cart", "effort", lambda f: f == 3.0)
    assert rig.see("table", "effort") == 2.0
    rig.send("efforts", [1.0])
    rig.send("efforts", [1.0, math.nan])
    wait_for(lambda: "efforts" in rig_world.output().split("length")[0], 5.0, "the complaint")
    assert rig.see("cart", "effort", 5) == 3.0
    rig.send("efforts", [0.0, 0.0])
    rig.until("cart", "effort", lambda f: f == 0.0)
    rig.send("positions", [0.2, -0.3])
    rig.until("slide", "position", lambda x: x > 0.0)
    rig.send("velocities", [1.0, -1.0])
    rig.until("wheel", "velocity", lambda v: v > 0.5)
    message = rig.at(step(3000))
    values = dict(zip(message.name, message.position, strict=True))
    assert (values["slide"], values["servo"]) == pytest.approx((0.2, -0.3), abs=1e-3)
    assert dict(zip(message.name, message.velocity, strict=True))["motor"] == pytest.approx(
        -1.0, abs=1e-3
    )


def test_effort_group_position_controller(rig):
    rig.start("effort_positions")
    rig.send("effort_positions", [0.3, -0.4])
    rig.until("cart", "effort", lambda f: f > 1.0)
    message = rig.at(step(3000))
    values = dict(zip(message.name, message.position, strict=True))
    assert (values["cart"], values["table"]) == pytest.approx((0.3, -0.4), abs=1e-3)
    request = Config(doubles=[DoubleParameter("p", 90.0)])
    call("/rig/effort_positions/cart/pid/set_parameters", Reconfigure, request)
    assert rospy.get_param("/rig/effort_positions/cart/pid/p") == 90.0


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
    ended = (GoalStatus.PENDING, GoalStatus.ACTIVE)
    wait_for(lambda: step(steps) and client.get_state() not in ended, 10.0, "the goal's end")
    client.wait_for_result(rospy.Duration(2.0))
    return client.get_result()


def test_a_gripper_closes_until_something_is_in_its_way(rig):
    rig.start("grip")
    client = actionlib.SimpleActionClient(f"{rig.namespace}/grip/gripper_cmd", GripperCommandAction)
    assert client.wait_for_server(rospy.Duration(10.0))
    client.send_goal(GripperCommandGoal(GripperCommand(0.3, 40.0)))
    result = finish(client)
    assert client.get_state() == GoalStatus.SUCCEEDED and result.reached_goal
    assert result.position == pytest.approx(0.3, abs=0.011)
    client.send_goal(GripperCommandGoal(GripperCommand(1.5, 25.0)))  # its stop is at 1 m
    result = finish(client)
    assert client.get_state() == GoalStatus.ABORTED
    assert result.stalled and not result.reached_goal
    assert (result.position, result.effort) == (pytest.approx(1.0, abs=1e-3), 25.0)


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


def test_bad_goals_are_rejected_with_a_reason(rig):
    rig.load("path")
    client = client_of("/rig/path")
    good = [(0.2, [0.1, 0.1])]

    def ask(goal):
        # SimpleActionClient misses a refusal that comes before it has noted what it sent; and every
        # client misses one that comes while the server still takes up its connection: ask again.
        done = actionlib.CommState.DONE
        for _ in range(5):
            handle = client.action_client.send_goal(goal)
            with suppress(GraphError):
                wait_for(lambda handle=handle: handle.get_comm_state() == done, 3.0, "an answer")
                return handle.get_terminal_state(), handle.get_result()
        raise GraphError("no answer to five goals")

    status, result = ask(goal_for(["slide", "servo"], good))
    assert (status, result.error_code) == (GoalStatus.REJECTED, result.INVALID_GOAL)  # not running
    assert rig.switch(["path"])
    for names, points, code in (
        (["slide"], [(0.2, [0.1])], FollowJointTrajectoryResult.INVALID_JOINTS),
        (["slide", "nobody"], good, FollowJointTrajectoryResult.INVALID_JOINTS),
        (["slide", "servo"], [(0.2, [0.1])], FollowJointTrajectoryResult.INVALID_GOAL),
        (["slide", "servo"], [(0.2, [0.1, math.nan])], FollowJointTrajectoryResult.INVALID_GOAL),
        (["slide", "servo"], good + good, FollowJointTrajectoryResult.INVALID_GOAL),
    ):
        status, result = ask(goal_for(names, points))
        assert status == GoalStatus.REJECTED, (names, points)
        assert result.error_code == code, result.error_string
        assert result.error_string


def test_goals_are_preempted_cancelled_and_watched(rig):
    rig.start("path", "effort_path")
    client = client_of("/rig/path")
    client.send_goal(goal_for(["slide", "servo"], [(2.0, [0.5, 0.5])]))
    wait_for(lambda: client.get_state() == GoalStatus.ACTIVE, 5.0, "the goal's acceptance")
    step(100)
    client.cancel_goal()
    finish(client)
    assert client.get_state() == GoalStatus.PREEMPTED
    held = rig.see("slide")
    assert rig.see("slide", steps=100) == pytest.approx(held, abs=1e-6)
    client.send_goal(goal_for(["slide", "servo"], [(2.0, [0.5, 0.5])]))
    wait_for(lambda: client.get_state() == GoalStatus.ACTIVE, 5.0, "the goal's acceptance")
    step(10)
    topic = rig.publisher("path/command", JointTrajectory)
    topic.publish(goal_for(["slide", "servo"], [(0.2, [0.0, 0.0])]).trajectory)
    finish(client)
    assert client.get_state() == GoalStatus.PREEMPTED
    assert rig.see("slide", steps=300) == pytest.approx(0.0, abs=1e-6)
    cart = client_of("/rig/effort_path")
    cart.send_goal(goal_for(["cart"], [(0.02, [0.9])]))  # 45 m/s cannot be had
    result = finish(cart)
    assert cart.get_state() == GoalStatus.ABORTED
    assert result.error_code == result.PATH_TOLERANCE_VIOLATED
    assert "cart" in result.error_string
    tolerance = JointTolerance(name="servo", position=1e-9, velocity=0.0)
    goal = goal_for(["slide", "servo"], [(0.1, [0.1, 0.3])], goal_tolerance=[tolerance])
    goal.goal_time_tolerance = rospy.Duration.from_sec(0.05)
    client.send_goal(goal)
    result = finish(client)
    assert result.error_code == result.GOAL_TOLERANCE_VIOLATED


def test_effort_and_velocity_trajectories_track(rig):
    rig.start("effort_path", "velocity_path")
    cart, wheel = client_of("/rig/effort_path"), client_of("/rig/velocity_path")
    cart.send_goal(goal_for(["cart"], [(1.0, [0.3])]))
    wheel.send_goal(goal_for(["wheel"], [(1.0, [2.0])]))
    for client in (cart, wheel):
        wait_for(lambda c=client: c.get_state() == GoalStatus.ACTIVE, 5.0, "acceptance")
    for client in (cart, wheel):
        finish(client, 100)
        assert client.get_state() == GoalStatus.SUCCEEDED, client.get_result().error_string
    assert rig.see("cart", steps=500) == pytest.approx(0.3, abs=0.01)
    assert rig.see("wheel") == pytest.approx(2.0, abs=0.01)


def test_emergency_stop_and_release(rig):
    rig.start("push", "roll", "slide_to")
    rig.send("push", 4.0)
    rig.send("roll", 1.0)
    rig.send("slide_to", 0.6)
    rig.until("cart", "effort", lambda f: f == 4.0)
    rig.until("wheel", "velocity", lambda v: v > 0.5)
    rig.until("slide", "position", lambda x: x > 0.1)
    e_stop = rig.publisher("e_stop", Bool)
    e_stop.publish(True)
    rig.until("cart", "effort", lambda f: f == 0.0)
    held = rig.see("slide", steps=2)
    assert rig.see("slide", steps=50) == pytest.approx(held)
    assert rig.see("wheel", "velocity") == pytest.approx(0.0, abs=1e-9)
    assert set(rig.states().values()) == {"running"}
    e_stop.publish(False)  # all are started again: set points are those of starting()
    step(20)
    assert rig.see("slide", steps=100) == pytest.approx(held)
    assert rig.see("cart", "effort") == 0.0


def test_log_holds_no_traceback(rig_world):
    assert "Traceback" not in rig_world.output()
