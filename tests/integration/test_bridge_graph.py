"""The bridge as its clients see it: one running robot, real topics and services."""

from __future__ import annotations

import ctypes
import math
import re
import signal
import time
from itertools import pairwise
from pathlib import Path

import pytest
import rospy
from aras_sim_bridge.srv import StepWorld
from control_msgs.msg import JointControllerState
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllerTypes,
    LoadController,
    SwitchController,
    UnloadController,
)
from dynamic_reconfigure.msg import Config, ConfigDescription, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from gazebo_msgs.msg import LinkStates, ModelState, ModelStates, PerformanceMetrics
from gazebo_msgs.srv import (
    DeleteModel,
    GetModelProperties,
    GetModelState,
    GetWorldProperties,
    SetModelConfiguration,
    SetModelState,
    SpawnModel,
)
from geometry_msgs.msg import Pose
from ros_graph import wait_for, wait_for_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Float64
from std_srvs.srv import Empty

ROBOT = "/aras_visual_servo"
MANAGER = f"{ROBOT}/controller_manager"
STRICT, BEST_EFFORT = 2, 1
BOX = """<?xml version="1.0"?>
<!-- a comment -->
<robot name="box"><link name="box">
  <inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>
</link></robot>"""


def call(name: str, service: type, *args: object, **fields: object) -> object:
    """Call a service that is waited for."""
    rospy.wait_for_service(name, 20.0)
    return rospy.ServiceProxy(name, service)(*args, **fields)


def running() -> list[str]:
    """Names of the running controllers, in the manager's order."""
    infos = call(f"{MANAGER}/list_controllers", ListControllers).controller
    return [info.name for info in infos if info.state == "running"]


@pytest.fixture(scope="module", autouse=True)
def bridge(launch, ros_node):
    """The robot under its seven controllers, at real time."""
    launched = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"], gui=False
    )
    rospy.wait_for_service(f"{MANAGER}/list_controllers", 40.0)
    wait_for(lambda: len(running()) == 7, timeout=20.0, what="seven running controllers")
    return launched


@pytest.fixture
def paused():
    """Simulated time stands still during the test."""
    call("/gazebo/pause_physics", Empty)
    yield
    call("/gazebo/unpause_physics", Empty)


def stamp_ns(header) -> int:
    return header.stamp.secs * 10**9 + header.stamp.nsecs


def test_sim_time_is_announced():
    assert rospy.get_param("/use_sim_time") is True


def test_clock_ticks_at_250_hz_of_simulated_time(collect):
    ticks = collect("/clock", Clock)
    ticks.wait(50, timeout=5.0)
    times = [m.clock.secs * 10**9 + m.clock.nsecs for m in ticks.messages[:50]]
    assert all(t % 4_000_000 == 0 for t in times)
    assert {b - a for a, b in pairwise(times)} == {4_000_000}


def test_joint_states_order_stamp_and_rate(collect):
    states = collect(f"{ROBOT}/joint_states", JointState)
    states.wait(31, timeout=5.0)
    messages = states.messages[:31]
    first = messages[0]
    assert first.name == ["J1", "J2", "J3", "J5", "J6", "gantry"]
    assert first.header.frame_id == ""
    assert len(first.position) == len(first.velocity) == len(first.effort) == 6
    span = stamp_ns(messages[-1].header) - stamp_ns(first.header)
    assert span == pytest.approx(30 * 10_000_000, abs=1_000_000)


def test_command_moves_joint_and_state_tells(collect, ros_node):
    controller = f"{ROBOT}/joint1_position_controller"
    command = rospy.Publisher(f"{controller}/command", Float64, queue_size=1)
    states = collect(f"{controller}/state", JointControllerState)
    wait_for(command.get_num_connections, timeout=5.0, what="the command's subscriber")
    command.publish(0.3)
    state = states.wait(
        1, timeout=5.0, where=lambda m: m.set_point == 0.3 and abs(m.error) < 1e-3
    )
    assert state.process_value == pytest.approx(0.3, abs=1e-3)
    assert (state.p, state.i, state.d, state.i_clamp) == (3000.0, 40.0, 40.0, 1000.0)
    assert state.time_step == pytest.approx(0.001)
    assert state.antiwindup is False
    before = len(states.messages)
    states.wait(before + 11, timeout=3.0)
    times = [stamp_ns(m.header) for m in states.messages[before : before + 11]]
    assert {b - a for a, b in pairwise(times)} == {10_000_000}
    command.publish(0.0)


def test_nan_command_is_refused_in_one_line(bridge, collect):
    controller = f"{ROBOT}/joint5_position_controller"
    command = rospy.Publisher(f"{controller}/command", Float64, queue_size=1)
    wait_for(command.get_num_connections, timeout=5.0, what="the command's subscriber")
    for _ in range(20):
        command.publish(math.nan)
        time.sleep(0.005)
    wait_for(lambda: "is not finite" in bridge.output(), timeout=5.0, what="the complaint")
    assert bridge.output().count("command nan is not finite") <= 2
    state = wait_for_message(f"{controller}/state", JointControllerState)
    assert math.isfinite(state.set_point)
    assert math.isfinite(state.command)


def test_image_and_camera_info_share_stamps_on_the_grid(collect):
    images = collect("/labrob/camera/image_raw", Image)
    infos = collect("/labrob/camera/camera_info", CameraInfo)
    images.wait(8, timeout=10.0)
    infos.wait(8, timeout=10.0)
    image = images.messages[-1]
    assert (image.width, image.height, image.encoding) == (320, 240, "rgb8")
    assert image.step == 960
    assert len(image.data) == 230400
    assert image.is_bigendian == 0
    assert image.header.frame_id == "camera_link"
    # The first may be the latched picture of an earlier subscriber.
    stamps = [stamp_ns(m.header) for m in images.messages][1:]
    for stamp in stamps:
        index = round(stamp * 30 / 1e9)
        assert stamp == round(index * 1e9 / 30)
    indices = [round(stamp * 30 / 1e9) for stamp in stamps]
    assert {b - a for a, b in pairwise(indices)} == {1}
    info_stamps = {stamp_ns(m.header) for m in infos.messages}
    assert len(info_stamps & set(stamps)) >= 5
    info = infos.messages[-1]
    focal = 320 / (2 * math.tan(1.0))
    assert list(info.K) == pytest.approx([focal, 0, 159.5, 0, focal, 119.5, 0, 0, 1])
    assert info.P[3] == pytest.approx(-focal * 0.07)
    assert info.distortion_model == "plumb_bob"
    assert info.header.frame_id == "camera_link"


def test_camera_sees_white_table_and_black_target():
    image = wait_for_message("/labrob/camera/image_raw", Image)
    middle = 3 * (image.width * (image.height // 2) + image.width // 2)
    assert max(image.data[middle : middle + 3]) <= 10
    corner = 3 * (image.width * 4 + 4)
    assert min(image.data[corner : corner + 3]) >= 231


def test_set_camera_info_is_taken_over():
    info = wait_for_message("/labrob/camera/camera_info", CameraInfo)
    changed = CameraInfo(**{name: getattr(info, name) for name in info.__slots__})
    changed.K = [100.0, 0, 160, 0, 100, 120, 0, 0, 1]
    response = call("/labrob/camera/set_camera_info", SetCameraInfo, changed)
    assert response.success
    seen = wait_for_message(
        "/labrob/camera/camera_info", CameraInfo, where=lambda m: m.K[0] == 100.0
    )
    assert seen.K[2] == 160.0
    assert call("/labrob/camera/set_camera_info", SetCameraInfo, info).success


def test_controller_manager_lists_what_runs():
    controllers = call(f"{MANAGER}/list_controllers", ListControllers).controller
    assert [c.name for c in controllers][0] == "joint_state_controller"
    state_claims = controllers[0].claimed_resources
    assert [c.hardware_interface for c in state_claims] == [
        "hardware_interface::JointStateInterface"
    ]
    assert list(state_claims[0].resources) == []
    gantry = next(c for c in controllers if c.name == "gantry_position_controller")
    assert gantry.type == "effort_controllers/JointPositionController"
    assert gantry.claimed_resources[0].hardware_interface == (
        "hardware_interface::EffortJointInterface"
    )
    assert list(gantry.claimed_resources[0].resources) == ["gantry"]
    types = call(f"{MANAGER}/list_controller_types", ListControllerTypes)
    assert "joint_state_controller/JointStateController" in types.types
    assert set(types.base_classes) == {"controller_interface::ControllerBase"}


def test_stop_unload_load_start_of_a_controller():
    name = "joint6_position_controller"
    switch = f"{MANAGER}/switch_controller"
    assert not call(f"{MANAGER}/unload_controller", UnloadController, name).ok
    assert call(switch, SwitchController, [], [name], STRICT, False, 0.0).ok
    assert name not in running()
    assert call(f"{MANAGER}/unload_controller", UnloadController, name).ok
    assert call(f"{MANAGER}/load_controller", LoadController, name).ok
    assert not call(f"{MANAGER}/load_controller", LoadController, name).ok
    assert call(switch, SwitchController, [name], [], STRICT, False, 0.0).ok
    assert name in running()


def test_bad_controllers_are_refused_with_one_line(bridge):
    rospy.set_param(f"{ROBOT}/bad_type", {"type": "effort_controllers/JointPositionControler"})
    rospy.set_param(
        f"{ROBOT}/bad_joint",
        {"type": "effort_controllers/JointPositionController", "joint": "J4", "pid": {"p": 1.0}},
    )
    rospy.set_param(
        f"{ROBOT}/no_gains", {"type": "effort_controllers/JointPositionController", "joint": "J1"}
    )
    names = ["bad_type", "bad_joint", "no_gains", "not_there", ""]
    before = bridge.output().count("\n")
    for name in names:
        assert not call(f"{MANAGER}/load_controller", LoadController, name).ok
    assert len(running()) == 7
    wait_for(lambda: "no_gains/pid/p" in bridge.output(), timeout=5.0, what="the log")
    output = bridge.output()
    assert "did you mean 'effort_controllers/JointPositionController'" in output
    assert "no joint 'J4'" in output
    assert "Traceback" not in output
    assert output.count("\n") - before <= 3 * len(names)


def test_pid_gains_are_reconfigurable(collect):
    pid = f"{ROBOT}/joint2_position_controller/pid"
    descriptions = collect(f"{pid}/parameter_descriptions", ConfigDescription)
    updates = collect(f"{pid}/parameter_updates", Config)
    names = [p.name for p in descriptions.wait(1, timeout=5.0).groups[0].parameters]
    assert names == ["p", "i", "d", "i_clamp_min", "i_clamp_max", "antiwindup"]
    values = {d.name: d.value for d in updates.wait(1, timeout=5.0).doubles}
    assert values == {"p": 7000, "i": 1000, "d": 165, "i_clamp_min": -1000, "i_clamp_max": 1000}
    request = Config(doubles=[DoubleParameter("d", 1e9)])
    answer = call(f"{pid}/set_parameters", Reconfigure, request).config
    assert {d.name: d.value for d in answer.doubles}["d"] == 1000.0  # clamped to its range
    state = wait_for_message(
        f"{ROBOT}/joint2_position_controller/state",
        JointControllerState,
        where=lambda m: m.d == 1000.0,
    )
    assert state.p == 7000.0
    assert rospy.get_param(f"{pid}/d") == 1000.0
    call(f"{pid}/set_parameters", Reconfigure, Config(doubles=[DoubleParameter("d", 165.0)]))


def test_pause_stops_time_and_steps_advance_it(paused, collect):
    clock = collect("/clock", Clock)
    time.sleep(0.2)
    clock.clear()
    begin = call("/gazebo/get_world_properties", GetWorldProperties).sim_time
    time.sleep(0.3)
    assert not clock.messages
    assert call("/gazebo/get_world_properties", GetWorldProperties).sim_time == begin
    answer = call("/gazebo/step_world", StepWorld, 40)
    assert answer.success
    assert answer.sim_time.to_sec() == pytest.approx(begin + 0.04, abs=1e-9)
    clock.wait(10, timeout=2.0)
    for steps in (0, 2_000_000):
        assert not call("/gazebo/step_world", StepWorld, steps).success


def test_controllers_are_switched_while_paused(paused):
    name = "joint6_position_controller"
    switch = f"{MANAGER}/switch_controller"
    begin = time.monotonic()
    assert call(switch, SwitchController, [], [name], STRICT, False, 0.0).ok
    assert call(switch, SwitchController, [name], [], STRICT, False, 0.0).ok
    assert time.monotonic() - begin < 5.0
    assert len(running()) == 7


def test_step_world_is_refused_while_time_runs():
    answer = call("/gazebo/step_world", StepWorld, 1)
    assert not answer.success
    assert "pause_physics" in answer.status_message


def test_model_and_link_states(collect):
    models = collect("/gazebo/model_states", ModelStates).wait(1, timeout=5.0)
    assert models.name[0] == "ground_plane"
    assert set(models.name[1:3]) == {"aras_visual_servo", "target"}  # two spawners, in any order
    assert len(models.pose) == len(models.twist) == len(models.name)
    links = collect("/gazebo/link_states", LinkStates).wait(1, timeout=5.0)
    assert links.name[0] == "ground_plane::link"
    camera = links.pose[links.name.index("aras_visual_servo::camera_link")]
    assert camera.position.z == pytest.approx(0.782, abs=0.02)


def test_performance_metrics_tell_the_real_time_factor(collect):
    metrics = collect("/gazebo/performance_metrics", PerformanceMetrics)
    seen = metrics.wait(1, timeout=8.0, where=lambda m: m.real_time_factor > 0.0)
    assert seen.real_time_factor > 0.5
    assert len(seen.sensors) == 1


def test_box_spawns_falls_and_goes():
    pose = Pose()
    pose.position.x, pose.position.z = 5.0, 2.0
    answer = call("/gazebo/spawn_urdf_model", SpawnModel, "box", BOX, "", pose, "")
    assert answer.success, answer.status_message
    again = call("/gazebo/spawn_urdf_model", SpawnModel, "box", BOX, "", pose, "")
    assert not again.success
    assert "box" in again.status_message
    state = call("/gazebo/get_model_state", GetModelState, "box", "")
    assert state.success
    assert state.header.seq == 1
    assert state.pose.position.z < 2.0
    assert state.twist.linear.z < 0.0
    relative = call("/gazebo/get_model_state", GetModelState, "aras_visual_servo", "box::box")
    assert relative.pose.position.x == pytest.approx(-5.0, abs=1e-3)
    moved = ModelState(model_name="box")
    moved.pose.position.x, moved.pose.position.z = 6.0, 1.5
    assert call("/gazebo/set_model_state", SetModelState, moved).success
    state = call("/gazebo/get_model_state", GetModelState, "box", "")
    assert state.pose.position.x == pytest.approx(6.0, abs=1e-3)
    properties = call("/gazebo/get_model_properties", GetModelProperties, "box")
    assert (properties.body_names, properties.joint_names) == (["box"], [])
    assert call("/gazebo/delete_model", DeleteModel, "box").success
    gone = call("/gazebo/delete_model", DeleteModel, "box")
    assert not gone.success
    assert gone.status_message.startswith("DeleteModel: ")


@pytest.mark.parametrize("xml", ["", "<foo/>", "plain text"])
def test_what_is_no_urdf_makes_the_call_fail(xml):
    with pytest.raises(rospy.ServiceException, match="SpawnModel"):
        call("/gazebo/spawn_urdf_model", SpawnModel, "x", xml, "", Pose(), "")


def test_broken_urdf_is_refused_by_name():
    missing = BOX.replace("box size", "mesh filename").replace(
        '"0.1 0.1 0.1"', '"package://aras_visual_servo_gazebo/meshes/no_such.stl"'
    )
    for xml, text in ((BOX[:-9], ""), (missing, "no_such.stl")):
        answer = call("/gazebo/spawn_urdf_model", SpawnModel, "x", xml, "", Pose(), "")
        assert not answer.success
        assert text in answer.status_message
    pose = Pose()
    pose.position.x = math.nan
    answer = call("/gazebo/spawn_urdf_model", SpawnModel, "x", BOX, "", pose, "")
    assert not answer.success
    answer = call("/gazebo/spawn_urdf_model", SpawnModel, "x", BOX, "", Pose(), "no_frame")
    assert not answer.success
    assert "no_frame" in answer.status_message


def test_set_model_configuration_checks_lengths():
    name = "/gazebo/set_model_configuration"
    answer = call(name, SetModelConfiguration, "aras_visual_servo", "", ["J1"], [])
    assert not answer.success
    assert not call(name, SetModelConfiguration, "nobody", "", ["J1"], [0.0]).success


def test_reset_world_keeps_time_and_joints_follow_their_commands():
    before = call("/gazebo/get_world_properties", GetWorldProperties).sim_time
    call("/gazebo/reset_world", Empty)
    assert call("/gazebo/get_world_properties", GetWorldProperties).sim_time >= before
    assert len(running()) == 7


def test_reset_simulation_restarts_the_clock_and_everything_goes_on(collect):
    clock = collect("/clock", Clock)
    states = collect(f"{ROBOT}/joint_states", JointState)
    images = collect("/labrob/camera/image_raw", Image)
    images.wait(2, timeout=5.0)
    call("/gazebo/reset_simulation", Empty)
    for collector in (clock, states, images):
        collector.clear()
    assert clock.wait(3, timeout=5.0).clock.to_sec() < 5.0
    assert states.wait(3, timeout=5.0).header.stamp.to_sec() < 5.0
    assert images.wait(3, timeout=5.0).header.stamp.to_sec() < 5.0
    assert len(running()) == 7


def test_log_holds_no_traceback(bridge):
    assert "Traceback" not in bridge.output()


def test_interrupt_that_another_thread_takes_ends_the_node(launch):
    """The kernel gives a process's signal to any thread; only the main one runs the handler."""
    launched = launch("aras_sim_bridge", "empty_world.launch", own_master=True)
    found = wait_for(lambda: re.search(r"is up, process (\d+)", launched.output()), 30.0, "gazebo")
    process = int(found[1])
    threads = sorted(int(task.name) for task in Path(f"/proc/{process}/task").iterdir())
    other = threads[1]  # the first after the main thread lasts: it is rospy's
    if ctypes.CDLL(None, use_errno=True).tgkill(process, other, signal.SIGINT):
        raise OSError(ctypes.get_errno(), "tgkill")
    wait_for(lambda: not Path(f"/proc/{process}").exists(), 5.0, "the end of the node")
