"""Both reset services with controllers and cameras, and models from the program `spawn_model`."""

import math
import subprocess

import pytest
import rospy
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from gazebo_calls import ARM, BRICK, EYE, at, call, delete, place, spawn, step
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import GetJointProperties, GetWorldProperties, SetModelState
from geometry_msgs.msg import Twist
from ros_graph import wait_for
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64
from std_srvs.srv import Empty

CONTROLLERS = {
    "hold": {"type": "effort_controllers/JointPositionController", "joint": "swing",
             "pid": {"p": 400.0, "i": 0.0, "d": 40.0}},
    "joint_states": {"type": "joint_state_controller/JointStateController", "publish_rate": 100}}


@pytest.fixture(scope="module", autouse=True)
def world(launch, ros_node):
    """Ground and sun, standing still."""
    launched = launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True,
                      speed_mode="max")
    yield launched
    assert "Traceback" not in launched.output() and "internal error" not in launched.output()


def angle() -> float:
    return call("get_joint_properties", GetJointProperties, "swing").position[0]


def world_properties() -> GetWorldProperties:
    return call("get_world_properties", GetWorldProperties)


def test_resets_with_controllers_and_images(collect):
    rospy.set_param("/arm", CONTROLLERS)
    spawn("arm", ARM, initial_pose=at(3, 0, 0))
    spawn("eye", EYE)
    for name in CONTROLLERS:
        assert call("/arm/controller_manager/load_controller", LoadController, name).ok
    call("/arm/controller_manager/switch_controller", SwitchController, list(CONTROLLERS), [], 2,
         False, 0.0)
    topics = (collect("/arm/joint_states", JointState), collect("/eye/image_raw", Image),
              collect("/eye/camera_info", CameraInfo))
    clock = collect("/clock", Clock)
    command = rospy.Publisher("/arm/hold/command", Float64, queue_size=1)
    wait_for(command.get_num_connections, timeout=5.0, what="the controller")
    for topic in (*topics, clock):
        wait_for(topic.connected, timeout=5.0, what=topic.topic)
    command.publish(0.75)
    wait_for(lambda: step(500) or abs(angle() - 0.75) < 1e-3, timeout=10.0, what="the command")
    elsewhere = ModelState("arm", at(4, 1, 1), Twist(), "")
    assert call("set_model_state", SetModelState, elsewhere).success
    time = world_properties().sim_time

    call("reset_world", Empty)  # the pose goes back; time, angles and set points stay
    assert place("arm") == pytest.approx((3, 0, 0))
    assert angle() == pytest.approx(0.75, abs=1e-3) and world_properties().sim_time == time
    step(20)  # upstream's first period would be the whole time: a kick
    assert angle() == pytest.approx(0.75, abs=1e-3)

    call("reset_simulation", Empty)  # all of it goes back; controllers go on with their set points
    assert angle() == 0.0 and world_properties().sim_time == 0.0
    for topic in (*topics, clock):
        topic.clear()
    step(30)
    for topic in topics:
        stamps = [topic.wait(i + 1).header.stamp.to_nsec() for i in range(3)]
        first = 1_000_000 if topic is topics[0] else 10_000_000  # joint_states: at the first step
        assert stamps == [first, first + 10_000_000, first + 20_000_000], topic.topic
    clock.wait(3)
    assert [m.clock.to_nsec() // 1_000_000 for m in clock.messages[:3]] == [1, 4, 8]
    infos = call("/arm/controller_manager/list_controllers", ListControllers).controller
    assert {c.name: c.state for c in infos} == dict.fromkeys(CONTROLLERS, "running")
    step(1500)
    assert angle() == pytest.approx(0.75, abs=1e-3)
    delete("arm", "eye")
    assert world_properties().model_names == ["ground_plane"]


def test_spawn_model_script_with_its_options(world, tmp_path):
    """-reference_frame, -J, -wait, -b; exit status on refusal."""
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    script = ["rosrun", "aras_sim_bridge", "spawn_model", "-urdf", "-file", str(file)]
    spawn("stand", BRICK, "sdf", initial_pose=at(0, 6, 5, math.pi / 2))
    bound = subprocess.Popen(
        [*script, "-model", "arm", "-wait", "late", "-reference_frame", "stand", "-x", "1",
         "-z", "2", "-Y", "0.5", "-J", "swing", "0.25", "-b"], env=world.master.environment)
    try:
        step(1)
        assert "arm" not in world_properties().model_names
        spawn("late", BRICK, "sdf", initial_pose=at(9, 9, 5))

        def there() -> bool:
            step(1)  # model_states come with steps
            return call("get_joint_properties", GetJointProperties, "swing").position == (0.25,)

        wait_for(there, timeout=20.0, what="the arm", interval=0.1)
        assert place("arm")[:2] == pytest.approx((0, 7))
        again = world.master.run([*script, "-model", "arm"], check=False)
        assert again.returncode == 1 and "exists" in again.stdout + again.stderr
    finally:
        bound.send_signal(2)
        bound.wait(10.0)
    assert "arm" not in world_properties().model_names
    delete("stand", "late")
