"""Bridge node: effect of its parameters, start and shutdown."""

import logging
import sys
import threading
import time

import pybullet
import pytest
import rospy
from dynamic_reconfigure.msg import Config, ConfigDescription
from gazebo_msgs.msg import LinkState, LinkStates, ModelState, ModelStates, PerformanceMetrics
from gazebo_msgs.srv import SpawnModelRequest
from geometry_msgs.msg import Point, Pose, Quaternion
from graph_helpers import messages, until
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.control.switching import LoadedController
from aras_sim_bridge.description.types import SceneSettings
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.ros.runtime import node
from aras_sim_bridge.ros.runtime.clock import ClockPublisher
from aras_sim_bridge.ros.runtime.node import GazeboNode, make_pacer
from aras_sim_bridge.ros.runtime.node_parameters import NodeParameters
from aras_sim_bridge.ros.runtime.restart_record import RestartRecord
from aras_sim_bridge.simulation import SimulationConfig
from aras_visual_servo_base.compiled import list_functions
from aras_visual_servo_ros.parameters import InvalidParameterError

MS = 1_000_000
WORLD = """<sdf version="1.6"><world name="w"><gravity>0 0 -1.5</gravity>
  <physics type="ode"><max_step_size>0.002</max_step_size>
    <real_time_update_rate>250</real_time_update_rate></physics>
  <model name="block"><static>true</static><link name="l"/></model></world></sdf>"""


@pytest.mark.parametrize(("mode", "rate", "factor"), [
    ("real_time", 1000.0, 2.0), ("real_time", 250.0, 0.5), ("max", 1000.0, 0.0),
    ("lockstep", 1000.0, 0.0)])
def test_pace_is_the_parameter_s_times_the_world_s(mode, rate, factor):
    world = WorldFile(time_step=0.001, update_rate=rate)
    pacer = make_pacer(NodeParameters(speed_mode=mode, real_time_factor=2.0), world)
    assert pacer.factor == pytest.approx(factor)


@pytest.mark.parametrize(("given", "name"), [
    ({"speed_mode": "fast"}, "speed_mode"), ({"renderer": "gpu"}, "renderer"),
    ({"log_level": "all"}, "log_level"), ({"clock_rate": -1.0}, "clock_rate"),
    ({"real_time_factor": 0.0}, "real_time_factor"),
    ({"master_check_period": 0.0}, "master_check_period"), ({"colck_rate": 1}, "colck_rate")])
def test_parameters_that_cannot_be_are_named(given, name):
    with pytest.raises(InvalidParameterError, match=f"parameter /gazebo/{name}"):
        NodeParameters.from_mapping(given, "/gazebo")


def test_parameters_of_others_are_left_and_limits_are_inside():
    others = {"cameras": {"a": 1}, "gravity_x": 0.0, "robot_description": "<robot/>",
              "whoever": {"b": 2}}
    given = {"clock_rate": 0, "pub_clock_frequency": 50, **others}
    read = NodeParameters.from_mapping(given, "/gazebo")
    assert read.effective_clock_rate == 50.0
    for least in ({"clock_rate": 0.0}, {"real_time_factor": 1e-3}, {"master_check_period": 1e-3}):
        ((name, value),) = least.items()
        assert getattr(NodeParameters.from_mapping(least, "/gazebo"), name) == value
    assert NodeParameters(clock_rate=125.0).effective_clock_rate == 125.0
    assert NodeParameters(pub_clock_frequency=0.0).effective_clock_rate == 0.0


@pytest.mark.parametrize(("rate", "stamps"), [
    (0.0, [1, 2, 3, 4, 5, 6, 7, 8, 9]), (250.0, [1, 4, 8]), (333.0, [1, 4, 7]), (0.5, [1])])
def test_the_clock_ticks_at_multiples_of_its_period(graph, rate, stamps):
    clock = ClockPublisher(rate)
    (listener,) = graph.listen("/clock")
    for ms in range(1, 10):
        clock.update(ms * MS)
    assert ticks(listener) == [ms * MS for ms in stamps]
    clock.publish(9 * MS)
    clock.publish(9 * MS)
    clock.publish(2_000_000_003)
    assert ticks(listener)[-1] == 2_000_000_003
    clock.restart()
    clock.update(0)
    clock.update(1 * MS)
    assert ticks(listener) == ([0] if rate else [0, MS])
    for first in (1, MS):  # the first nanosecond is told too, and again after a reset
        clock = ClockPublisher(rate)
        (listener,) = graph.listen("/clock")
        clock.update(first)
        for _ in range(2):
            clock.restart()
            clock.update(first)
        assert ticks(listener) == 3 * [first]


def ticks(listener) -> list[int]:
    return [tick.clock.to_nsec() for tick in messages(listener, Clock)]


@pytest.fixture
def make(graph, tmp_path, monkeypatch):
    made: list[GazeboNode] = []

    def make(**parameters: object) -> GazeboNode:
        made.append(GazeboNode(NodeParameters(**parameters)))
        return made[-1]

    make.graph = graph
    make.world = tmp_path / "a.world"
    make.world.write_text(WORLD)
    yield make
    for it in made:
        it.stop()


def test_a_world_file_counts(make):
    it = make(world=str(make.world), paused=True, speed_mode="real_time")
    simulation = it.thread.simulation
    assert simulation.step_ns == 2 * MS and simulation.world.gravity[2] == -1.5
    assert "block" in simulation.world.models and "ground_plane" not in simulation.world.models
    assert it.thread.pacer.factor == pytest.approx(0.5)
    assert it.thread.paused


def test_the_clock_and_the_states_come_with_the_steps(make):
    it = make(paused=True)
    (listener,) = make.graph.listen("/clock")
    states = make.graph.publishers["/gazebo/model_states"]
    states.impl.connections.append(object())
    make.graph.call("/gazebo/step_world", 5)
    assert ticks(listener) == [MS, 4 * MS]
    assert len(states.sent) == 1
    make.graph.call("/gazebo/reset_simulation")
    make.graph.call("/gazebo/step_world", 1)
    assert ticks(listener) == [MS]
    assert it.thread.simulation.before_images == it.clock.publish
    text = '<robot name="box"><link name="l"/></robot>'
    assert make.graph.call("/gazebo/spawn_urdf_model", "box", text, "", Pose(), "").success
    assert rospy.resolve_name("~spawned") not in make.graph.parameters


def test_topics_and_services_are_gazebo_ros_s(make):
    make(paused=True)
    graph = make.graph
    assert graph.told() == {
        "/clock": (Clock, 10, False), "/gazebo/link_states": (LinkStates, 10, False),
        "/gazebo/model_states": (ModelStates, 10, False),
        "/gazebo/performance_metrics": (PerformanceMetrics, 10, False),
        "/gazebo/real_time_factor": (Float64, 1, False),
        "/gazebo/parameter_descriptions": (ConfigDescription, 10, True),
        "/gazebo/parameter_updates": (Config, 10, True)}
    assert graph.heard == {"/gazebo/set_model_state": (ModelState, {"queue_size": 10}),
                           "/gazebo/set_link_state": (LinkState, {"queue_size": 10})}
    others = {"clear_body_wrenches": "BodyRequest", "clear_joint_forces": "JointRequest",
              "set_parameters": "Reconfigure", "spawn_urdf_model": "SpawnModel",
              "spawn_sdf_model": "SpawnModel", "pause_physics": "Empty", "reset_world": "Empty",
              "unpause_physics": "Empty", "reset_simulation": "Empty"}
    names = [name.removeprefix("/gazebo/") for name in graph.types]
    assert len(names) == 29 and "step_world" in names
    for name, kind in zip(names, graph.types.values(), strict=True):
        wanted = others.get(name, name.title().replace("_", ""))
        assert kind._type.rpartition("/")[2] == wanted


def test_a_display_that_does_not_answer_is_a_warning(graph, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":4711")
    simulation = node.build_simulation(NodeParameters(gui=True), WorldFile())
    assert simulation.config.gui is False
    simulation.close()
    assert any("display ':4711'" in line and "continuing without a window" in line
               for line in graph.lines)


def test_without_extras_there_is_what_gazebo_ros_has(make):
    make(paused=True, extra_interfaces=False)
    assert "/gazebo/step_world" not in make.graph.services and len(make.graph.services) == 28
    assert not [name for name in make.graph.publishers if "metrics" in name or "factor" in name]
    make.graph.call("/gazebo/unpause_physics")  # and states are told without them
    until(lambda: make.graph.call("/gazebo/get_world_properties").sim_time > 0.0)


@pytest.mark.parametrize("shadows", ["world", "none"])
def test_the_simulation_is_what_parameters_and_world_file_say(graph, monkeypatch, shadows):
    monkeypatch.setenv("DISPLAY", "")
    graph.parameters[rospy.resolve_name("~cameras")] = {"eye": {"width": 3}}
    world = WorldFile(time_step=0.002, gravity=(1.0, 2.0, 3.0), lights=(), ground_plane=False,
                      scene=SceneSettings(shadows="soft"), warnings=("look",), time_ns=77)
    built = node.build_simulation(
        NodeParameters(shadows=shadows, gui=True, renderer="tiny", exposure="gazebo", seed=5,
                       legacy_camera_info=True), world)
    assert built.config == SimulationConfig(
        time_step=0.002, gravity=(1.0, 2.0, 3.0), gui=False, renderer="tiny",
        exposure="gazebo", scene=SceneSettings(shadows={"world": "soft"}.get(shadows, "none")),
        seed=5, legacy_camera_info=True, ground_plane=False, lights=())
    assert built.time_ns == 77 and "world file: look" in graph.lines
    assert sum("continuing without a window" in line for line in graph.lines) == 1
    built.close()


def test_cameras_of_the_world_come_with_the_node(make):
    for key, value in (("parent", "world"), ("pose", [0.0] * 6), ("width", 8), ("height", 6)):
        make.graph.set(f"~cameras/eye/{key}", value)
    it = make(paused=True, speed_mode="lockstep", lockstep_topics=("/a",), lockstep_timeout=9.0)
    make.graph.listen("/eye/image_raw")
    make.graph.call("/gazebo/step_world", 100)
    assert it.lockstep.is_closed  # a round for each picture
    assert 8.0 < it.lockstep.compute_remaining() <= 9.0


def test_a_record_that_is_forgotten_is_written_no_more(graph):
    place = rospy.resolve_name("~spawned")
    request = SpawnModelRequest("m", "<a/>", "/ns", Pose(Point(1, 2, 3), Quaternion(4, 5, 6, 7)),
                                "world")
    graph.parameters[place] = {"models": []}
    RestartRecord(False).clear()
    RestartRecord(False).add_model("spawn_urdf_model", request)
    assert graph.parameters[place] == {"models": []}
    record = RestartRecord(True)
    record.add_model("spawn_urdf_model", request)
    record.set_controllers("/ns", [LoadedController("c", "t", Controller(), "running"),
                                   LoadedController("d", "t", Controller(), "stopped")])
    record.set_controllers("/other", [])
    assert graph.parameters[place] == {
        "models": [{"service": "spawn_urdf_model", "name": "m", "xml": "<a/>", "namespace": "/ns",
                    "position": [1, 2, 3], "orientation": [4, 5, 6, 7], "frame": "world"}],
        "controllers": [["/ns", [("c", True), ("d", False)]]]}
    record.clear()
    record.clear()
    record.set_controllers("/ns", [])
    record.remove_model("m")
    assert place not in graph.parameters


def test_it_runs_unless_it_is_told_to_wait(make):
    it = make(speed_mode="max")
    assert not it.thread.paused
    begin = it.thread.now_ns()
    until(lambda: it.thread.now_ns() != begin)
    it.stop()
    assert it.thread.is_stopping


def test_without_the_network_there_is_the_clock_alone(make):
    make(enable_ros_network=False, paused=True)
    assert set(make.graph.publishers) == {"/clock"} and not make.graph.services


ROBOT = """<robot name="r"><link name="world"/><joint name="a" type="prismatic">
  <parent link="world"/><child link="b"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
  <link name="b"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <transmission name="t"><type>transmission_interface/SimpleTransmission</type>
    <joint name="a"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface>
    </joint><actuator name="m"/></transmission>
  <gazebo><plugin name="control" filename="libgazebo_ros_control.so"/></gazebo></robot>"""


def test_what_stood_there_comes_back_after_a_death(make):
    graph = make.graph
    for name in ("on", "off"):
        graph.parameters[f"/r/{name}/type"] = "effort_controllers/JointEffortController"
        graph.parameters[f"/r/{name}/joint"] = "a"
    first = make(paused=True, restore=True)
    pose = Pose(Point(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, 1.0, 0.0))
    for name in ("box", "gone"):
        text = f'<robot name="{name}"><link name="l"/></robot>'
        assert graph.call("/gazebo/spawn_urdf_model", name, text, "", pose, "").success
    assert graph.call("/gazebo/spawn_urdf_model", "arm", ROBOT, "/r", Pose(), "box").success
    assert graph.call("/gazebo/delete_model", "gone").success
    for name in ("on", "off"):
        assert graph.call("/r/controller_manager/load_controller", name).ok
    assert graph.call("/r/controller_manager/switch_controller", ["on"], [], 2).ok
    first.thread.stop()  # and no word of it

    second = make(paused=True, restore=True)
    assert list(second.thread.simulation.world.models) == ["ground_plane", "box", "arm"]
    there = graph.call("/gazebo/get_model_state", "arm", "").pose
    assert (there.position.x, there.position.y, there.position.z) == (1.0, 2.0, 3.0)
    assert (there.orientation.z, there.orientation.w) == (1.0, 0.0)
    found = graph.call("/r/controller_manager/list_controllers").controller
    assert [(c.name, c.state) for c in found] == [("on", "running"), ("off", "initialized")]
    assert sum("is restored after" in line for line in graph.lines) == 2
    assert graph.call("/gazebo/delete_model", "arm").success
    second.thread.stop()
    lines = len(graph.lines)
    third = make(paused=True, restore=True)
    assert list(third.thread.simulation.world.models) == ["ground_plane", "box"]
    assert len(graph.lines) == lines + 1  # and no controller is asked for
    third.stop()  # as it should end
    fourth = make(paused=True, restore=True)
    assert list(fourth.thread.simulation.world.models) == ["ground_plane"]


def test_one_that_cannot_come_back_does_not_keep_the_others_away(make):
    first = make(paused=True, restore=True)
    for name in ("a", "b"):
        text = f'<robot name="{name}"><link name="l"/></robot>'
        assert make.graph.call("/gazebo/spawn_urdf_model", name, text, "", Pose(), "").success
    first.thread.stop()
    make.graph.parameters[rospy.resolve_name("~spawned")]["models"][0]["xml"] = "nonsense"
    second = make(paused=True, restore=True)
    assert list(second.thread.simulation.world.models) == ["ground_plane", "b"]
    assert any("restoring by service" in line for line in make.graph.lines)


def test_lockstep_waits_for_its_topics_by_periods(make):
    it = make(speed_mode="lockstep", lockstep_topics=("/a",), lockstep_period=0.002)
    until(lambda: it.thread.is_time_stopped)
    assert it.thread.now_ns() == 2 * MS and it.thread.lockstep.is_closed
    make.graph.subscribers["/a"](None)
    until(lambda: it.thread.now_ns() >= 4 * MS)
    make.graph.call("/gazebo/reset_simulation")
    until(lambda: it.thread.is_time_stopped and it.thread.now_ns() == 2 * MS)


@pytest.fixture
def process(graph, start, monkeypatch):
    monkeypatch.setattr(sys, "setswitchinterval", lambda interval: start.begun.append(interval))
    monkeypatch.setattr(rospy.rostime, "wallsleep", lambda _seconds: None)
    sleep, start.slept = time.sleep, []
    monkeypatch.setattr(time, "sleep", lambda seconds: start.slept.append(seconds) or sleep(0.001))
    start.graph.parameters[f"{rospy.get_name()}/paused"] = True

    def run(**given: object) -> threading.Thread:
        given = {"master_check_period": 1e-4, **given}
        thread = threading.Thread(target=lambda: setattr(start, "status", node.main(given)))
        thread.start()
        return thread

    def lose_master() -> None:
        def gone() -> None:
            raise OSError

        graph.getPid = gone

    start.run, start.lose_master = run, lose_master
    yield start
    lose_master()
    for thread in threading.enumerate():
        if thread.name == "master watch":
            thread.join(30.0)


def test_the_process_runs_until_it_is_ended(process):
    asked, get_pid = [], process.graph.getPid
    process.graph.getPid = lambda: asked.append(1) or get_pid()
    thread = process.run(paused=False)
    until(lambda: len(asked) > 5 or not thread.is_alive())
    assert len(asked) > 0.5 * process.slept.count(0.5)  # as often as it is set
    assert process.graph.parameters["/use_sim_time"] is True
    # The parameters of the server come before those of the command line.
    assert process.graph.call("/gazebo/get_physics_properties").pause is True
    assert process.begun == [0.0005, ("gazebo", {"disable_signals": True, "disable_rostime": True})]
    assert process.is_open and all(function.signatures for function in list_functions())

    process.lose_master()
    thread.join(300.0)
    assert process.status == 0
    assert process.end_reasons == ["the ROS master does not answer any more"]
    assert any("is up, process" in line for line in process.graph.lines)
    assert process.graph.lines[-1] == f"{rospy.get_name()} ends: {process.end_reasons[0]}"


@pytest.mark.parametrize("when", ["before", "meanwhile", "after"])
def test_an_end_that_comes_early_ends_the_node_too(process, monkeypatch, when):
    slept, has_param, log = [], rospy.has_param, rospy.loginfo
    monkeypatch.setattr(rospy.rostime, "wallsleep", slept.append)
    if when == "before":
        process.is_ended_early = lambda: process.is_open

    def look_up(name: str) -> bool:
        if when == "meanwhile":
            process.end("early")
        return has_param(name)

    def write(text: str, *values: object) -> None:
        log(text, *values)
        if when == "after" and "is up" in text:
            process.end("late")
            assert slept == [0.3]  # answers have their way

    monkeypatch.setattr(rospy, "has_param", look_up)
    monkeypatch.setattr(rospy, "loginfo", write)
    process.run().join(300.0)
    assert process.status == 0
    with pytest.raises(rospy.ServiceException, match="shutting down"):
        process.graph.call("/gazebo/reset_world")


def test_a_parameter_that_cannot_be_ends_the_process(process):
    process.run(speed_mode="fast").join(300.0)
    assert process.status == 1 and "speed_mode" in process.end_reasons[0]


@pytest.mark.parametrize("early", [False, True])
@pytest.mark.parametrize("fault", [None, OSError("no"), rospy.ROSException("no")])
def test_what_keeps_it_from_starting_is_said_unless_it_ends_in_any_case(
    process, monkeypatch, fault, early
):
    def look_up(_name: str) -> bool:
        if early:
            process.end("early")
        if fault is not None:
            raise fault
        return True

    monkeypatch.setattr(rospy, "has_param", look_up)
    process.run(world="/none.world").join(300.0)
    assert process.status == 1
    (why,) = process.end_reasons
    assert early or process.graph.lines[-1].endswith(f" ends: {why}")
    assert why.startswith("early" if early else "it cannot start: ")
    assert early or ("/none.world" if fault is None else "no") in why


@pytest.mark.parametrize(("level", "shown"), [
    ("debug", ["d", "i", "w", "e"]), ("info", ["i", "w", "e"]), ("warn", ["w", "e"]),
    ("error", ["e"])])
def test_the_library_s_lines_go_where_rospy_s_go(process, monkeypatch, level, shown):
    rosout, found, handler = logging.getLogger("rosout"), [], logging.Handler()
    handler.emit = lambda record: found.append(record.getMessage())
    monkeypatch.setattr(rosout, "handlers", [handler])
    before = rosout.level
    rosout.setLevel(logging.INFO)
    ours = [logging.getLogger(name) for name in ("aras_sim_bridge", "aras_visual_servo_base")]
    parents = [one.parent for one in ours]
    try:
        process.run(log_level=level, world="/none.world").join(300.0)
        del found[:]
        for one in ours:
            library = one.getChild("world.somewhere")
            for write, text in ((library.debug, "d"), (library.info, "i"), (library.warning, "w"),
                                (library.error, "e")):
                write(text)
    finally:
        rosout.setLevel(before)
        for one, parent in zip(ours, parents, strict=True):
            one.parent = parent
            one.setLevel(logging.NOTSET)
    assert found == 2 * shown


@pytest.mark.parametrize("fault", [KeyError("gone"), OSError("no master"),
                                   rospy.ROSException("closed"), None])
def test_its_end_is_as_it_should_be_where_nothing_is_to_be_forgotten_any_more(
    make, monkeypatch, fault
):
    it, asked, place = make(paused=True, restore=True), [], rospy.resolve_name("~spawned")
    text = '<robot name="box"><link name="l"/></robot>'
    assert make.graph.call("/gazebo/spawn_urdf_model", "box", text, "", Pose(), "").success

    def forget(_name: str) -> None:
        asked.append(True)
        raise fault

    monkeypatch.setattr(rospy, "delete_param", forget)
    it.fault = None if fault else ValueError("the simulation's")
    it.stop()
    assert asked == ([True] if fault else [])  # after a fault what stood there comes back
    assert make.graph.parameters[place]["models"]


def test_a_fault_of_the_simulation_ends_the_process(process, monkeypatch, tmp_path):
    def step(*_: object) -> None:
        raise RuntimeError("broken")

    process.graph.parameters |= {"/use_sim_time": False, f"{rospy.get_name()}/paused": False}
    monkeypatch.setattr(pybullet, "stepSimulation", step)
    (tmp_path / "a.world").write_text(WORLD.replace("<static>true</static>", ""))
    process.run(world=str(tmp_path / "a.world")).join(300.0)
    assert process.status == 1 and process.end_reasons[0] == "the simulation failed"
    assert any("RuntimeError: broken" in line for line in process.graph.lines)
    assert process.graph.parameters["/use_sim_time"] is False
