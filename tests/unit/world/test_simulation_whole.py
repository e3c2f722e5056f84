"""Simulation: lights, cameras, robots and sensors, and errors."""

from dataclasses import replace

import numpy as np
import pytest

from aras_sim_bridge.description import Light, parse_urdf
from aras_sim_bridge.description.types import SUN, SceneSettings
from aras_sim_bridge.errors import (
    CameraError,
    DescriptionError,
    SimError,
    UnknownModelError,
    WorldError,
)
from aras_sim_bridge.lighting import NO_LIGHT
from aras_sim_bridge.rendering import Lighting
from aras_sim_bridge.simulation import Simulation, SimulationConfig

EYE = {"parent": "world", "width": 8, "height": 6, "update_rate": 50.0, "pose": [0.0] * 6}
AMBIENT = (0.1, 0.2, 0.2, 0.9)
SCENE = SceneSettings((0.2, 0.2, 0.2, 0.9), (0.1, 0.2, 0.3, 1.0), True, "none")
INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)
CONTROL = '<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo>'
ROBOT = f'<robot name="r"><link name="base">{INERTIAL}</link>{{}}</robot>'
POSE = """<gazebo><plugin name="{0}" filename="libgazebo_ros_p3d.so"><bodyName>base</bodyName>
  <topicName>{0}</topicName><gaussianNoise>0.1</gaussianNoise></plugin></gazebo>"""
CAMERA = """<gazebo reference="base"><sensor type="camera" name="{0}"><camera><image>
  <width>8</width><height>6</height></image></camera>
  <plugin name="c" filename="libgazebo_ros_camera.so"><cameraName>{0}</cameraName></plugin>
  </sensor></gazebo>"""


@pytest.fixture
def make():
    """Factory of simulations without a ground; they are closed afterwards."""
    made = []

    def make(**given) -> Simulation:
        made.append(Simulation(SimulationConfig(**{"ground_plane": False, **given})))
        return made[-1]

    yield make
    for simulation in made:
        simulation.close()


def test_what_a_simulation_is_like_unless_it_is_told():
    plain = SimulationConfig()
    assert (plain.time_step, plain.gravity, plain.gui, plain.renderer, plain.seed) == (
        0.001, (0.0, 0.0, -9.8), False, "auto", 0)
    assert (plain.legacy_camera_info, plain.ground_plane, plain.lights) == (False, True, (SUN,))
    assert (plain.scene, plain.exposure) == (SceneSettings(), "unclipped")
    simulation = Simulation()
    assert simulation.config == plain and list(simulation.world.models) == ["ground_plane"]
    assert (simulation.time_ns, simulation.step_ns) == (0, 1_000_000)
    simulation.close()


GREY = Light("sun", direction=(0.1, 0.2, -0.3), diffuse=(0.5, 0.5, 0.5, 1.0))
AROUND = Lighting(
    diffuse=0.0,
    ambient=0.2,
    tint=(1.0,) * 3,
    background=(0.1, 0.2, 0.3, 1.0),
    sky=True,
    exposure="gazebo",
    shadows="none",
)
PLAIN = replace(AROUND, direction=(0.1, 0.2, -0.3), diffuse=0.5)
RED = replace(GREY, diffuse=(0.5, 0.4, 0.5, 1.0))
CAST, SOFT = replace(GREY, cast_shadows=True), replace(SCENE, shadows="soft")
BLUE, BLACK = replace(SCENE, ambient=AMBIENT), replace(SCENE, ambient=(0.0, 0.0, 0.0, 1.0))
TINTED = replace(AROUND, tint=(0.5, 1.0, 1.0))


@pytest.mark.parametrize(("lights", "scene", "sun"), [
    ((GREY,), SCENE, PLAIN), ((), SCENE, AROUND), ((RED,), SCENE, replace(AROUND, lights=(RED,))),
    ((replace(GREY, kind="point"),), SCENE,
     replace(AROUND, lights=(replace(GREY, kind="point"),))),
    ((GREY, replace(GREY, name="b")), SCENE,
     replace(AROUND, lights=(GREY, replace(GREY, name="b")))),
    ((CAST,), SCENE, PLAIN), ((GREY,), SOFT, replace(PLAIN, shadows="soft")),
    ((CAST,), SOFT, replace(AROUND, shadows="soft", lights=(CAST,))),
    ((GREY,), BLUE, replace(TINTED, lights=(GREY,))),
    ((), BLUE, replace(TINTED, lights=(NO_LIGHT,))),
    ((GREY,), BLACK, replace(PLAIN, ambient=0.0, tint=(0.0,) * 3)),
])  # fmt: skip
def test_the_light_of_pictures_is_one_white_sun_where_that_is_all(make, lights, scene, sun):
    assert make(lights=lights, scene=scene, exposure="gazebo").lighting == sun


def test_no_light_is_dark():
    assert NO_LIGHT.name == "none" and NO_LIGHT.diffuse == (0.0, 0.0, 0.0, 1.0)


def test_lights_come_change_and_go(make, caplog):
    simulation = make(lights=(GREY,))
    for k in range(16):
        simulation.set_light(replace(RED, name=f"l{k}"))
    assert len(simulation.lighting.lights) == 16 and simulation.lighting.lights[0].name == "sun"
    simulation.set_light(replace(RED, name="l15"))  # which is one too many still, and said before
    assert [record.args for record in caplog.records] == [("l15", 16)]
    simulation.delete_light("sun")
    assert [light.name for light in simulation.lighting.lights] == [f"l{k}" for k in range(16)]
    with pytest.raises(WorldError, match="light 'sun' does not exist; existing lights: l0, l1"):
        simulation.delete_light("sun")
    for k in range(16):
        simulation.delete_light(f"l{k}")
    assert simulation.lighting.diffuse == 0.0 and not simulation.lighting.lights
    with pytest.raises(WorldError, match="light 'sun' does not exist; existing lights: none"):
        simulation.light("sun")


def test_lights_that_change_are_seen_by_the_cameras_there_are(make):
    """A wall before two cameras, of which one is added later."""
    wall = '<visual><geometry><box size="0.1 9 9"/></geometry></visual>'
    simulation, means = make(lights=(), exposure="gazebo"), []
    simulation.spawn(parse_urdf(ROBOT.format(f"<link name='w'>{wall}</link><joint name='j' type="
                                             "'fixed'><parent link='base'/><child link='w'/>"
                                             "<origin xyz='2 0 0'/></joint>")), "wall")
    simulation.add_camera("eye", EYE)
    for light in (None, GREY, replace(GREY, diffuse=(0.9, 0.9, 0.9, 1.0)), None):
        if light is not None:
            simulation.set_light(light)
        elif simulation.lights:
            simulation.delete_light("sun")
        camera, frames = simulation.cameras[-1], []
        camera.on_frame, camera.enabled = frames.append, True
        while not frames:
            simulation.step()
        means.append(frames[0].image.mean())
        if len(simulation.cameras) == 1:
            simulation.add_camera("other", EYE)
    assert means[0] < means[1] < means[2] and means[3] == means[0], means


def test_cameras_of_one_name_and_of_none(make):
    simulation = make()
    with pytest.raises(WorldError, match="camera '/eye' does not exist; existing cameras: none"):
        simulation.camera("/eye")
    first = simulation.add_camera("eye", EYE)
    second = simulation.add_camera("lens", EYE)
    assert (simulation.camera("/eye"), simulation.camera("/lens")) == (first, second)
    assert (first.model, first.link) == (None, "world")
    with pytest.raises(WorldError, match="camera 'eye' does not exist; existing cameras: /eye, "
                                         "/lens"):
        simulation.camera("eye")
    with pytest.raises(CameraError, match="camera 'eye' cannot use the ROS name /eye, because"):
        simulation.add_camera("eye", EYE)
    with pytest.raises(CameraError, match="update_rate 2000 Hz is above the physics rate of 1000"):
        simulation.add_camera("fast", {**EYE, "update_rate": 2000.0})
    assert simulation.cameras == [first, second]


def test_a_model_has_one_control_plugin_and_a_namespace_of_its_own(make):
    simulation = make()
    twice = parse_urdf(ROBOT.format(CONTROL + CONTROL.replace('"c"', '"d"')))
    with pytest.raises(DescriptionError, match="'r' has 2 gazebo_ros_control plugins; keep one"):
        simulation.spawn(twice, "r")
    once = parse_urdf(ROBOT.format(CONTROL))
    simulation.spawn(once, "first")
    with pytest.raises(WorldError, match="'second' cannot use the robot namespace /, because "
                                         "model"):
        simulation.spawn(once, "second")
    simulation.spawn(parse_urdf(ROBOT.format("")), "plain")
    assert list(simulation.robots) == ["first"] and list(simulation.world.models) == [
        "first", "plain"]
    robot = simulation.robots["first"]
    assert (robot.name, robot.namespace, robot.model.name) == ("first", "", "first")


ARM = f"""<link name="arm">{INERTIAL}</link><joint name="j" type="revolute"><parent link="base"/>
  <child link="arm"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint><transmission name="t"><type>transmission_interface/SimpleTransmission</type>
  <joint name="j"><hardwareInterface>hardware_interface/PositionJointInterface</hardwareInterface>
  </joint>
  <actuator name="m"/></transmission>"""


def test_a_robot_whose_hardware_cannot_be_leaves_the_world_as_it_was(make):
    simulation, robot = make(), parse_urdf(ROBOT.format(ARM + CONTROL))
    wrong = {"gazebo_ros_control": {"pid_gains": {"j": {"p": "much"}}}}
    with pytest.raises(SimError, match="much"):
        simulation.spawn(robot, "r", parameters=wrong)
    assert not simulation.world.models and not simulation.robots
    simulation.spawn(robot, "r", joint_positions={"j": 0.25})
    assert simulation.world.models["r"].read_joints()[0] == pytest.approx([0.25])
    simulation.set_joint_positions("r", {"j": -0.5})
    assert simulation.world.models["r"].read_joints()[0] == pytest.approx([-0.5])
    with pytest.raises(WorldError, match="'s' does not exist; existing models: r"):
        simulation.set_joint_positions("s", {"j": 0.0})


def test_a_camera_that_comes_later_exposes_at_the_next_of_its_instants(make):
    simulation = make()
    for _ in range(30):
        simulation.step()
    camera = simulation.add_camera("eye", EYE)
    assert simulation.next_image_ns() is None
    camera.enabled = True
    assert simulation.next_image_ns() == 40_000_000


def test_sensors_have_noise_of_their_own_and_go_with_their_model(make):
    def readings(seed):
        simulation, found = make(seed=seed), []
        for name in ("one", "two"):
            text = POSE.format("a") + POSE.format("b") + CONTROL + CAMERA.format(name)
            simulation.spawn(parse_urdf(ROBOT.format(text)), name, namespace=f"/{name}/",
                             parameters={"c": {"type": "joint_state_controller/"
                                               "JointStateController", "publish_rate": 9.0}})
        for sensor in simulation.sensors:
            sensor.on_state = lambda reading: found.append(reading.twist.linear)
        for _ in range(2):
            simulation.step()
        return simulation, found

    simulation, noise = readings(9)
    assert noise == readings(9)[1] and len(np.unique(noise, axis=0)) == 4
    assert not set(noise) & set(readings(8)[1])
    manager = simulation.robots["one"].manager
    manager.load("c")
    cameras = simulation.cameras[1:]
    simulation.delete("one")
    assert not manager.list()  # it was shut down
    assert list(simulation.robots) == ["two"] == list(simulation.world.models)
    assert {sensor.model.name for sensor in simulation.sensors} == {"two"}
    assert len(simulation.sensors) == 2 and simulation.cameras == cameras and len(cameras) == 1
    with pytest.raises(UnknownModelError, match="model 'one' does not exist; existing models: two"):
        simulation.delete("one")
    simulation.delete("two")
    with pytest.raises(UnknownModelError, match="existing models: none"):
        simulation.delete("two")


def test_another_step_is_the_world_s_and_the_simulation_s(make):
    simulation = make()
    simulation.set_physics(0.0025, (1.0, 2.0, 3.0), 7)
    assert simulation.step_ns == 2_500_000 and simulation.world.time_step == 0.0025
    assert simulation.world.gravity == (1.0, 2.0, 3.0) and simulation.world.solver_iterations == 7
    for wrong in (0.0, float("nan")):
        with pytest.raises(WorldError):
            simulation.set_physics(wrong, (0.0, 0.0, 0.0), 7)
    assert simulation.step_ns == 2_500_000
    simulation.step()
    assert simulation.time_ns == 2_500_000


@pytest.mark.parametrize("root, image, taken", [
    ("eye", "image_raw", "/eye"), ("/eye/", "other", "/eye"),
    # Another root, but the pictures of both would come on one topic.
    ("eye/image_raw", "picture", "/eye/image_raw"), ("", "eye/image_raw", "/eye/image_raw"),
])
def test_two_cameras_of_one_name(make, caplog, root, image, taken):
    def camera(name, root, image="image_raw"):
        tag = CAMERA.format(name).replace(f"<cameraName>{name}", f"<imageTopicName>{image}"
                                          f"</imageTopicName><cameraName>{root}")
        return parse_urdf(ROBOT.format(tag))

    simulation = make()
    simulation.spawn(camera("a", "eye"), "first")
    simulation.spawn(camera("b", "else"), "mixed")
    assert len(simulation.cameras) == 2
    simulation.spawn(camera("b", root, image), "second")
    assert len(simulation.cameras) == 2
    (said,) = [r.getMessage() for r in caplog.records if r.levelname == "ERROR"]
    assert said.startswith("model 'second' is simulated without camera 'b': ")
    assert (f"camera 'b' cannot use the ROS name {taken}, because camera 'a' of model 'first' uses "
            "it"
            in said)
