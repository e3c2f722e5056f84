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
INERTIAL = ('<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
            "</inertial>")
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
    assert SimulationConfig() == SimulationConfig(
        0.001, (0.0, 0.0, -9.8), gui=False, renderer="auto", seed=0, legacy_camera_info=False,
        ground_plane=True, lights=(SUN,), scene=SceneSettings(), exposure="unclipped")


GREY = Light("sun", direction=(0.1, 0.2, -0.3), diffuse=(0.5, 0.5, 0.5, 1.0))
AROUND = Lighting(diffuse=0.0, ambient=0.2, tint=(1.0,) * 3, background=(0.1, 0.2, 0.3, 1.0),
                  sky=True, exposure="gazebo", shadows="none")
PLAIN = replace(AROUND, direction=(0.1, 0.2, -0.3), diffuse=0.5)
POINT = replace(GREY, name="b", kind="point")
RED = replace(GREY, diffuse=(0.5, 0.4, 0.5, 1.0))
CAST, SOFT = replace(GREY, cast_shadows=True), replace(SCENE, shadows="soft")
BLUE, BLACK = replace(SCENE, ambient=AMBIENT), replace(SCENE, ambient=(0.0, 0.0, 0.0, 1.0))
TINTED = replace(AROUND, tint=(0.5, 1.0, 1.0))


@pytest.mark.parametrize(("lights", "scene", "sun"), [
    ((GREY,), SCENE, PLAIN), ((), SCENE, AROUND), ((RED,), SCENE, replace(AROUND, lights=(RED,))),
    ((POINT,), SCENE, replace(AROUND, lights=(POINT,))),
    ((GREY, POINT), SCENE, replace(AROUND, lights=(GREY, POINT))),
    ((CAST,), SCENE, PLAIN), ((GREY,), SOFT, replace(PLAIN, shadows="soft")),
    ((CAST,), SOFT, replace(AROUND, shadows="soft", lights=(CAST,))),
    ((GREY,), BLUE, replace(TINTED, lights=(GREY,))),
    ((), BLUE, replace(TINTED, lights=(NO_LIGHT,))),
    ((GREY,), BLACK, replace(PLAIN, ambient=0.0, tint=(0.0,) * 3)),
])  # fmt: skip
def test_the_light_of_pictures_is_one_white_sun_where_that_is_all(make, lights, scene, sun):
    assert make(lights=lights, scene=scene, exposure="gazebo").lighting == sun


def test_lights_come_change_and_go(make, caplog):
    simulation, names = make(lights=(GREY,)), [f"l{k}" for k in range(16)]
    for name in names:
        simulation.set_light(replace(RED, name=name))
    assert [light.name for light in simulation.lighting.lights] == ["sun", *names[:-1]]
    simulation.set_light(replace(RED, name="l15"))  # which is one too many still, and said before
    assert [record.args for record in caplog.records] == [("l15", 16)]
    simulation.delete_light("sun")
    assert [light.name for light in simulation.lighting.lights] == names
    with pytest.raises(WorldError, match="light 'sun' does not exist; existing lights: l0, l1"):
        simulation.delete_light("sun")
    for name in names:
        simulation.delete_light(name)
    assert simulation.lighting.diffuse == 0.0 and not simulation.lighting.lights
    with pytest.raises(WorldError, match="light 'sun' does not exist; existing lights: none"):
        simulation.light("sun")


def test_cameras_of_one_name_and_of_none(make):
    simulation = make()
    with pytest.raises(WorldError, match="camera '/eye' does not exist; existing cameras: none"):
        simulation.camera("/eye")
    for _ in range(30):
        simulation.step()
    first, second = (simulation.add_camera(name, EYE) for name in ("eye", "lens"))
    assert (simulation.camera("/eye"), simulation.camera("/lens")) == (first, second)
    assert (first.model, first.link, simulation.next_image_ns()) == (None, "world", None)
    first.enabled = True  # one that comes later exposes at the next of its instants
    assert simulation.next_image_ns() == 40_000_000
    with pytest.raises(WorldError, match="'eye' does not exist; existing cameras: /eye, /lens"):
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
    assert f"ROS name {taken}, because camera 'a' of model 'first' uses it" in said
