"""Services of gazebo_ros for models, links and joints, in a stepped world."""

import math
from threading import Thread

import pytest
import rospy
from gazebo_msgs.msg import LinkState, ModelState, ODEJointProperties
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3, Wrench
from stepped_models import QUARTER, xyz

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros import conversions

FOR_EVER = rospy.Duration(-1)


def velocity(call):
    return call("get_link_state", "ball::ball").link_state.twist


def test_steps_advance_a_paused_world(api, call, step):
    answer = step(7)
    assert answer.sim_time.to_nsec() == 7_000_000
    assert call("get_world_properties").sim_time == pytest.approx(0.007)
    call("reset_simulation")
    assert call("get_world_properties").sim_time == 0.0
    api.thread.limits.clear()
    assert step(1).status_message == "made 1 steps" and api.thread.limits[0] == 600.0
    assert call("get_world_properties").rendering_enabled
    call("unpause_physics")
    assert not api.thread.paused
    assert "pause_physics" in call("step_world", 1, refused=True).status_message
    call("pause_physics")
    assert api.thread.paused
    call("step_world", 1)


def test_the_largest_number_of_steps_is_made(api):
    answers = []
    asking = Thread(target=lambda: answers.append(api.graph.call("/gazebo/step_world", 1_000_000)))
    asking.start()
    asking.join(0.05)
    api.thread.stop()
    asking.join(30.0)
    assert "1 to 1000000" not in answers[0].status_message


def test_resets(api, call, step, ball):
    step(50)
    api.thread.pacer.restarts.clear()
    api.resets.clear()
    call("reset_world")
    assert call("get_model_state", "ball", "").pose.position.z == pytest.approx(100.0)
    assert call("get_world_properties").sim_time == pytest.approx(0.05)
    assert api.resets == []
    call("reset_simulation")
    # more than once where the machine was busy: a job that lasted is not made good either
    assert api.resets == [0] and 0 in api.thread.pacer.restarts
    assert call("get_model_state", "ball", "").header.stamp.to_nsec() == 0


def test_state_of_a_model(call, step, ball):
    step(100)
    state = call("get_model_state", "ball", "world")
    assert state.twist.linear.z == pytest.approx(-0.98, abs=1e-6)
    assert state.pose.position.z == pytest.approx(100 - 0.5 * 9.8 * 0.1**2, abs=1e-3)
    assert (state.header.seq, state.header.stamp.to_nsec()) == (1, 100_000_000)
    assert state.header.frame_id == "world"
    assert call("get_model_state", "ball", "").header.seq == 2
    assert state.status_message == "GetModelState: got properties"
    for world in ("", "map", "/map"):
        assert call("get_model_state", "ball", world).pose == state.pose


def test_states_are_relative_to_frames(call, another, ball):
    another(Pose(Point(1.0, 0.0, 100.0), Quaternion()), "ball")
    # One metre along the ball's x, which is the world's y, and a hundred above it.
    state = call("get_model_state", "other", "")
    assert xyz(state.pose.position) == pytest.approx((0.0, 1.0, 200.0))
    state = call("get_model_state", "other", "ball")
    assert xyz(state.pose.position) == pytest.approx((1.0, 0.0, 100.0))
    link = call("get_link_state", "other::ball", "ball::ball").link_state
    assert xyz(link.pose.position) == pytest.approx((1.0, 0.0, 100.0))
    assert (link.link_name, link.reference_frame) == ("other::ball", "ball::ball")


def test_a_model_is_put_with_its_twist_in_the_frame_s_axes(api, call, another, ball):
    another(Pose())
    state = {
        "model_name": "other", "pose": Pose(Point(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
        "twist": Twist(Vector3(1.0, 0.0, 0.0), Vector3(0.0, 2.0, 0.0)), "reference_frame": "ball"}
    call("set_model_state", ModelState(**state))
    there = call("get_model_state", "other", "")
    assert xyz(there.pose.position) == pytest.approx((-2.0, 1.0, 103.0))
    assert xyz(there.twist.linear) == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)
    assert xyz(there.twist.angular) == pytest.approx((-2.0, 0.0, 0.0), abs=1e-9)
    # By topic as by service; what is wrong becomes a line.
    state["pose"] = Pose(Point(0.0, 0.0, 7.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    api.graph.subscribers["/gazebo/set_model_state"](ModelState(**state))
    assert xyz(call("get_model_state", "other", "").pose.position) == pytest.approx((0, 0, 107.0))
    api.graph.subscribers["/gazebo/set_model_state"](ModelState(model_name="nobody"))
    assert "'nobody' does not exist" in api.graph.lines[-1] and api.graph.periods == [1.0]


def test_a_link_state_is_less_the_frame_s_motion(api, call, another, ball):
    twist = Twist(Vector3(1.0, 0.0, 0.0), Vector3(0.0, 0.0, 3.0))
    pose = Pose(Point(0.0, 0.0, 100.0), QUARTER)
    call("set_model_state", ModelState("ball", pose, twist, "world"))
    another(Pose(Point(5.0, 0.0, 0.0), Quaternion()))
    rolls = Twist(Vector3(), Vector3(2.0, 0.0, 0.0))
    there = Pose(Point(5.0, 0.0, 0.0), Quaternion())
    call("set_model_state", ModelState("other", there, rolls, ""))
    seen = call("get_link_state", "other::ball", "ball").link_state
    # In the ball's axes, whose y is the world's -x.
    assert xyz(seen.twist.linear) == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)
    assert xyz(seen.twist.angular) == pytest.approx((0.0, -2.0, -3.0), abs=1e-9)
    wanted = Twist(Vector3(4.0, 0.0, 0.0), Vector3(0.0, 5.0, 0.0))
    state = LinkState("other::ball", Pose(Point(1.0, 0.0, 0.0), Quaternion(w=1.0)), wanted, "ball")
    call("set_link_state", state)
    there = call("get_link_state", "other::ball").link_state
    assert xyz(there.pose.position) == pytest.approx((0.0, 1.0, 100.0))
    assert xyz(there.twist.linear) == pytest.approx((3.0, 0.0, 0.0))
    assert xyz(there.twist.angular) == pytest.approx((0.0, 5.0, -3.0))
    there = Pose(Point(), Quaternion(w=1.0))
    api.graph.subscribers["/gazebo/set_link_state"](LinkState("other::ball", there, Twist(), ""))
    assert xyz(call("get_model_state", "other", "").pose.position) == (0.0, 0.0, 0.0)
    # The zero quaternion is none where Gazebo takes it so: not in set_link_state.
    call("set_model_state", ModelState("other", Pose(position=Point(0, 0, 1e5)), Twist(), ""))
    assert call("get_model_state", "other", "").pose.orientation.w == 1.0


def test_a_force_acts_from_its_start_for_its_duration(api, call, step, ball):
    force = Wrench(force=Vector3(4.0, 0.0, 0.0))
    call("apply_body_wrench", body_name="ball", wrench=force)  # of no duration
    step(3)
    assert velocity(call).linear.x == 0.0 and api.thread.before_step is None
    call("apply_body_wrench", body_name="ball", wrench=force, duration=rospy.Duration(0.05))
    step(100)
    # 4 N on 2 kg for 50 ms; step 50 still counts, being at start + duration.
    assert xyz(velocity(call).linear) == pytest.approx((0.1, 0.0, -1.0094), abs=1e-6)
    call("apply_body_wrench", body_name="ball", wrench=Wrench(force=Vector3(0.0, 4.0, 0.0)),
         start_time=rospy.Time(0.12), duration=rospy.Duration(0.01))
    step(16)
    assert velocity(call).linear.y == 0.0
    step(100)
    assert velocity(call).linear.y == pytest.approx(0.022, abs=1e-9)


def test_what_is_cleared_of_bodies_stays_on_joints_and_the_reverse(call, step, ball, slider):
    pushes = {"wrench": Wrench(force=Vector3(1.0, 0.0, 0.0)), "duration": FOR_EVER}
    call("apply_body_wrench", body_name="ball", **pushes)
    call("apply_joint_effort", joint_name="rail", effort=1.0, duration=FOR_EVER)
    for clear, name, pushed in (
        ("clear_body_wrenches", "rail", True), ("clear_joint_forces", "ball::ball", True),
        ("clear_body_wrenches", "somebody::else", True),
        ("clear_body_wrenches", "ball::ball", False)):
        call(clear, name)
        before = velocity(call).linear.x, call("get_joint_properties", "rail").rate[0]
        step(5)
        assert (velocity(call).linear.x > before[0]) is pushed
        assert call("get_joint_properties", "rail").rate[0] > before[1]


def test_a_force_off_the_origin_turns(call, step, ball):
    """At (0, 1, 0) m, 1 N along x: a torque of -1 N m about z on 1 kg m²."""
    wrench = Wrench(force=Vector3(1.0, 0.0, 0.0), torque=Vector3(0.0, 2.0, 0.0))
    call("apply_body_wrench", body_name="ball::ball", wrench=wrench, duration=FOR_EVER,
         reference_point=Point(0.0, 1.0, 0.0))
    step(10)
    twist = velocity(call)
    assert xyz(twist.angular) == pytest.approx((0.0, 0.02, -0.01), abs=1e-5)
    assert twist.linear.x == pytest.approx(0.005, abs=1e-9)


def test_a_wrench_in_a_frame_acts_in_its_axes_and_at_its_place(call, step, another, ball):
    """The other's x is the world's x and it lies 1 m along y: 1 N along x turns by -1 N m."""
    another(Pose(Point(0.0, 1.0, 100.0), QUARTER))
    wrench = Wrench(force=Vector3(0.0, -1.0, 0.0), torque=Vector3(3.0, 0.0, 0.0))
    call("apply_body_wrench", body_name="ball", wrench=wrench, duration=FOR_EVER,
         reference_frame="other")
    step(10)
    twist = velocity(call)
    assert xyz(twist.linear)[:2] == pytest.approx((0.005, 0.0), abs=1e-9)
    assert xyz(twist.angular) == pytest.approx((0.0, 0.03, -0.01), abs=1e-5)


def test_pushes_of_a_deleted_model_go_with_it(api, call, step, ball, slider):
    call("apply_body_wrench", body_name="ball", wrench=Wrench(force=Vector3(1.0, 0.0, 0.0)),
         duration=FOR_EVER)
    call("apply_joint_effort", joint_name="rail", effort=1.0, duration=FOR_EVER)
    call("delete_model", "ball")
    assert api.graph_synced == [2, 3, 2]
    step(2)
    assert call("get_joint_properties", "rail").rate[0] > 0.0
    call("delete_model", "slider")
    assert api.thread.before_step is None


def test_efforts_on_a_joint(call, step, slider):
    call("apply_joint_effort", joint_name="slider::rail", effort=10.0, duration=FOR_EVER)
    step(100)
    properties = call("get_joint_properties", "rail")
    v = 20.0 * (1.0 - math.exp(-0.25 * 0.1))
    assert properties.rate == pytest.approx([v], rel=1e-3)
    assert properties.position[0] == pytest.approx(0.025, rel=0.02)
    assert (properties.damping, properties.type) == ([0.5], properties.PRISMATIC)
    call("clear_joint_forces", "bolt")
    step(1)
    assert call("get_joint_properties", "rail").rate[0] > v
    call("clear_joint_forces", "rail")
    v = call("get_joint_properties", "rail").rate[0]
    step(1)
    assert call("get_joint_properties", "rail").rate[0] < v
    fixed = call("get_joint_properties", "bolt")
    assert (fixed.type, fixed.position, fixed.rate, fixed.damping) == (fixed.FIXED, [], [], [])


def test_properties_of_a_model_and_its_links(call, slider):
    model = call("get_model_properties", "slider")
    assert model.body_names == ["world", "cart", "box"]
    assert (model.geom_names, model.joint_names) == (["box_collision"], ["rail", "bolt"])
    assert model.is_static is False
    assert call("get_model_properties", "ground_plane").is_static is True
    link = call("get_link_properties", "cart")
    assert (link.mass, xyz(link.com.position)) == (2.0, (0.1, 0.2, 0.3))
    assert link.com.orientation.w == 1.0
    inertia = (link.ixx, link.ixy, link.ixz, link.iyy, link.iyz, link.izz)
    assert inertia == (1.0, 0.01, 0.02, 1.1, 0.03, 1.2)
    assert call("get_link_properties", "box").mass == 0.0


def test_a_link_gets_other_properties(call, step, ball):
    call("set_link_properties", link_name="ball", mass=4.0, ixx=1.0, iyy=1.5, izz=2.0,
         com=Pose(position=Point(0.1, 0.0, 0.0)), gravity_mode=False)
    link = call("get_link_properties", "ball")
    assert (link.mass, link.ixx, link.iyy, link.izz) == (4.0, 1.0, 1.5, 2.0)
    assert (xyz(link.com.position), link.gravity_mode) == ((0.1, 0.0, 0.0), False)
    wrench = Wrench(force=Vector3(4.0, 0.0, 0.0), torque=Vector3(0.0, 0.0, 4.0))
    call("apply_body_wrench", body_name="ball", wrench=wrench, duration=FOR_EVER)
    step(10)
    # The centre of mass goes at F t / m; the link's origin is 0.1 m beside it, along y.
    assert xyz(velocity(call).linear) == pytest.approx((0.01 + 0.1 * 0.02, 0.0, 0.0), abs=1e-5)
    assert velocity(call).angular.z == pytest.approx(0.02, abs=1e-6)


def test_a_joint_gets_other_properties(call, step, slider):
    config = ODEJointProperties(damping=[2.0], hiStop=[0.5], vel=[0.0], cfm=[1.0])
    answer = call("set_joint_properties", "rail", config)
    assert answer.status_message.endswith("are ignored, because only ODE has them: cfm")
    assert call("get_joint_properties", "rail").damping == [2.0]
    call("set_model_configuration", "slider", "", ["slider::rail", "who"], [1.5, 0.0])
    assert call("get_joint_properties", "rail").position == pytest.approx([0.5])
    answer = call("set_model_configuration", "slider", "", ["rail"], [-1.5])
    assert call("get_joint_properties", "rail").position == pytest.approx([-1.0])
    assert "rail is set to its limit -1, because -1.5 is beyond it" in answer.status_message
    call("set_joint_properties", "rail", ODEJointProperties(damping=[3.0]))
    assert call("get_joint_properties", "rail").damping == [3.0]


TURNING = """<robot name="turning"><link name="a"/>
  <joint name="hinge" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="-0.25" upper="0.5" effort="9" velocity="9"/></joint><link name="b"/>
  <joint name="wheel" type="continuous"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
    <dynamics damping="0.75"/></joint><link name="c"/>
</robot>"""


def test_joints_of_every_type_and_of_models_that_stand(call):
    mass = '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    text = TURNING
    for name in "bc":
        link = f'<link name="{name}"'
        text = text.replace(f"{link}/>", f"{link}><inertial>{mass}</inertial></link>")
    call("spawn_urdf_model", "turning", text, "", Pose(), "")
    hinge, wheel = (call("get_joint_properties", name) for name in ("hinge", "wheel"))
    assert (hinge.type, wheel.type) == (hinge.REVOLUTE, hinge.CONTINUOUS)
    assert (wheel.damping, wheel.position, wheel.rate) == ([0.75], [0.0], [0.0])
    call("set_model_configuration", "turning", "", ["wheel", "hinge"], [7.0, -3.0])
    positions = [call("get_joint_properties", name).position[0] for name in ("wheel", "hinge")]
    assert positions == pytest.approx([7.0, -0.25])  # the one has no limits
    call("set_joint_properties", "hinge", ODEJointProperties(loStop=[-1.5], fmax=[0.125]))
    call("set_model_configuration", "turning", "", ["hinge"], [-3.0])
    assert call("get_joint_properties", "hinge").position == pytest.approx([-1.5])
    still = text.replace("</robot>", "<gazebo><static>true</static></gazebo></robot>")
    call("spawn_urdf_model", "still", still, "", Pose(), "")
    for name in ("still::hinge", "still::wheel"):
        told = call("get_joint_properties", name)
        assert (told.position, told.rate) == ([0.0], [0.0])


def test_bounds_of_numbers_and_times_in_nanoseconds():
    for value in (1e9, -1e9):
        assert conversions.check_bounds((0.0, value), "it") == (0.0, value)
        for wrong in (1.001 * value, math.nan):
            with pytest.raises(WorldError, match="it: .* must be finite and within ±1e.09"):
                conversions.check_bounds((0.0, wrong), "it")
    assert conversions.to_time(3_000_000_004) == rospy.Time(3, 4)
    assert conversions.from_time(rospy.Duration(-2, 5)) == -1_999_999_995
    assert conversions.to_duration(1.25) == rospy.Duration(1, 250_000_000)
