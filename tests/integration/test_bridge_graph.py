"""The bridge from the view of its clients: a running robot, real topics and services."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import rospy
from control_msgs.msg import JointControllerState
from controller_manager_msgs.srv import ListControllers
from ros_graph import wait_for, wait_for_message
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64

ROBOT = "/aras_visual_servo"
MANAGER = f"{ROBOT}/controller_manager"


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


def stamp_ns(header) -> int:
    return header.stamp.secs * 10**9 + header.stamp.nsecs


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


def test_log_holds_no_traceback(bridge):
    assert "Traceback" not in bridge.output()
