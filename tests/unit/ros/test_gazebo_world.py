"""Services of gazebo_ros for lights, spawning and physics; state topics; errors."""

import math

import pytest
from dynamic_reconfigure.msg import BoolParameter, Config, DoubleParameter, IntParameter
from gazebo_msgs.msg import ModelState, ODEJointProperties, ODEPhysics
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3
from std_msgs.msg import ColorRGBA
from stepped_models import BALL, QUARTER, xyz

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.ros.control.manager_services import ManagerServices
from aras_sim_bridge.ros.gazebo_api.physics_properties import PhysicsProperties
from aras_sim_bridge.ros.gazebo_api.spawn_requests import find_namespace
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.reconfigure_parameters import PHYSICS_FIELDS
from aras_sim_bridge.ros.runtime.restart_record import RestartRecord
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation, SimulationConfig


def test_lights(api, call):
    sun = call("get_light_properties", "sun")
    assert sun.status_message == "GetLightProperties: got properties"
    pose = Pose(Point(1.0, 2.0, 3.0), QUARTER)
    given = {
        "light_name": "sun", "pose": pose, "diffuse": ColorRGBA(0.1, 0.2, 0.3, 0.4),
        "attenuation_constant": 0.5, "attenuation_linear": 0.6, "attenuation_quadratic": 0.7,
        "direction": Vector3(0.0, 0.0, -1.0), "specular": ColorRGBA(0.5, 0.6, 0.7, 0.8),
        "cast_shadows": True}
    assert call("set_light_properties", **given).status_message.endswith("set properties")
    sun = call("get_light_properties", "sun")
    assert (sun.diffuse.r, sun.diffuse.g, sun.diffuse.b, sun.diffuse.a) == (0.1, 0.2, 0.3, 0.4)
    attenuation = sun.attenuation_constant, sun.attenuation_linear, sun.attenuation_quadratic
    assert attenuation == (0.5, 0.6, 0.7)
    light = api.thread.simulation.lights["sun"]
    assert (light.direction, light.origin_xyz) == ((0.0, 0.0, -1.0), (1.0, 2.0, 3.0))
    assert (light.specular, light.cast_shadows) == ((0.5, 0.6, 0.7, 0.8), True)
    assert light.origin_rpy == pytest.approx((0.0, 0.0, math.pi / 2))
    answer = call("set_light_properties", **{**given, "direction": Vector3()})
    assert "the direction is unchanged" in answer.status_message
    assert "'sun'" in call("delete_light", "sun").status_message
    assert "sun" in call("delete_light", "sun", refused=True).status_message


SPOT = """<sdf version="1.6"><light name="spot" type="spot"><pose>0.5 0 1 0 0 0</pose>
  <diffuse>1 0.5 0.25 1</diffuse></light></sdf>"""


def test_a_light_is_spawned_where_it_is_asked_for(api, call, ball):
    answer = call("spawn_sdf_model", "lamp", SPOT, "", Pose(Point(1.0, 0.0, 0.0), QUARTER), "ball")
    assert answer.success
    light = api.thread.simulation.lights["lamp"]
    assert light.origin_xyz == pytest.approx((-0.5, 1.0, 101.0))
    assert light.origin_rpy == pytest.approx((0.0, 0.0, math.pi))
    assert call("get_light_properties", "lamp").diffuse.g == 0.5
    answer = call("spawn_sdf_model", "lamp", SPOT, "", Pose(), "", refused=True)
    assert "exists already" in answer.status_message


@pytest.mark.parametrize(("own", "requested", "namespace"), [
    ([], "/a/b/", "/a/b"), ([], "", ""), ([], "/", ""), (["", "mine/"], "/a", "/mine"),
    (["mine", "his"], "", "/mine")])
def test_controllers_are_in_the_namespace_of_the_plugin_or_of_the_request(
    own, requested, namespace
):
    plugins = "".join(
        "<gazebo><plugin name='c' filename='libgazebo_ros_control.so'>"
        f"<robotNamespace>{name}</robotNamespace></plugin></gazebo>" for name in own)
    description = parse_urdf(f"<robot name='r'><link name='l'/>{plugins}</robot>")
    assert find_namespace(description, requested) == namespace


def test_names_time_limits_and_settings_of_a_spawn(api, call):
    comment = BALL.replace("<robot", "<!-- package://nowhere --><robot")
    call("spawn_urdf_model", "x" * 256, comment, "", Pose(), "")
    assert api.thread.limits == [60.0]
    api.graph.set("~cameras/nobody/width", 3)
    camera = """<gazebo reference="l"><sensor type="camera" name="c"><camera><image>
      <width>8</width><height>6</height></image></camera></sensor></gazebo>"""
    call("spawn_urdf_model", "m", f'<robot name="m"><link name="l"/>{camera}</robot>', "", Pose(),
         "")
    assert any("/nobody belong to no camera" in line for line in api.graph.lines)


def test_a_model_comes_with_what_it_says(api, call, ball):
    model = '<?xml version="1.0"?><!-- a --><sdf version="1.6"><model name="m">' \
            "<pose>1 2 3 0 0 0</pose><static>true</static><link name='l'/></model></sdf>"
    call("spawn_sdf_model", "m", model, "", Pose(Point(0.5, 0.0, 0.0), QUARTER), "")
    there = call("get_model_state", "m", "").pose
    assert xyz(there.position) == pytest.approx((-1.5, 1.0, 3.0))  # the model's pose in the asked
    assert call("get_world_properties").model_names == ["ground_plane", "ball", "m"]


def test_physics_tells_what_was_set(api, call, step, ball):
    before = call("get_physics_properties")
    assert before.pause is True
    assert (before.time_step, before.gravity.z, before.ode_config.erp) == (0.001, -9.8, 0.2)
    ode = before.ode_config
    ode.sor_pgs_iters, ode.erp, ode.sor_pgs_rms_error_tol = 30, 0.5, 9.0
    call("set_physics_properties", 0.002, 250.0, Vector3(1.0, 2.0, -3.0), ode)
    after = call("get_physics_properties")
    assert (after.time_step, after.max_update_rate) == (0.002, 250.0)
    assert xyz(after.gravity) == (1.0, 2.0, -3.0)
    assert (after.ode_config.sor_pgs_iters, after.ode_config.erp) == (30, 0.5)
    assert after.ode_config.sor_pgs_rms_error_tol == 0.0
    assert api.thread.simulation.world.solver_iterations == 30
    assert api.thread.pacer.factor == pytest.approx(0.5)
    assert api.graph.parameters["/gazebo/gravity_x"] == 1.0
    assert step(10).sim_time.to_nsec() == 20_000_000
    twist = call("get_model_state", "ball").twist
    assert xyz(twist.linear) == pytest.approx((0.02, 0.04, -0.06), abs=1e-9)


STIFF = """<robot name="arm"><link name="world"/>
  <joint name="swing" type="revolute"><parent link="world"/><child link="rod"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="50" velocity="10"/></joint>
  <link name="rod"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="swing">
    <hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
    <actuator name="m"/></transmission>
  <gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo></robot>"""


def test_at_least_one_iteration_is_made_and_what_the_gains_do_not_bear_is_said(api, call):
    """Of 1 kg m²: 2 h D + h² P = 4 at 41.4 ms."""
    api.graph.parameters |= {
        "/arm/stiff/type": "effort_controllers/JointPositionController",
        "/arm/stiff/joint": "swing", "/arm/stiff/pid/p": 400.0, "/arm/stiff/pid/i": 0.0,
        "/arm/stiff/pid/d": 40.0}
    call("spawn_urdf_model", "arm", STIFF, "/arm", Pose(), "")
    robot = api.thread.simulation.robots["arm"]
    services = ManagerServices(robot, api.thread, RestartRecord(False))
    manager = "/arm/controller_manager"
    assert api.graph.call(f"{manager}/load_controller", "stiff").ok
    assert api.graph.call(f"{manager}/switch_controller", ["stiff"], [], 2).ok
    before = call("get_physics_properties")
    before.ode_config.sor_pgs_iters = 0
    told = ("model 'arm': the loaded PIDs are unstable at steps of 0.043 s: at the current joint "
            "positions they need 0.041 s")
    for seconds, warned in ((0.04, False), (0.043, True), (0.001, False)):
        answer = call("set_physics_properties", seconds, 250.0, before.gravity, before.ode_config)
        assert answer.status_message.startswith("SetPhysicsProperties: physics engine updated")
        assert (told in answer.status_message) is warned
    assert told in api.graph.lines[-1]
    assert api.thread.simulation.world.solver_iterations == 1
    assert call("get_physics_properties").ode_config.sor_pgs_iters == 0
    services.shutdown()


def test_fields_of_physics_are_gazebo_ros_s():
    free = ("double", 0.0, -100.0, 100.0)
    fields = {
        "time_step": ("double", 0.001, 0, 10), "max_update_rate": ("double", 60, 0, 1000),
        "gravity_x": free, "gravity_y": free, "gravity_z": ("double", -9.8, -100, 100),
        "auto_disable_bodies": ("bool", False, False, True),
        "sor_pgs_precon_iters": ("int", 0, 0, 10000), "sor_pgs_iters": ("int", 20, 0, 10000),
        "sor_pgs_w": ("double", 1.3, 0, 5), "sor_pgs_rms_error_tol": ("double", -1, -1, 10000),
        "cfm": ("double", 0, 0, 10), "erp": ("double", 0.2, 0, 10),
        "contact_surface_layer": ("double", 0.001, 0, 10),
        "contact_max_correcting_vel": ("double", 100, 0, 1e7),
        "max_contacts": ("int", 100, 0, 10000000)}
    found = {f.name: (f.type, f.default, f.minimum, f.maximum) for f in PHYSICS_FIELDS}
    assert found == fields and list(found) == list(fields)
    assert all(field.level == 1 for field in PHYSICS_FIELDS)


def test_the_update_rate_is_the_pace_by_the_step(graph):
    thread = SimulationThread(lambda: Simulation(SimulationConfig(time_step=0.002)), Pacer(0.5),
                              paused=True)
    thread.start()
    try:
        physics = PhysicsProperties("/gazebo", thread)
        told = physics.get_physics_properties(thread.simulation, None)
        assert told["max_update_rate"] == pytest.approx(250.0)
    finally:
        thread.stop()


def test_physics_by_reconfigure_in_part_and_in_full(api, call):
    config = Config(doubles=[DoubleParameter("gravity_z", -5.0), DoubleParameter("time_step", 99)],
                    ints=[IntParameter("sor_pgs_iters", 7)])
    answer = api.graph.call("/gazebo/set_parameters", config).config
    # 10 s is the field's limit and too long for the world: nothing was changed.
    assert {d.name: d.value for d in answer.doubles}["gravity_z"] == -9.8
    config.doubles.pop()
    api.graph.call("/gazebo/set_parameters", config)
    physics = call("get_physics_properties")
    assert (physics.gravity.z, physics.ode_config.sor_pgs_iters) == (-5.0, 7)
    assert (physics.time_step, physics.max_update_rate) == (0.001, 0.0)
    at_first = call("get_physics_properties").ode_config
    assert at_first == ODEPhysics(False, 0, api.thread.simulation.world.solver_iterations, 1.3, 0.0,
                                  0.001, 100.0, 0.0, 0.2, 20)
    wanted = {"time_step": 0.002, "max_update_rate": 70.0, "gravity_x": 1.0, "gravity_y": 2.0,
              "gravity_z": 3.0, "sor_pgs_w": 1.5, "sor_pgs_rms_error_tol": 0.5, "cfm": 0.1,
              "erp": 0.3, "contact_surface_layer": 0.25, "contact_max_correcting_vel": 7.0}
    whole = {"sor_pgs_precon_iters": 4, "sor_pgs_iters": 33, "max_contacts": 5}
    asked = Config(doubles=[DoubleParameter(*one) for one in wanted.items()],
                   ints=[IntParameter(*one) for one in whole.items()],
                   bools=[BoolParameter("auto_disable_bodies", True)])
    answer = api.graph.call("/gazebo/set_parameters", asked).config
    for kind in ("doubles", "ints", "bools"):
        told = {one.name: one.value for one in getattr(answer, kind)}
        assert told == {one.name: one.value for one in getattr(asked, kind)}
    told = call("get_physics_properties")
    assert told.ode_config == ODEPhysics(True, 4, 33, 1.5, 0.5, 0.25, 7.0, 0.1, 0.3, 5)
    assert (told.time_step, told.max_update_rate, *xyz(told.gravity)) == (0.002, 70.0, 1, 2, 3)
    kept = {**wanted, **whole, "auto_disable_bodies": True}
    assert {name: api.graph.parameters[f"/gazebo/{name}"] for name in kept} == kept


def test_states_are_published_while_somebody_listens(api, call, step, slider, ball):
    model_states = api.graph.publishers["/gazebo/model_states"]
    link_states = api.graph.publishers["/gazebo/link_states"]
    metrics = api.graph.publishers["/gazebo/performance_metrics"]
    step(1)
    assert not model_states.sent + link_states.sent + metrics.sent
    for publisher in (model_states, link_states):
        publisher.impl.connections.append(object())
    step(2)
    (models,), (links,) = model_states.sent, link_states.sent
    assert models.name == ["ground_plane", "slider", "ball"]
    assert xyz(models.pose[2].position) == pytest.approx((0.0, 0.0, 100.0), abs=1e-4)
    assert models.twist[2].linear.z == pytest.approx(-9.8 * 3e-3)
    assert links.name[1:] == ["slider::world", "slider::cart", "slider::box", "ball::ball"]
    assert links.pose[4].position.z == models.pose[2].position.z
    assert links.twist[4].linear.z == models.twist[2].linear.z


def test_metrics_tell_how_often_cameras_that_are_looked_at_draw(api, monkeypatch):
    api.thread.pace = 0.5
    simulation = api.thread.simulation
    api.thread.step(2, 60.0)
    settings = {"parent": "world", "pose": [0.0] * 6, "width": 8, "height": 6, "update_rate": 20.0}
    camera = api.thread.call(lambda: simulation.add_camera("c", settings))
    metrics = api.graph.publishers["/gazebo/performance_metrics"]
    metrics.impl.connections.append(object())
    now = [1e9]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    for wanted, fps in ((False, 0.0), (True, 10.0)):
        camera.enabled = wanted
        now[0] += 1.0
        api.states.after_batch(simulation)
        message = metrics.sent[-1]
        assert (message.header.stamp.to_nsec(), message.real_time_factor) == (2_000_000, 0.5)
        (told,) = message.sensors
        assert (told.name, told.sim_update_rate, told.real_update_rate) == ("c", 20.0, 10.0)
        assert told.fps == fps


def test_metrics_and_the_real_time_factor_have_their_rates(api, monkeypatch):
    ((period, tell),) = api.graph.timers
    assert period.to_sec() == 1.0
    api.thread.pacer.restart(0)
    tell(None)
    factor = api.graph.publishers["/gazebo/real_time_factor"]
    assert factor.sent == [0.0]
    factor.unregister()
    tell(None)  # a second comes round while the node ends: no traceback
    assert factor.sent == [0.0]
    now = [0.5]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    metrics, told = api.graph.publishers["/gazebo/performance_metrics"], []
    metrics.impl.connections.append(object())
    for now[0] in (0.5, 0.6875, 0.75, 0.875, 0.96875):
        api.states.after_batch(api.thread.simulation)
        told.append(len(metrics.sent))
    assert told == [1, 1, 2, 2, 3]


HINGE = "<axis><xyz>0 1 0</xyz></axis>"
BARS = ("<sdf version='1.6'><model name='m'><link name='a'/><link name='b'><pose>0 0 1 0 0 0</pose>"
        "</link><link name='c'><pose>1 0 1 0 0 0</pose></link><link name='free'><pose>3 0 0 0 0 0"
        "</pose></link><joint name='bolt' type='fixed'><parent>world</parent><child>a</child>"
        "</joint>" + "".join(
            f"<joint name='{name}' type='revolute'><parent>{parent}</parent><child>{child}</child>"
            f"{HINGE}</joint>" for name, parent, child in (
                ("j", "a", "b"), ("k", "b", "c"), ("back", "a", "c"))) + "</model></sdf>")


def test_a_model_of_several_bodies_and_with_a_closed_chain_is_one(call):
    """Its free body and the joint that closes its chain keep their names."""
    call("spawn_sdf_model", "m", BARS, "", Pose(Point(0.0, 0.0, 5.0), Quaternion(w=1.0)), "")
    assert call("get_world_properties").model_names == ["ground_plane", "m"]
    answer = call("get_model_properties", "m")
    assert answer.body_names == ["world", "a", "b", "c", "free"]
    assert answer.joint_names == ["bolt", "j", "back", "k"]
    state = call("get_link_state", "m::free", "m").link_state
    assert (state.pose.position.x, state.pose.position.z) == pytest.approx((3.0, 0.0), abs=1e-6)
    for name in ("k", "m::k"):
        joint = call("get_joint_properties", name)
        assert (joint.type, joint.position) == (1, [pytest.approx(0.0, abs=1e-6)])
    said = call("set_joint_properties", "k", ODEJointProperties(), refused=True).status_message
    assert "'k' closes a kinematic loop and can only be read" in said
    there = Pose(Point(0.0, 1.0, 5.0), Quaternion(w=1.0))
    call("set_model_state", ModelState("m", there, Twist(), ""))
    state = call("get_link_state", "m::free", "").link_state
    assert (state.pose.position.x, state.pose.position.y) == pytest.approx((3.0, 1.0), abs=1e-6)
    assert call("delete_model", "m::free", refused=True)
    call("delete_model", "m")
    call("get_link_state", "m::free", "", refused=True)
