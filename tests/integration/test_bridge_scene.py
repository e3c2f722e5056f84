"""What stands in the world: SDF models, lights, properties set at run time, states, world files."""

from __future__ import annotations

import math
import subprocess

import numpy as np
import pytest
import rospy
from gazebo_calls import (
    ARM,
    BRICK,
    EYE,
    INERTIA,
    LAMP,
    SHAPES,
    at,
    call,
    delete,
    place,
    spawn,
    step,
)
from gazebo_msgs.msg import LinkStates, ModelStates, ODEJointProperties, PerformanceMetrics
from gazebo_msgs.srv import (
    ApplyBodyWrench,
    ApplyJointEffort,
    DeleteLight,
    GetJointProperties,
    GetLightProperties,
    GetLinkProperties,
    GetLinkState,
    GetModelProperties,
    GetModelState,
    GetWorldProperties,
    SetJointProperties,
    SetLightProperties,
    SetLinkProperties,
    SetModelState,
    SpawnModel,
)
from geometry_msgs.msg import Pose, Twist, Vector3, Wrench
from ros_graph import wait_for
from sensor_msgs.msg import Image
from std_msgs.msg import ColorRGBA
from std_srvs.srv import Empty

# Two links that swing in three dimensions on a base that flies.
SWING = f"""<robot name="swing"><link name="base"><inertial><origin xyz="0.1 0 0.05"/>
    <mass value="3"/>{INERTIA}</inertial></link>
  <joint name="a" type="continuous"><parent link="base"/><child link="upper"/>
    <origin xyz="0.2 0 0.1" rpy="0.3 0 0"/><axis xyz="0 1 0"/></joint>
  <link name="upper"><inertial><origin xyz="0 0 -0.3"/><mass value="1"/>{INERTIA}</inertial></link>
  <joint name="b" type="prismatic"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 -0.5"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="9"
    velocity="9"/></joint>
  <link name="lower"><inertial><mass value="1"/>{INERTIA}</inertial></link></robot>"""


@pytest.fixture(scope="module", autouse=True)
def world(launch, ros_node):
    """Ground and sun, standing still."""
    return launch(
        "aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True, speed_mode="max"
    )


@pytest.fixture(scope="module")
def mesh() -> str:
    from pathlib import Path

    folder = Path(__file__).parents[2] / "src/aras_visual_servo_gazebo/meshes"
    return sorted(path.name for path in folder.glob("*.stl"))[0]


def test_sdf_pose_is_composed_with_the_initial_pose_and_the_reference(mesh):
    spawn("table", SHAPES.format(mesh=mesh), "sdf", initial_pose=at(2, 0, 0, math.pi / 2))
    assert place("table") == pytest.approx((2, 0, 1))
    spawn("second", SHAPES.format(mesh=mesh), "sdf", initial_pose=at(1, 0, 0),
          reference_frame="table")  # fmt: skip
    # 1 m along the table's x, which points along the world's y; twice 1 m up.
    assert place("second") == pytest.approx((2, 1, 2))
    leg = call("get_link_state", GetLinkState, "table::leg", "map").link_state.pose.position
    assert (leg.x, leg.y, leg.z) == pytest.approx((2, 0, 0.5))
    near = call("get_link_state", GetLinkState, "table::leg", "second").link_state.pose.position
    assert (near.x, near.y, near.z) == pytest.approx((-1, 0, -1.5))
    properties = call("get_model_properties", GetModelProperties, "table")
    assert properties.is_static
    assert properties.body_names == ["top", "leg"]
    assert properties.geom_names == ["c", "knob"]
    assert properties.canonical_body_name == ""
    delete("second")
    names = call("get_world_properties", GetWorldProperties).model_names
    assert names == ["ground_plane", "table"]


def test_brick_falls_onto_the_table_and_stays():
    spawn("brick", BRICK, "sdf", initial_pose=at(2, 0, 1.25))
    step(600)
    assert place("brick") == pytest.approx((2, 0, 1.2), abs=2e-3)  # table's top at 1.1
    delete("brick", "table")


def test_bare_and_scoped_names_find_the_same():
    spawn("one", BRICK, "sdf", initial_pose=at(1, 0, 5))
    spawn("two", BRICK, "sdf", initial_pose=at(2, 0, 5))
    for name, x in (("brick", 1), ("one::brick", 1), ("two::brick", 2)):
        found = call("get_link_state", GetLinkState, name, "world").link_state
        assert found.pose.position.x == x
        assert (found.link_name, found.reference_frame) == (name, "world")
    for alias in ("", "world", "map", "/map"):
        assert place("two", alias) == (2, 0, 5)
    assert place("two", "one") == (1, 0, 0)
    state = call("get_model_state", GetModelState, "two", "one")
    again = call("get_model_state", GetModelState, "two", "one")
    assert (again.header.seq, again.header.frame_id) == (state.header.seq + 1, "one")
    delete("one", "two")


def test_model_state_in_a_frame():
    spawn("frame", BRICK, "sdf", initial_pose=at(0, 0, 5, math.pi / 2))
    spawn("mover", BRICK, "sdf", initial_pose=at(0, 3, 5))
    request = call("get_model_state", GetModelState, "mover", "frame")
    position = request.pose.position
    assert (position.x, position.y, position.z) == pytest.approx((3, 0, 0))
    from gazebo_msgs.msg import ModelState

    wanted = ModelState("mover", at(1, 2, 0), Twist(linear=Vector3(1, 0, 0)), "frame")
    assert call("set_model_state", SetModelState, wanted).success
    state = call("get_model_state", GetModelState, "mover", "")
    p, v = state.pose.position, state.twist.linear
    assert (p.x, p.y, p.z) == pytest.approx((-2, 1, 5))
    assert (v.x, v.y, v.z) == pytest.approx((0, 1, 0), abs=1e-9)
    seen = call("get_model_state", GetModelState, "mover", "frame").twist.linear
    assert (seen.x, seen.y, seen.z) == pytest.approx((1, 0, 0), abs=1e-9)
    delete("frame", "mover")


def test_link_properties_change_what_a_force_does():
    spawn("brick", BRICK, "sdf", initial_pose=at(0, 0, 500))
    fields = {"link_name": "brick::brick", "mass": 8.0, "ixx": 2.0, "iyy": 3.0, "izz": 4.0}
    fields["com"] = at(0.1, 0, 0)
    assert call("set_link_properties", SetLinkProperties, gravity_mode=False, **fields).success
    got = call("get_link_properties", GetLinkProperties, "brick")
    assert (got.mass, got.ixx, got.iyy, got.izz) == (8.0, 2.0, 3.0, 4.0)
    assert (got.gravity_mode, got.com.position.x) == (False, 0.1)
    assert call("apply_body_wrench", ApplyBodyWrench, body_name="brick",
                wrench=Wrench(Vector3(0, 4, 0), Vector3(0, 0, 1)),
                duration=rospy.Duration(-1)).success  # fmt: skip
    step(100)
    twist = call("get_link_state", GetLinkState, "brick", "").link_state.twist
    w = 1.0 / 4.0 * 0.1
    assert twist.angular.z == pytest.approx(w, rel=1e-6)
    # The centre of mass goes at F t / m; the link's origin is 0.1 m behind it.
    assert twist.linear.y == pytest.approx(4.0 / 8.0 * 0.1 - w * 0.1, rel=1e-4)
    assert twist.linear.z == pytest.approx(0.0, abs=1e-9)  # no gravity
    delete("brick")


def test_joint_properties_change_the_joint():
    spawn("arm", ARM)
    config = ODEJointProperties(damping=[4.0], hiStop=[0.5], loStop=[-0.25], cfm=[0.1])
    answer = call("set_joint_properties", SetJointProperties, "swing", config)
    assert answer.success
    assert "cfm" in answer.status_message
    assert list(call("get_joint_properties", GetJointProperties, "swing").damping) == [4.0]
    push = {"joint_name": "swing", "effort": 2.0, "duration": rospy.Duration(-1)}
    assert call("apply_joint_effort", ApplyJointEffort, **push).success
    step(200)
    rate = call("get_joint_properties", GetJointProperties, "swing").rate[0]
    # I w' = T - d w, I = 1
    assert rate == pytest.approx(2.0 / 4.0 * (1 - math.exp(-4.0 * 0.2)), rel=5e-3)
    step(2500)
    assert call("get_joint_properties", GetJointProperties, "swing").position[0] == pytest.approx(
        0.5, abs=5e-3
    )
    delete("arm")


def test_light_is_told_set_and_seen(collect):
    spawn("eye", EYE)
    plate = SHAPES.partition("<link name=\"leg\"")[0] + "</model></sdf>"
    spawn("plate", plate, "sdf", initial_pose=at(0, 0, -0.5))
    images = collect("/eye/image_raw", Image)

    def brightness() -> int:
        images.clear()
        step(20)
        image = images.wait(1, timeout=10.0)
        return np.frombuffer(image.data, np.uint8).reshape(24, 32, 3)[12, 16, 1]

    wait_for(lambda: rospy.get_published_topics("/eye"), timeout=5.0, what="the camera")
    wait_for(images.connected, timeout=5.0, what="the image")
    up = 0.9 / math.hypot(0.5, 0.1, 0.9)
    # A white plate square to the sun would give back 0.4 + 0.8, and be 255.
    assert brightness() == pytest.approx(255 * (0.4 + 0.8 * up) / 1.2, abs=1)
    told = call("get_light_properties", GetLightProperties, "sun")
    assert told.diffuse.r == pytest.approx(0.8)
    assert told.attenuation_constant == pytest.approx(0.9)
    values = {"light_name": "sun", "diffuse": ColorRGBA(0.2, 0.2, 0.2, 1.0)}
    assert call("set_light_properties", SetLightProperties, **values).success
    told = call("get_light_properties", GetLightProperties, "sun")
    assert (told.diffuse.r, told.attenuation_constant) == (pytest.approx(0.2), 0.0)
    assert brightness() == pytest.approx(255 * (0.4 + 0.2 * up), abs=1)
    values["direction"] = Vector3(0, 0, -2)
    assert call("set_light_properties", SetLightProperties, **values).success
    assert brightness() == pytest.approx(255 * 0.6, abs=1)
    metrics = collect("/gazebo/performance_metrics", PerformanceMetrics)
    wait_for(lambda: step(1) or metrics.messages, timeout=10.0, what="metrics", interval=0.1)
    (sensor,) = metrics.messages[-1].sensors
    assert (sensor.name, sensor.sim_update_rate) == ("eye", 100.0)
    assert call("delete_light", DeleteLight, "sun").success
    assert brightness() == pytest.approx(255 * 0.4, abs=1)
    assert not call("delete_light", DeleteLight, "sun").success
    sun = LAMP.replace("point", "directional").replace("<pose>0 0 3 0 0 0</pose>", "")
    spawn("sun", sun.replace("0.5 0.25 1 1", "0.3 0.3 0.3 1"), "sdf")
    assert brightness() == pytest.approx(255 * 0.7, abs=1)  # straight down, SDF's default
    now = call("get_world_properties", GetWorldProperties).sim_time
    sun = sun.replace("0.5 0.25 1 1", "0.3 0.3 0.3 1").replace("given", "later")
    times = f"<aras:shines>{now + 0.05:.3f} {now + 0.1:.3f}</aras:shines></light>"
    spawn("later", sun.replace("</light>", times), "sdf")
    assert brightness() == pytest.approx(255 * 0.7, abs=1)
    step(40)
    assert brightness() == pytest.approx(255, abs=1)
    step(60)
    assert brightness() == pytest.approx(255 * 0.7, abs=1)
    assert call("delete_light", DeleteLight, "later").success
    delete("eye", "plate")


def test_lamp_is_spawned_and_told():
    spawn("lamp", LAMP, "sdf", initial_pose=at(1, 0, 0))
    told = call("get_light_properties", GetLightProperties, "lamp")
    assert (told.diffuse.r, told.diffuse.g, told.diffuse.b) == (0.5, 0.25, 1.0)
    assert told.attenuation_quadratic == 0.125
    again = call("spawn_sdf_model", SpawnModel, model_name="lamp", model_xml=LAMP)
    assert not again.success
    assert "exists" in again.status_message
    assert call("delete_light", DeleteLight, "lamp").success


def test_twists_agree_with_finite_differences(collect):
    spawn("swing", SWING, initial_pose=at(0, 0, 50))
    for joint, effort in (("a", 3.0), ("b", 1.0)):
        assert call("apply_joint_effort", ApplyJointEffort, joint_name=joint, effort=effort,
                    duration=rospy.Duration(0.2)).success  # fmt: skip
    step(300)
    links, models = collect("/gazebo/link_states", LinkStates), collect(
        "/gazebo/model_states", ModelStates
    )
    for topic in (links, models):
        wait_for(topic.connected, timeout=5.0, what=topic.topic)
    step(1)  # the connection may be younger here than there
    wait_for(lambda: step(1) or links.messages, timeout=5.0, what="link_states")
    for topic in (links, models):
        topic.clear()
    for count in range(3):
        step(1)
        links.wait(count + 1, timeout=5.0)
        models.wait(count + 1, timeout=5.0)
    names = ["ground_plane::link", "swing::base", "swing::upper", "swing::lower"]
    for topic, expected in ((links, names), (models, ["ground_plane", "swing"])):
        before, now, after = topic.messages[:3]
        assert now.name == expected
        for i in range(1, len(expected)):
            ends = [vector(m.pose[i].position) for m in (before, after)]
            speed = (ends[1] - ends[0]) / 0.002
            assert vector(now.twist[i].linear) == pytest.approx(speed, abs=6e-3)
            turn = rotation(after.pose[i]) @ rotation(before.pose[i]).T / 0.004
            spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0],
                             turn[1, 0] - turn[0, 1]])  # fmt: skip
            assert vector(now.twist[i].angular) == pytest.approx(spin, abs=6e-3)
            assert np.linalg.norm(speed) > 1.0
    delete("swing")


def vector(message) -> np.ndarray:
    return np.array([message.x, message.y, message.z])


def rotation(pose: Pose) -> np.ndarray:
    q = pose.orientation
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_spawn_model_script_with_all_its_options(world, tmp_path):
    """-reference_frame, -J, -wait, -unpause, -package_to_model, -b; exit status on refusal."""
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    script = ["rosrun", "aras_sim_bridge", "spawn_model", "-urdf", "-file", str(file)]
    plate = SHAPES.partition('<link name="leg"')[0] + "</model></sdf>"
    spawn("stand", plate, "sdf", initial_pose=at(0, 6, 5, math.pi / 2))
    bound = subprocess.Popen(
        [*script, "-model", "arm", "-wait", "late", "-reference_frame", "stand::top", "-x", "1",
         "-z", "2", "-Y", "0.5", "-J", "swing", "0.25", "-package_to_model", "-b"],
        env=world.master.environment,
    )  # fmt: skip
    try:
        call("unpause_physics", Empty)
        call("pause_physics", Empty)
        assert "arm" not in call("get_world_properties", GetWorldProperties).model_names
        spawn("late", BRICK, "sdf", initial_pose=at(9, 9, 5))

        def there() -> bool:
            step(1)  # model_states come with steps
            return call("get_joint_properties", GetJointProperties, "swing").position == (0.25,)

        wait_for(there, timeout=20.0, what="the arm", interval=0.1)
        assert place("arm")[:2] == pytest.approx((0, 7))
        again = world.master.run([*script, "-model", "arm", "-unpause"], check=False)
        assert again.returncode == 1
        assert "exists" in again.stdout + again.stderr
    finally:
        bound.send_signal(2)
        bound.wait(10.0)
    assert "arm" not in call("get_world_properties", GetWorldProperties).model_names
    delete("stand", "late")
    before = call("get_world_properties", GetWorldProperties).sim_time
    world.master.run([*script, "-model", "arm", "-unpause"])
    wait_for(lambda: call("get_world_properties", GetWorldProperties).sim_time > before,
             timeout=5.0, what="time")  # fmt: skip
    call("pause_physics", Empty)
    delete("arm")


def test_world_file_is_built(launch, tmp_path):
    """Models, lights, gravity and step of an SDF world; a model that cannot be is named."""
    lamp = LAMP.partition("<light")[2].partition("</sdf>")[0]
    brick = BRICK.partition("<model")[2].partition("</sdf>")[0]
    path = tmp_path / "room.world"
    path.write_text(
        f"""<sdf version="1.6"><world name="room"><gravity>0 0 -1</gravity>
        <physics type="ode"><max_step_size>0.002</max_step_size></physics>
        <model{brick}<light{lamp}<include><uri>model://ground_plane</uri></include></world></sdf>"""
    )
    launched = launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], own_master=True,
                      paused=True, world_name=path)  # fmt: skip
    run = launched.master.run
    run(["rosservice", "call", "--wait", "/gazebo/step_world", "1"])
    told = run(["rosservice", "call", "/gazebo/get_world_properties"]).stdout
    assert "sim_time: 0.002" in told
    assert told.index("brick") < told.index("ground_plane")
    light = run(["rosservice", "call", "/gazebo/get_light_properties", "given"]).stdout
    assert "attenuation_quadratic: 0.125" in light


def test_log_holds_no_traceback(world):
    assert "Traceback" not in world.output()
    assert "internal error" not in world.output()
