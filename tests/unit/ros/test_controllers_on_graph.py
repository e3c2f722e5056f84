"""Controllers of a robot on the graph: services, topics, PIDs, action and emergency stop."""

import math
from threading import Thread

import pytest
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus
from control_msgs import msg as control
from dynamic_reconfigure.msg import BoolParameter, Config, DoubleParameter, StrParameter
from genpy import Duration, Time
from graph_helpers import messages
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from aras_sim_bridge.control.controllers.base import Controller
from aras_sim_bridge.control.controllers.trajectory_types import JointTolerance as Tolerance
from aras_sim_bridge.control.controllers.trajectory_types import (
    StatePoint,
    TrajectoryControllerState,
    TrajectoryGoal,
)
from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.ros.control import trajectory
from aras_sim_bridge.ros.control.manager_services import ManagerServices
from aras_sim_bridge.ros.control.topics import ControllerTopics
from aras_sim_bridge.ros.runtime.reconfigure_parameters import PID_FIELDS
from aras_sim_bridge.ros.runtime.restart_record import RestartRecord


def joint(name: str, interface: str) -> str:
    return f"""<joint name="{name}" type="prismatic"><parent link="world"/><child link="{name}_l"/>
    <axis xyz="1 0 0"/><limit lower="-5" upper="5" effort="100" velocity="20"/></joint>
  <link name="{name}_l"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <transmission name="{name}_t"><type>transmission_interface/SimpleTransmission</type>
    <joint name="{name}"><hardwareInterface>hardware_interface/{interface}</hardwareInterface>
    </joint><actuator name="{name}_m"/></transmission>"""


def robot(e_stop: str) -> str:
    return (
        '<robot name="rig"><link name="world"/>' + joint("cart", "EffortJointInterface")
        + joint("slide", "PositionJointInterface")
        + '<gazebo><plugin name="control" filename="libgazebo_ros_control.so">'
        f"<robotNamespace>/rig</robotNamespace>{e_stop}</plugin></gazebo></robot>")


EFFORT = "effort_controllers/"
PARAMETERS = {
    "/rig/gazebo_ros_control/pid_gains/slide/p": 40.0,
    "/rig/push/type": EFFORT + "JointEffortController", "/rig/push/joint": "cart",
    "/rig/push_all/type": EFFORT + "JointGroupEffortController", "/rig/push_all/joints": ["cart"],
    "/rig/go/type": EFFORT + "JointPositionController", "/rig/go/joint": "cart",
    "/rig/go/pid/p": 20.0, "/rig/go/pid/i": 1.0, "/rig/go/pid/d": 4.0,
    "/rig/go/pid/i_clamp_max": 3.0, "/rig/go/pid/i_clamp_min": -2.0,
    "/rig/go/pid/publish_state": True,
    "/rig/states/type": "joint_state_controller/JointStateController",
    "/rig/states/publish_rate": 1000.0,
    "/rig/follow/type": "position_controllers/JointTrajectoryController",
    "/rig/follow/joints": ["slide"], "/rig/grip/type": EFFORT + "GripperActionController",
    "/rig/grip/joint": "cart", "/rig/grip/stall_timeout": 0.05, "/rig/grip/gains/cart/p": 300.0,
    "/rig/grip/gains/cart/d": 40.0}


class Controllers:
    """The robot `rig` in a paused world; its manager's services at hand."""

    def __init__(self, graph, thread, e_stop: str = "") -> None:
        self.graph, self.thread = graph, thread
        graph.parameters.update(PARAMETERS)
        description = parse_urdf(robot(e_stop))
        thread.call(lambda: thread.simulation.spawn(
            description, "rig", namespace="/rig", parameters=graph.given("/rig")))
        self.robot = thread.simulation.robots["rig"]
        self.record = RestartRecord(True)
        self.services = ManagerServices(self.robot, thread, self.record)

    def call(self, name: str, *args: object):
        return self.graph.call(f"/rig/controller_manager/{name}", *args)

    def run(self, *names: str) -> list:
        for name in names:
            assert self.call("load_controller", name).ok
        assert self.call("switch_controller", list(names), [], 2).ok
        return [self.robot.manager.get(name) for name in names]

    def step(self, count: int = 1) -> None:
        self.thread.step(count, 120.0)


@pytest.fixture
def rig(graph, thread):
    it = Controllers(graph, thread)
    yield it
    it.services.shutdown()


def test_services_tell_and_change_what_is_loaded(rig):
    rig.run("states", "push")
    rig.call("load_controller", "go")
    found = rig.call("list_controllers").controller
    assert [(c.name, c.state, c.type) for c in found] == [
        ("states", "running", "joint_state_controller/JointStateController"),
        ("push", "running", EFFORT + "JointEffortController"),
        ("go", "initialized", EFFORT + "JointPositionController")]
    claims = found[1].claimed_resources
    assert [(c.hardware_interface, c.resources)
            for c in claims] == [("hardware_interface::EffortJointInterface", ["cart"])]
    types = rig.call("list_controller_types")
    assert len(types.types) == len(types.base_classes) == 16
    assert types.base_classes[0] == "controller_interface::ControllerBase"
    assert EFFORT + "JointEffortController" in types.types
    assert rig.call("unload_controller", "go").ok
    assert not rig.call("unload_controller", "push").ok
    assert "it is running" in rig.graph.lines[-1]
    assert [c.name for c in rig.call("list_controllers").controller] == ["states", "push"]
    assert not rig.call("reload_controller_libraries", False).ok
    assert rig.call("reload_controller_libraries", True).ok
    assert rig.call("list_controllers").controller == []
    assert not [name for name in rig.graph.publishers if "/rig/states" in name]


def test_impossible_switches_and_loads_are_refused_with_a_line(rig):
    rig.run("push")
    rig.call("load_controller", "go")
    assert not rig.call("switch_controller", ["go"], [], 2).ok
    assert "'cart' by push, go" in rig.graph.lines[-1]
    assert rig.call("switch_controller", ["go"], ["push"], 2).ok
    assert [c.state for c in rig.call("list_controllers").controller] == ["stopped", "running"]
    assert not rig.call("load_controller", "late").ok
    assert "/rig/late/type is missing" in rig.graph.lines[-1]
    rig.graph.parameters["/rig/late/type"] = EFFORT + "JointEffortController"
    rig.graph.parameters["/rig/late/joint"] = "cart"
    rig.graph.parameters["/rig/controller_classes/mine"] = "nowhere:Mine"
    assert rig.call("load_controller", "late").ok
    assert "mine" in rig.call("list_controller_types").types


@pytest.fixture
def slow_rig(graph, thread):
    """A robot whose next control update is a hundred seconds away; time runs."""
    it = Controllers(graph, thread, "<controlPeriod>100</controlPeriod>")
    it.step()
    it.call("load_controller", "push")
    thread.call(lambda: thread.pacer.set_factor(0.001, thread.simulation.time_ns))
    thread.unpause()
    yield it
    it.services.shutdown()


def test_a_switch_that_nobody_carries_out_is_given_up(slow_rig, monkeypatch):
    """The answer does not wait for ever; a second is added for its way."""
    wall = iter(range(0, 10**6, 2))
    monkeypatch.setattr("time.monotonic", lambda: next(wall))
    for timeout, limit in ((0.0, 10), (-1.0, 10), (2.5, 3.5)):
        assert not slow_rig.call("switch_controller", ["push"], [], 2, False, timeout).ok
        assert f"not carried out within {limit} s of wall time" in slow_rig.graph.lines[-1]
    slow_rig.thread.pause()
    assert slow_rig.call("list_controllers").controller[0].state == "initialized"


def test_a_switch_is_carried_out_when_time_is_stopped_under_it(slow_rig):
    answers = []
    asking = Thread(target=lambda: answers.append(
        slow_rig.call("switch_controller", ["push"], [], 2, False, 60.0)))
    asking.start()
    asking.join(0.2)
    assert not answers
    slow_rig.thread.pause()
    asking.join(30.0)
    assert answers[0].ok
    assert slow_rig.call("list_controllers").controller[0].state == "running"


def test_who_ends_at_the_same_ctrl_c_asks_in_vain_and_no_line_is_written_of_it(rig):
    rig.run("push")
    rig.thread.stop()
    lines = list(rig.graph.lines)
    assert not rig.call("switch_controller", [], ["push"], 2).ok
    assert not rig.call("unload_controller", "push").ok
    assert rig.graph.lines == lines


def test_commands_reach_their_controller(rig):
    rig.run("push")
    rig.graph.send("/rig/push/command", Float64(4.0))
    rig.step(100)
    _, velocities, _ = rig.robot.model.read_joints()
    assert velocities[rig.robot.model.joint_names.index("cart")] == pytest.approx(0.2)
    rig.call("load_controller", "push_all")
    assert rig.call("switch_controller", ["push_all"], ["push"], 2).ok
    rig.graph.send("/rig/push_all/command", Float64MultiArray(data=[-4.0]))
    rig.step(100)
    _, velocities, _ = rig.robot.model.read_joints()
    assert velocities[rig.robot.model.joint_names.index("cart")] == pytest.approx(0.0, abs=1e-9)
    rig.graph.send("/rig/push_all/command", Float64MultiArray(data=[1.0, 2.0]))
    assert "2 values for 1" in rig.graph.lines[-1]


def test_states_are_told_to_those_who_listen(rig):
    (go, states) = rig.run("go", "states")
    assert go.on_state is None and states.on_state is None
    told = rig.graph.told()
    for name, kind, queue in (("go/state", control.JointControllerState, 1),
                              ("go/pid/state", control.PidState, 1),
                              ("joint_states", JointState, 4)):
        assert told[f"/rig/{name}"] == (kind, queue, False)
    (state,) = rig.graph.listen("/rig/go/state")
    (pid,) = rig.graph.listen("/rig/go/pid/state")
    (joints,) = rig.graph.listen("/rig/joint_states")
    rig.graph.send("/rig/go/command", Float64(0.5))
    rig.step(11)
    now = messages(state, control.JointControllerState)
    assert now[0].header.stamp.to_nsec() == 1_000_000
    assert (now[0].set_point, now[0].p, now[0].i, now[0].d, now[0].i_clamp) == (0.5, 20, 1, 4, 3)
    assert now[0].error == now[0].set_point - now[0].process_value
    assert now[1].process_value_dot > 0.0 and now[1].time_step == 0.001
    pids = messages(pid, control.PidState)
    assert len(pids) == 11 and pids[0].timestep.to_nsec() == 1_000_000
    assert pids[0].header.stamp.to_nsec() == 0
    assert (pids[3].i_max, pids[3].i_min) == (3.0, -2.0)
    assert pids[3].output == pytest.approx(pids[3].p_term + pids[3].i_term + pids[3].d_term)
    samples = messages(joints, JointState)
    assert [m.header.stamp.to_nsec() for m in samples] == [k * 1_000_000 for k in range(1, 12)]
    assert [m.header.seq for m in samples] == list(range(1, 12))
    assert samples[-1].name == ["cart", "slide"]
    assert samples[-1].velocity[0] > samples[1].velocity[0] > 0.0
    assert now[0].command > samples[1].effort[0] == 100.0
    rig.call("switch_controller", [], ["go"], 2)
    rig.call("unload_controller", "go")
    rig.step()
    assert "/rig/go/state" not in rig.graph.publishers
    assert go.on_state is go.pids["pid"].on_state is None is not states.on_state


@pytest.mark.parametrize(("true", "late"), [(False, 1_000_000), (True, 0)])
def test_joint_states_bear_gazebo_s_stamp_or_the_true_one(rig, true, late):
    """In the air at a constant speed the position at a time is known."""
    rig.graph.parameters["/rig/states/true_stamps"] = true
    rig.run("states", "push")
    (joints,) = rig.graph.listen("/rig/joint_states")
    rig.graph.send("/rig/push/command", Float64(1000.0))
    rig.step(10)
    rig.graph.send("/rig/push/command", Float64(0.0))
    rig.step(10)
    *_, first, last = messages(joints, JointState)
    model, time_ns = rig.robot.model, rig.thread.simulation.time_ns
    positions, velocities, _ = model.read_joints()
    k = model.joint_names.index("cart")
    for message in (first, last):
        back = (time_ns - message.header.stamp.to_nsec() + late) * 1e-9
        assert message.position[0] == pytest.approx(positions[k] - velocities[k] * back, abs=1e-9)
    assert last.header.stamp.to_nsec() == time_ns - 1_000_000 + late


def test_gains_are_told_and_changed_by_reconfigure(rig):
    (go,) = rig.run("go")
    assert rig.graph.parameters["/rig/go/pid/i_clamp_min"] == -2.0
    config = Config(doubles=[DoubleParameter("p", 7.0), DoubleParameter("d", 1e9),
                             DoubleParameter("i_clamp_min", -4.0), DoubleParameter("who", 1.0)],
                    bools=[BoolParameter("antiwindup", True)])
    answer = rig.graph.call("/rig/go/pid/set_parameters", config).config
    assert go.pids["pid"].gains == (7.0, 1.0, 1000.0, 3.0, -4.0, True)
    assert {d.name: d.value for d in answer.doubles} == {
        "p": 7.0, "i": 1.0, "d": 1000.0, "i_clamp_max": 3.0, "i_clamp_min": -4.0}
    assert [(b.name, b.value) for b in answer.bools] == [("antiwindup", True)]
    assert [(g.name, g.state, g.id, g.parent) for g in answer.groups] == [("Default", True, 0, 0)]
    assert rig.graph.parameters["/rig/go/pid/p"] == 7.0
    updates = rig.graph.publishers["/rig/go/pid/parameter_updates"].sent
    assert len(updates) == 2 and updates[-1] == answer
    for wrong in (Config(doubles=[DoubleParameter("p", math.nan)]),
                  Config(strs=[StrParameter("p", "much")])):
        again = rig.graph.call("/rig/go/pid/set_parameters", wrong).config
        assert again.doubles == answer.doubles
        assert rig.graph.lines[-1].endswith("nothing was changed")
    (described,) = rig.graph.publishers["/rig/go/pid/parameter_descriptions"].sent
    (group,) = described.groups
    assert (group.name, group.type, group.id, group.parent) == ("Default", "", 0, 0)
    names = [p.name for p in group.parameters]
    assert names == ["p", "i", "d", "i_clamp_min", "i_clamp_max", "antiwindup"]
    assert {d.name: d.value for d in described.max.doubles}["i_clamp_min"] == 0.0
    assert {d.name: d.value for d in described.min.doubles}["i_clamp_max"] == 0.0
    assert {d.name: d.value for d in described.dflt.doubles}["p"] == 10.0


def test_gains_are_control_toolbox_s_and_on_the_graph_with_the_robot(rig):
    assert {f.name: (f.type, f.default, f.minimum, f.maximum) for f in PID_FIELDS} == {
        "p": ("double", 10, -1e5, 1e5), "i": ("double", 0.1, -1e5, 1e5),
        "d": ("double", 1, -1000, 1000), "i_clamp_min": ("double", -10, -1e5, 0),
        "i_clamp_max": ("double", 10, 0, 1e5), "antiwindup": ("bool", False, False, True)}
    service = "/rig/gazebo_ros_control/pid_gains/slide/set_parameters"
    rig.graph.call(service, Config(doubles=[DoubleParameter("p", 5.0)]))
    assert rig.robot.hardware.pids["slide"].gains.p == 5.0
    rig.services.shutdown()
    assert not rig.graph.services and not rig.graph.publishers and not rig.graph.subscribers


def test_a_controller_that_is_started_while_time_stands_holds_its_joint_where_it_is(rig):
    rig.run("push")
    rig.graph.send("/rig/push/command", Float64(4.0))
    rig.step(100)
    rig.call("load_controller", "go")
    assert rig.call("switch_controller", ["go"], ["push"], 2).ok
    positions, velocities, _ = rig.robot.model.read_joints()
    k = rig.robot.model.joint_names.index("cart")
    (state,) = rig.graph.listen("/rig/go/state")
    rig.step(11)
    found = messages(state, control.JointControllerState)[0].set_point
    assert found == pytest.approx(positions[k], abs=1e-9) and velocities[k] > 0.1


@pytest.mark.parametrize(("given", "topic"), [
    ("<eStopTopic>stop</eStopTopic>", "/rig/stop"), ("<eStopTopic>/stop</eStopTopic>", "/stop")])
def test_the_emergency_stop_is_where_the_plugin_says(graph, thread, given, topic):
    rig = Controllers(graph, thread, given)
    rig.graph.send(topic, Bool(True))
    assert rig.robot.hardware.e_stop is True
    rig.graph.send(topic, Bool(False))
    assert rig.robot.hardware.e_stop is False
    rig.services.shutdown()
    assert not graph.subscribers


def test_services_that_cannot_be_had_leave_nothing_behind(graph, thread, monkeypatch):
    given, count = rospy.Service, []

    def service(name, *args):
        count.append(name)
        if "switch" in name:
            raise rospy.ROSException("taken")
        return given(name, *args)

    monkeypatch.setattr(rospy, "Service", service)
    with pytest.raises(rospy.ROSException):
        Controllers(graph, thread)
    assert len(count) > 3 and not graph.services and not graph.publishers


POINTS = [JointTrajectoryPoint([1.0], [2.0], [3.0], [], Duration(0, 500_000_000)),
          JointTrajectoryPoint([2.0], [], [], [], Duration(1, 0))]
TRAJECTORY = JointTrajectory(joint_names=["slide"], points=POINTS)


def test_trajectories_are_read_and_their_states_written():
    message = JointTrajectory(joint_names=["slide"], points=POINTS)
    message.header.stamp = Time(3, 4)
    found = trajectory.from_trajectory(message)
    assert (list(found.joint_names), found.stamp_ns) == (["slide"], 3_000_000_004)
    first, second = found.points
    assert (first.time_from_start_ns, second.time_from_start_ns) == (500_000_000, 1_000_000_000)
    assert (first.positions, first.velocities, first.accelerations) == ([1.0], [2.0], [3.0])
    points = [StatePoint([k], [k + 1.0], [k + 2.0], k + 0.5) for k in (1.0, 5.0, 9.0)]
    message = trajectory.fill_state(
        control.JointTrajectoryControllerState(), TrajectoryControllerState(7, ("a",), *points))
    assert (message.header.stamp.to_nsec(), message.joint_names) == (7, ["a"])
    for found, wanted in zip((message.desired, message.actual, message.error), points, strict=True):
        assert found.positions == wanted.positions and found.velocities == wanted.velocities
        assert found.accelerations == wanted.accelerations
        assert found.time_from_start.to_sec() == wanted.time_from_start


class ActionClient:
    """Client of a controller's action, which actionlib serves on the graph in memory."""

    def __init__(self, rig: Controllers, name: str, kind: type) -> None:
        self.rig, self.name, self.kind = rig, name, type(kind().action_goal)

    def send(self, key: str, **fields: object) -> None:
        message = self.kind(goal_id=GoalID(id=key))
        message.goal = type(message.goal)(**fields)
        self.rig.graph.subscribers[f"{self.name}/goal"](message)

    def cancel(self, key: str) -> None:
        self.rig.graph.subscribers[f"{self.name}/cancel"](GoalID(id=key))

    def sent(self, what: str) -> list:
        return self.rig.graph.publishers[f"{self.name}/{what}"].sent

    def result(self, key: str) -> tuple:
        (it,) = (one for one in self.sent("result") if one.status.goal_id.id == key)
        return it.status.status, it.result, it.status.text


@pytest.fixture
def follow(rig):
    rig.run("follow")
    rig.step()
    return ActionClient(rig, "/rig/follow/follow_joint_trajectory",
                        control.FollowJointTrajectoryAction)


def test_a_goal_is_followed_to_its_end(follow):
    follow.send("a", trajectory=TRAJECTORY, goal_time_tolerance=Duration(1, 0))
    follow.rig.step(100)
    assert follow.sent("status")[-1].status_list[0].status == GoalStatus.ACTIVE
    back = follow.sent("feedback")[-1]
    assert back.feedback.desired.positions[0] > 0.0 and back.status.goal_id.id == "a"
    follow.rig.step(1500)
    status, result, text = follow.result("a")
    assert (status, result.error_code, text) == (GoalStatus.SUCCEEDED, 0, "")
    follow.cancel("a")
    follow.rig.step(10)
    assert follow.result("a")[0] == GoalStatus.SUCCEEDED


def test_actions_bear_stamps_of_simulated_time(follow, monkeypatch):
    """A goal's status goes some seconds of wall time after it."""
    assert not follow.sent("status")[0].status_list
    follow.send("a", trajectory=JointTrajectory(joint_names=["nobody"], points=POINTS))
    follow.rig.step()
    for what in ("status", "result"):
        assert follow.sent(what)[-1].header.stamp in (Time(0, 1_000_000), Time(0, 2_000_000))
    (tell,) = (tell for period, tell in follow.rig.graph.timers if period.to_sec() == 0.2)
    status = follow.sent("status")
    for seconds, left in ((4, 1), (5, 1), (6, 0)):
        follow.rig.graph.wall_time = 100.0 + seconds
        tell(None)
        assert len(status[-1].status_list) == left
    monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
    count = len(status)
    tell(None)
    assert len(status) == count


def test_goals_are_refused_cancelled_and_fail(follow):
    step = follow.rig.step
    follow.send("w", trajectory=JointTrajectory(joint_names=["nobody"], points=POINTS))
    follow.send("a", trajectory=TRAJECTORY)
    step(10)
    status, result, text = follow.result("w")
    assert (status, result.error_code, text) == (GoalStatus.REJECTED, -2, result.error_string)
    follow.cancel("somebody else")
    step(10)
    assert len(follow.sent("result")) == 1
    follow.cancel("a")
    step(10)
    status, _, text = follow.result("a")
    assert (status, text) == (GoalStatus.PREEMPTED, "cancelled")
    too_strict = [control.JointTolerance("slide", 1e-9, 0, 0)]
    follow.send("b", trajectory=TRAJECTORY, path_tolerance=too_strict)
    step(200)
    follow.send("c", trajectory=TRAJECTORY, goal_tolerance=too_strict)
    step(2500)
    for key, code in (("b", -4), ("c", -5)):
        status, result, _ = follow.result(key)
        assert (status, result.error_code) == (GoalStatus.ABORTED, code)


def test_a_gripper_says_where_it_got_to_and_what_holds_it_up(rig):
    simulation = rig.thread.simulation
    rig.thread.call(lambda: simulation.set_joint_positions("rig", {"cart": 4.5}))
    rig.run("grip")
    gripper = ActionClient(rig, "/rig/grip/gripper_cmd", control.GripperCommandAction)
    gripper.send("there", command=control.GripperCommand(4.7, 50.0))
    rig.step(1500)
    status, result, text = gripper.result("there")
    assert (status, text) == (GoalStatus.SUCCEEDED, "")
    assert result.position == pytest.approx(4.7, abs=0.01)
    assert result.reached_goal and not result.stalled
    gripper.send("held", command=control.GripperCommand(6.0, 30.0))  # beyond its stop at 5 m
    rig.step(1000)
    status, result, _ = gripper.result("held")
    assert status == GoalStatus.ABORTED and result.stalled and not result.reached_goal
    assert result.position == pytest.approx(5.0, abs=1e-3) and result.effort == 30.0
    gripper.send("wrong", command=control.GripperCommand(float("nan"), 1.0))
    rig.step(2)
    status, _, text = gripper.result("wrong")
    assert status == GoalStatus.REJECTED and "not finite" in text


def test_the_wanted_state_can_be_asked_for(follow):
    graph = follow.rig.graph
    graph.send("/rig/follow/command", TRAJECTORY)
    answer = graph.call("/rig/follow/query_state", Time(0, 502_000_000))
    assert (answer.name, answer.position) == (["slide"], [1.0])
    # From there on in a straight line: the second point has a position only.
    assert (answer.velocity, answer.acceleration) == ([2.0], [0.0])
    with pytest.raises(rospy.ServiceException, match="precedes"):
        graph.call("/rig/follow/query_state", Time(0, 1))
    follow.rig.call("switch_controller", [], ["follow"], 2)
    follow.rig.call("unload_controller", "follow")
    left = (*graph.subscribers, *graph.services, *graph.publishers)
    assert not [name for name in left if name.startswith("/rig/follow/")]


def test_ports_of_a_controller_and_all_fields_of_a_goal(rig):
    before = dict(rig.graph.publishers)
    ControllerTopics(Controller(), "/rig", rig.thread).shutdown()
    assert rig.graph.publishers == before
    tolerance = control.JointTolerance
    message = control.FollowJointTrajectoryGoal(
        trajectory=TRAJECTORY, path_tolerance=[tolerance("a", 1.0, 2.0, 3.0)],
        goal_tolerance=[tolerance("b", 4.0, 5.0, 6.0), tolerance("c", 7.0, 8.0, 9.0)],
        goal_time_tolerance=Duration(1, 500_000_000))
    action = trajectory.TrajectoryActionServer(rig.run("follow")[0], "/other", rig.thread)
    assert action.make_goal(message) == TrajectoryGoal(
        trajectory.from_trajectory(TRAJECTORY), [Tolerance("a", 1.0, 2.0, 3.0)],
        [Tolerance("b", 4.0, 5.0, 6.0), Tolerance("c", 7.0, 8.0, 9.0)], 1.5)
    action.shutdown()
    assert not [name for name in rig.graph.subscribers if name.startswith("/other")]
