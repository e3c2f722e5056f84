"""Cameras of a simulation: later models, settings, and errors."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from aras_sim_bridge.camera import CameraSensor, mounting
from aras_sim_bridge.description import Light, parse_urdf
from aras_sim_bridge.errors import CameraError, RenderingError
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Pose

BOX = """<robot name="box"><link name="box">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><box size="0.1 0.4 0.4"/></geometry></visual></link>
  <gazebo reference="box"><turnGravityOff>true</turnGravityOff><material>Gazebo/Black</material>
  </gazebo></robot>"""
MS = 1_000_000
PLACE = {"parent": "world", "pose": [0, 0, 1, 0, 0, 0], "width": 32, "height": 24}


@pytest.fixture
def simulation():
    made = Simulation()
    yield made
    made.close()


def run(simulation, steps) -> None:
    for _ in range(steps):
        simulation.step()


def test_triggers_count_from_when_somebody_looks(simulation):
    camera = simulation.add_camera("c", {**PLACE, "trigger_topic": "go"})
    frames = []
    camera.on_frame = frames.append

    def trigger_and_step(steps):
        camera.trigger(simulation.time_ns, simulation.step_ns)
        run(simulation, steps)

    trigger_and_step(3)
    camera.enabled = True
    run(simulation, 3)
    assert not frames
    camera.enabled = False
    camera.enabled = True  # between two steps
    trigger_and_step(2)
    camera.trigger(simulation.time_ns, simulation.step_ns)
    camera.enabled = True  # another one looks as well
    run(simulation, 2)
    assert [frame.stamp_ns for frame in frames] == [7 * MS, 9 * MS]


def test_settings_are_found_by_name_and_the_rest_is_told():
    settings = {"a": {"b": {"width": 10}}, "c": {"parent": "world"}, "d": {"height": 3}}
    assert mounting.find_settings(settings, "a/b") == {"width": 10}
    assert mounting.find_settings(settings, "x/y") == {}
    assert [name for name, _ in mounting.find_world_cameras(settings)] == ["c"]
    assert mounting.find_unused_names(settings, {"a/b"}) == ["d"]
    only_effects = {"a": {"b": {"effects": {"noise_stddev": 5.0}}}}
    assert mounting.find_unused_names(only_effects, {"a/b"}) == []
    assert mounting.find_unused_names(only_effects, {"a"}) == []
    assert mounting.find_unused_names(only_effects, {"b"}) == ["a/b/effects"]
    both = {"seed": 3, "e": {"width": 3, "effects": {"gain": 2.0}}}
    assert mounting.find_unused_names(both, set()) == ["e"]
    assert mounting.derive_seed(0, "left") != mounting.derive_seed(0, "right")
    with pytest.raises(CameraError, match="width"):
        mounting.find_settings({"a": "width"}, "a")


@pytest.mark.parametrize(("key", "value", "words"), [
    ("widht", 3, "width"), ("effects", 5, "must be a mapping"), ("pose", "here", "m and rad"),
    ("pose", {"xyz": 5}, "3 finite numbers"),
    ("pose", {"xyz": [1, 2, 3, 4], "rpy": [5, 6]}, "3 finite"),
    ("pose", {"xyz": [0, 0, float("nan")]}, "must be a finite number"),
    ("link", "arm", "remove the key"), ("parent", "moon", "world"),
])
def test_a_wrong_setting_is_named(key, value, words):
    with pytest.raises(CameraError, match=words) as error:
        mounting.configure_world_camera("cam", {**PLACE, key: value}, {}, 0)
    assert "cam" in str(error.value) and key in str(error.value)


def test_a_wrong_setting_of_a_robots_camera_says_where_it_was_read():
    sensor = """<gazebo reference="box"><sensor type="camera" name="eye"><camera/>
      <plugin name="p" filename="libgazebo_ros_camera.so"><cameraName>lab/eye</cameraName></plugin>
      </sensor></gazebo></robot>"""
    (camera,) = parse_urdf(BOX.replace("</robot>", sensor)).cameras

    for settings, words in (({"parent": "world"}, "'parent' is only for cameras with 'parent: wor"),
                            ({"horizontal_fov": 0.0}, "camera 'eye': horizontal_fov is 0.0 rad; .*"
                             r"below 3.142 rad \(in the settings of camera 'lab/eye'\)")):
        with pytest.raises(CameraError, match=words):
            mounting.configure_robot_camera(camera, {"lab": {"eye": settings}}, {}, 0)


@pytest.mark.parametrize("pose", [
    [1, 2, 3, 0, 0, 0.5], "1 2 3 0 0 0.5", {"xyz": [1, 2, 3], "rpy": "0 0 0.5"},
])
def test_ways_to_write_a_pose(pose):
    _, placed = mounting.configure_world_camera("cam", {**PLACE, "pose": pose}, {}, 0)
    assert placed.xyz == (1, 2, 3)
    assert placed.quat == pytest.approx((0, 0, np.sin(0.25), np.cos(0.25)))
    for part in ("xyz", "rpy"):  # what is ignored is zero
        pose = {part: [0, 0, 0]}
        _, placed = mounting.configure_world_camera("cam", {**PLACE, "pose": pose}, {}, 0)
        assert (placed.xyz, placed.quat) == ((0, 0, 0), (0, 0, 0, 1))


class DamagedSensor(CameraSensor):
    """Sensor whose images cannot be rendered for a while."""

    def capture(self, world_T_link, time_ns):
        if self.is_damaged:
            raise RenderingError("mesh 'a.stl' is damaged")
        return super().capture(world_T_link, time_ns)


def test_what_cannot_be_drawn_costs_its_frames_only(simulation, caplog):
    """The simulation and the other cameras go on, the reason is told once, and so is the end."""
    broken, sound = simulation.add_camera("broken", PLACE), simulation.add_camera("sound", PLACE)
    got = {"broken": [], "sound": []}
    for camera in (broken, sound):
        camera.on_frame, camera.enabled = got[camera.sensor.config.name].append, True

    broken.sensor = DamagedSensor(broken.sensor.config, broken.sensor.renderer)
    with caplog.at_level(logging.INFO, "aras_sim_bridge.camera.mounting"):
        for is_damaged, counts in ((True, [0, 3]), (False, [3, 6])):
            broken.sensor.is_damaged = is_damaged
            run(simulation, 100)
            assert [len(frames) for frames in got.values()] == counts
    assert [r.getMessage() for r in caplog.records if "mounting" in r.name] == [
        "camera 'broken' delivers no images: mesh 'a.stl' is damaged",
        "camera 'broken' delivers images again",
    ]


def test_next_picture_is_told(simulation):
    assert simulation.next_image_ns() is None
    slow = simulation.add_camera("slow", {**PLACE, "update_rate": 30.0})
    fast = simulation.add_camera("fast", {**PLACE, "update_rate": 40.0, "latency": 0.0021})
    assert simulation.next_image_ns() is None  # nobody looks
    slow.enabled = fast.enabled = True
    told, frames = [], []
    for camera in (slow, fast):
        camera.on_frame = lambda frame, name=camera.sensor.config.name: frames.append(name)
    for _ in range(60):
        told.append(simulation.next_image_ns())
        simulation.step()
    # The fast one exposes at 25 and 50 ms and sends 2.1 ms later, the slow one at 33 1/3 ms.
    assert [n // 10_000 / 100 for n in dict.fromkeys(told)] == [25, 27.1, 33.33, 50, 52.1, 66.66]
    assert frames == ["fast", "slow", "fast"]


def test_a_reset_of_the_simulation_is_one_of_its_cameras(simulation):
    """They expose from time 0 on again, and what waited to be sent is of another world. Instants at
    which no subscriber listened are not made up for."""
    camera = simulation.add_camera("c", {**PLACE, "update_rate": 40.0, "latency": 0.003})
    stamps = []
    camera.on_frame = lambda frame: stamps.append((simulation.time_ns // MS, frame.stamp_ns // MS))
    camera.enabled = True
    for steps in (51, 54):
        simulation.reset_simulation()
        run(simulation, steps)
    for enabled, steps in ((False, 30), (True, 30), (False, 50), (True, 25)):
        camera.enabled = enabled
        run(simulation, steps)
    assert stamps == [(28, 25), (28, 25), (53, 50), (103, 100), (178, 175)]


def test_pictures_are_lit_by_the_sun_that_there_is(simulation):
    """By its colour, however opaque; ambient light stays where it goes."""
    sun = Light("sun", direction=(0.0, 0.0, -1.0), diffuse=(0.1, 0.2, 0.0, 1.0))
    camera = simulation.add_camera("c", {**PLACE, "pose": [0, 0, 1, 0, np.pi / 2, 0]})
    grey = []
    camera.on_frame, camera.enabled = lambda frame: grey.append(frame.image[12, 16]), True
    for light in (sun, replace(sun, diffuse=(0.5,) * 4), None):
        if light:
            simulation.set_light(light)
        else:
            simulation.delete_light("sun")
        run(simulation, 35)
    ambient = grey[2][0] / 0.4
    assert ambient > 100
    expected = ambient * np.array([[0.5, 0.6, 0.4], [0.9] * 3, [0.4] * 3])
    assert np.abs(grey - expected).max() <= 2


@pytest.mark.parametrize("kind", ["camera", "depth", "multicamera"])
def test_intrinsics_of_a_lens_are_drawn_and_published(simulation, kind):
    """Gazebo counts cx and cy from the image's corner; a pixel's middle has whole numbers here."""
    eye = (f"<gazebo reference='eye'><sensor name='s' type='{kind}'><camera name='left'>"
           "<horizontal_fov>1</horizontal_fov><image><width>64</width><height>48</height></image>"
           "<lens><intrinsics><fx>30</fx><fy>40</fy><cx>30</cx><cy>20</cy></intrinsics></lens>"
           "</camera></sensor></gazebo>")
    simulation.spawn(parse_urdf(BOX), "box", pose=Pose((1.05, 0.0, 1.0)))
    simulation.spawn(parse_urdf(f"<robot name='r'><link name='eye'/>{eye}</robot>"), "r",
                     pose=Pose((0.0, 0.0, 1.0)))
    (camera,) = simulation.cameras
    assert camera.sensor.info.K.tolist() == [[30, 0, 29.5], [0, 40, 19.5], [0, 0, 1]]
    frames = []
    camera.on_frame, camera.enabled = frames.append, True
    while not frames:
        simulation.step()
    rows, columns = np.nonzero(frames[0].image[..., 0] < 50)
    # 0.4 m at 1 m, about the principal point
    assert (np.ptp(columns) + 1, np.ptp(rows) + 1) == (12, 16)
    assert (columns.mean(), rows.mean()) == pytest.approx((29.5, 19.5), abs=0.01)
