"""Clock, both reset services with controllers and cameras, and the state topics of /gazebo."""

from __future__ import annotations

from itertools import pairwise

import pytest
import rospy
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from gazebo_calls import ARM, EYE, at, call, delete, place, spawn, step
from gazebo_msgs.srv import (
    GetJointProperties,
    GetWorldProperties,
    SetModelState,
)
from geometry_msgs.msg import Twist
from ros_graph import wait_for
from roscpp.srv import GetLoggers, SetLoggerLevel
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64
from std_srvs.srv import Empty


@pytest.fixture(scope="module", autouse=True)
def world(launch, ros_node):
    """Ground and sun, standing still."""
    return launch(
        "aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True, speed_mode="max"
    )


def test_clock_stands_in_pause_and_goes_back_only_on_reset(collect):
    clock = collect("/clock", Clock)
    call("unpause_physics", Empty)
    clock.wait(20, timeout=10.0)
    call("reset_world", Empty)
    clock.wait(40, timeout=10.0)
    call("pause_physics", Empty)
    time = call("get_world_properties", GetWorldProperties).sim_time
    # As fast as it goes, ticks come faster than they are read here: what is on its way comes first.
    wait_for(lambda: clock.messages[-1].clock.to_sec() > time - 0.004, 10.0, "the last tick")
    rospy.rostime.wallsleep(0.3)
    assert call("get_world_properties", GetWorldProperties).sim_time == time
    ticks = [m.clock.to_nsec() for m in clock.messages]
    assert all(b > a for a, b in pairwise(ticks))
    call("reset_simulation", Empty)
    clock.clear()
    step(8)
    clock.wait(3)
    assert [m.clock.to_nsec() for m in clock.messages] == [1_000_000, 4_000_000, 8_000_000]


def test_resets_with_controllers_and_images(collect):
    controllers = {
        "hold": {"type": "effort_controllers/JointPositionController", "joint": "swing",
                 "pid": {"p": 400.0, "i": 0.0, "d": 40.0}},
        "joint_states": {"type": "joint_state_controller/JointStateController",
                         "publish_rate": 100},
    }  # fmt: skip
    rospy.set_param("/arm", controllers)
    spawn("arm", ARM, initial_pose=at(3, 0, 0))
    spawn("eye", EYE)
    for name in controllers:
        assert call("/arm/controller_manager/load_controller", LoadController, name).ok
    call("/arm/controller_manager/switch_controller", SwitchController, list(controllers), [], 2,
         False, 0.0)  # fmt: skip
    topics = (
        collect("/arm/joint_states", JointState),
        collect("/eye/image_raw", Image),
        collect("/eye/camera_info", CameraInfo),
    )
    command = rospy.Publisher("/arm/hold/command", Float64, queue_size=1)
    wait_for(command.get_num_connections, timeout=5.0, what="the controller")
    for topic in topics:
        wait_for(topic.connected, timeout=5.0, what=topic.topic)
    command.publish(0.75)

    def angle() -> float:
        return call("get_joint_properties", GetJointProperties, "swing").position[0]

    wait_for(lambda: step(500) or abs(angle() - 0.75) < 1e-3, timeout=10.0, what="the command")
    elsewhere = at(4, 1, 1)
    from gazebo_msgs.msg import ModelState

    assert call("set_model_state", SetModelState, ModelState("arm", elsewhere, Twist(), "")).success
    time = call("get_world_properties", GetWorldProperties).sim_time

    call("reset_world", Empty)  # the pose goes back; time, angles and set points stay
    assert place("arm") == pytest.approx((3, 0, 0))
    assert angle() == pytest.approx(0.75, abs=1e-3)
    assert call("get_world_properties", GetWorldProperties).sim_time == time
    step(20)  # upstream's first period would be the whole time: a kick
    assert angle() == pytest.approx(0.75, abs=1e-3)

    call("reset_simulation", Empty)  # all of it goes back; controllers go on with their set points
    assert angle() == 0.0
    assert call("get_world_properties", GetWorldProperties).sim_time == 0.0
    for topic in topics:
        topic.clear()
    step(30)
    for topic in topics:
        stamps = [topic.wait(i + 1).header.stamp.to_nsec() for i in range(3)]
        first = 1_000_000 if topic is topics[0] else 10_000_000  # joint_states: at the first step
        assert stamps == [first, first + 10_000_000, first + 20_000_000], topic.topic
    infos = call("/arm/controller_manager/list_controllers", ListControllers).controller
    assert {c.name: c.state for c in infos} == dict.fromkeys(controllers, "running")
    step(1500)
    assert angle() == pytest.approx(0.75, abs=1e-3)
    delete("arm", "eye")
    assert call("get_world_properties", GetWorldProperties).model_names == ["ground_plane"]


def test_loggers_answer():
    names = [logger.name for logger in call("get_loggers", GetLoggers).loggers]
    assert "rosout" in names
    call("set_logger_level", SetLoggerLevel, "rosout", "WARN")
    levels = {logger.name: logger.level for logger in call("get_loggers", GetLoggers).loggers}
    assert levels["rosout"].upper() in ("WARN", "WARNING")
    call("set_logger_level", SetLoggerLevel, "rosout", "INFO")


def test_log_holds_no_traceback(world):
    assert "Traceback" not in world.output()
    assert "internal error" not in world.output()
