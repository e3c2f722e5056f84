"""gazebo_ros's services with numbers: a paused world that is stepped, so every value is known."""

from __future__ import annotations

import math

import pytest
import rospy
from aras_sim_bridge.srv import StepWorld
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from gazebo_msgs.msg import LinkState
from gazebo_msgs.srv import (
    ApplyBodyWrench,
    ApplyJointEffort,
    BodyRequest,
    DeleteModel,
    GetJointProperties,
    GetLinkProperties,
    GetLinkState,
    GetModelState,
    GetPhysicsProperties,
    GetWorldProperties,
    JointRequest,
    SetModelConfiguration,
    SetPhysicsProperties,
    SpawnModel,
)
from geometry_msgs.msg import Pose, Vector3, Wrench
from ros_graph import wait_for
from std_srvs.srv import Empty

SLIDER = """<robot name="slider">
  <link name="world"/>
  <joint name="rail" type="prismatic">
    <parent link="world"/><child link="cart"/><origin xyz="0 0 1"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="100" velocity="10"/><dynamics damping="0.5"/>
  </joint>
  <link name="cart"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""
BALL = """<robot name="ball"><link name="ball"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def call(name: str, service: type, *args: object, **fields: object) -> object:
    """Call /gazebo/<name>, waiting for it."""
    rospy.wait_for_service(f"/gazebo/{name}", 20.0)
    return rospy.ServiceProxy(f"/gazebo/{name}", service)(*args, **fields)


def step(count: int) -> None:
    assert call("step_world", StepWorld, count).success


def spawn(name: str, xml: str, z: float) -> None:
    pose = Pose()
    pose.position.z = z
    answer = call("spawn_urdf_model", SpawnModel, name, xml, "", pose, "")
    assert answer.success, answer.status_message


@pytest.fixture(scope="module", autouse=True)
def world(launch, ros_node):
    """An empty world, standing still."""
    return launch(
        "aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True, speed_mode="max"
    )


@pytest.fixture
def ball():
    """A ball of 2 kg in the air, without gravity at work yet."""
    spawn("ball", BALL, 100.0)
    yield "ball"
    assert call("delete_model", DeleteModel, "ball").success


@pytest.fixture
def slider():
    """A cart of 2 kg on a level rail with damping 0.5."""
    spawn("slider", SLIDER, 0.0)
    yield "slider"
    assert call("delete_model", DeleteModel, "slider").success


def test_time_begins_at_zero_and_advances_by_steps():
    call("reset_simulation", Empty)
    step(7)
    assert call("get_world_properties", GetWorldProperties).sim_time == pytest.approx(0.007)


def test_ball_falls_as_gravity_says(ball):
    step(100)
    state = call("get_model_state", GetModelState, "ball", "world")
    assert state.twist.linear.z == pytest.approx(-0.98, abs=1e-6)
    assert state.pose.position.z == pytest.approx(100 - 0.5 * 9.8 * 0.1**2, abs=1e-3)


def test_wrench_acts_for_its_duration(ball):
    before = call("get_link_state", GetLinkState, "ball::ball", "").link_state
    wrench = Wrench(force=Vector3(4.0, 0.0, 0.0))
    answer = call(
        "apply_body_wrench",
        ApplyBodyWrench,
        body_name="ball",
        wrench=wrench,
        duration=rospy.Duration(0.05),
    )
    assert answer.success
    step(100)
    after = call("get_link_state", GetLinkState, "ball", "").link_state
    # 4 N on 2 kg for 50 ms; step 50 still counts, being at start + duration.
    assert after.twist.linear.x - before.twist.linear.x == pytest.approx(0.1, abs=1e-6)


def test_wrench_for_ever_is_cleared_by_its_scoped_name(ball):
    wrench = Wrench(torque=Vector3(0.0, 0.0, 1.0))
    for_ever = rospy.Duration(-1)
    assert call(
        "apply_body_wrench", ApplyBodyWrench, body_name="ball", wrench=wrench, duration=for_ever
    ).success
    step(100)
    spin = call("get_link_state", GetLinkState, "ball", "").link_state.twist.angular.z
    assert spin == pytest.approx(0.1, abs=1e-6)
    call("clear_body_wrenches", BodyRequest, "ball::ball")
    step(100)
    again = call("get_link_state", GetLinkState, "ball", "").link_state.twist.angular.z
    assert again == pytest.approx(spin, abs=1e-9)


def test_joint_effort_pushes_the_cart(slider):
    assert call(
        "apply_joint_effort",
        ApplyJointEffort,
        joint_name="rail",
        effort=10.0,
        duration=rospy.Duration(-1),
    ).success
    step(200)
    joint = call("get_joint_properties", GetJointProperties, "slider::rail")
    # m v' = F - d v
    expected = 10.0 / 0.5 * (1 - math.exp(-0.5 / 2 * 0.2))
    assert joint.rate[0] == pytest.approx(expected, rel=2e-3)
    assert joint.type == 2
    assert joint.damping == [0.5] or list(joint.damping) == [0.5]
    call("clear_joint_forces", JointRequest, "rail")
    step(1)
    slower = call("get_joint_properties", GetJointProperties, "rail").rate[0]
    assert slower < joint.rate[0]


def test_configuration_is_set_within_limits(slider):
    name = "set_model_configuration"
    assert call(name, SetModelConfiguration, "slider", "", ["rail", "none"], [0.25, 1.0]).success
    joint = call("get_joint_properties", GetJointProperties, "rail")
    assert joint.position[0] == pytest.approx(0.25)
    assert call(name, SetModelConfiguration, "slider", "", ["slider::rail"], [7.0]).success
    joint = call("get_joint_properties", GetJointProperties, "rail")
    assert joint.position[0] == pytest.approx(1.0)
    cart = call("get_link_state", GetLinkState, "slider::cart", "world").link_state
    assert (cart.pose.position.x, cart.pose.position.z) == pytest.approx((1.0, 1.0))
    assert not call(name, SetModelConfiguration, "slider", "", ["rail"], [math.nan]).success


def test_link_properties(slider):
    link = call("get_link_properties", GetLinkProperties, "cart")
    assert (link.mass, link.ixx, link.gravity_mode) == (2.0, 1.0, True)
    assert not call("get_link_properties", GetLinkProperties, "nothing").success


def test_physics_properties_are_told_and_set():
    before = call("get_physics_properties", GetPhysicsProperties)
    assert before.pause is True
    assert before.time_step == 0.001
    assert before.gravity.z == -9.8
    name = "set_physics_properties"
    moon = Vector3(0.0, 0.0, -1.62)
    args = (0.001, before.max_update_rate, moon, before.ode_config)
    assert call(name, SetPhysicsProperties, *args).success
    assert call("get_physics_properties", GetPhysicsProperties).gravity.z == -1.62
    assert rospy.get_param("/gazebo/gravity_z") == -1.62
    for bad in (0.0, 1e9, math.nan):
        refused = call(name, SetPhysicsProperties, bad, *args[1:])
        assert not refused.success
    request = Config(doubles=[DoubleParameter("gravity_z", -9.8)])
    call("set_parameters", Reconfigure, request)
    assert call("get_physics_properties", GetPhysicsProperties).gravity.z == -9.8


def test_set_link_state_topic_moves_a_ball(ball):
    topic = rospy.Publisher("/gazebo/set_link_state", LinkState, queue_size=1)
    wait_for(topic.get_num_connections, timeout=5.0, what="the subscriber")
    state = LinkState(link_name="ball::ball")
    state.pose.position.x, state.pose.position.z = 3.0, 50.0
    topic.publish(state)

    def there() -> bool:
        seen = call("get_model_state", GetModelState, "ball", "")
        return abs(seen.pose.position.x - 3.0) < 1e-9

    wait_for(there, timeout=5.0, what="the ball at its new place")


def test_log_holds_no_traceback(world):
    assert "Traceback" not in world.output()
    assert "internal error" not in world.output()
