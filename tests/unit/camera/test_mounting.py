"""Cameras of a simulation: later models, settings, and errors."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from aras_sim_bridge.camera import CameraSensor, mounting
from aras_sim_bridge.description import Light, parse_urdf
from aras_sim_bridge.errors import CameraError, DescriptionError, RenderingError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_sim_bridge.world import Pose

BOX = """<robot name="box"><link name="box">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><box size="0.1 0.4 0.4"/></geometry></visual></link>
  <gazebo reference="box"><turnGravityOff>true</turnGravityOff><material>Gazebo/Black</material>
  </gazebo></robot>"""
MS = 1_000_000
PLACE = {"parent": "world", "pose": [0, 0, 1, 0, 0, 0], "width": 32, "height": 24}


def test_a_model_spawned_while_the_camera_runs_is_seen():
    """At 30 Hz pictures fall between two steps, so the renderer is asked before and after one."""
    simulation = Simulation()
    camera = simulation.add_camera("c", PLACE)
    frames = []
    camera.on_frame, camera.enabled = frames.append, True
    for _ in range(70):
        simulation.step()
    assert frames[-1].image.min() > 100
    simulation.spawn(parse_urdf(BOX), "box", pose=Pose((0.5, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)))
    for _ in range(70):
        simulation.step()
    assert frames[-1].image.min() == 0
    simulation.close()


def test_triggers_count_from_when_somebody_looks():
    simulation = Simulation()
    camera = simulation.add_camera("c", {**PLACE, "trigger_topic": "go"})
    frames = []
    camera.on_frame = frames.append

    def trigger_and_step(steps):
        camera.trigger(simulation.time_ns, simulation.step_ns)
        for _ in range(steps):
            simulation.step()

    trigger_and_step(3)
    camera.enabled = True
    for _ in range(3):
        simulation.step()
    assert not frames
    camera.enabled = False
    camera.enabled = True  # between two steps
    trigger_and_step(2)
    camera.trigger(simulation.time_ns, simulation.step_ns)
    camera.enabled = True  # another one looks as well
    simulation.step()
    simulation.step()
    assert [frame.stamp_ns for frame in frames] == [7 * MS, 9 * MS]
    simulation.close()


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
    assert mounting.find_unused_names(
        {"seed": 3, "e": {"width": 3, "effects": {"gain": 2.0}}}, set()
    ) == ["e"]
    with pytest.raises(CameraError, match="width"):
        mounting.find_settings({"a": "width"}, "a")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("widht", 3, "width"), ("width", "3", "whole number"),
        ("depth", 1, "must be true or false"),
        ("xyz", [1, 2], "3 finite numbers"), ("effects", 5, "must be a mapping"),
        ("format", 8, "text"),
        ("camera_matrix", {"fx": 1}, "fy is missing"), ("pose", "here", "m and rad"),
        ("pose", {"xyz": 5}, "3 finite numbers"),
        ("pose", {"xyz": [1, 2, 3, 4], "rpy": [5, 6]}, "3 finite"),
        ("pose", {"xyz": [0, 0, float("nan")]}, "must be a finite number"),
        ("link", "arm", "remove the key"),
        ("parent", "moon", "world"), ("seed", 1.5, "whole number"),
    ],
)  # fmt: skip
def test_a_wrong_setting_is_named(key, value, words):
    with pytest.raises(CameraError, match=words) as error:
        mounting.configure_world_camera("cam", {**PLACE, key: value}, {}, 0)
    assert "cam" in str(error.value)
    assert key in str(error.value)


def test_a_wrong_setting_of_a_robots_camera_says_where_it_was_read():
    sensor = """<gazebo reference="box"><sensor type="camera" name="eye"><camera/>
      <plugin name="p" filename="libgazebo_ros_camera.so"><cameraName>lab/eye</cameraName></plugin>
      </sensor></gazebo></robot>"""
    (camera,) = parse_urdf(BOX.replace("</robot>", sensor)).cameras

    def refusal(settings):
        with pytest.raises(CameraError) as error:
            mounting.configure_robot_camera(camera, {"lab": {"eye": settings}}, {}, 0)
        return str(error.value)

    assert refusal({"horizontal_fov": 0.0}) == (
        "camera 'eye': horizontal_fov is 0.0 rad; with the lens pinhole it must be above 0 and "
        "below 3.142 rad (in the settings of camera 'lab/eye')"
    )
    assert "'parent' is only for cameras with 'parent: world'" in refusal({"parent": "world"})


@pytest.mark.parametrize("pose", [
    [1, 2, 3, 0, 0, 0.5], "1 2 3 0 0 0.5", {"xyz": [1, 2, 3], "rpy": "0 0 0.5"},
])
def test_ways_to_write_a_pose(pose):
    _, placed = mounting.configure_world_camera("cam", {**PLACE, "pose": pose}, {}, 0)
    assert placed.xyz == (1, 2, 3)
    assert placed.quat == pytest.approx((0, 0, np.sin(0.25), np.cos(0.25)))
    for part in ("xyz", "rpy"):  # what is ignored is zero
        _, placed = mounting.configure_world_camera(
            "cam", {**PLACE, "pose": {part: [0, 0, 0]}}, {}, 0
        )
        assert (placed.xyz, placed.quat) == ((0, 0, 0), (0, 0, 0, 1))


class DamagedSensor(CameraSensor):
    """Sensor whose images cannot be rendered for a while."""

    is_damaged = True

    def capture(self, world_T_link, time_ns):
        if self.is_damaged:
            raise RenderingError("mesh 'a.stl' is damaged")
        return super().capture(world_T_link, time_ns)


def test_what_cannot_be_drawn_costs_its_frames_only(caplog):
    """The simulation and the other cameras go on, the reason is told once, and so is the end."""
    simulation = Simulation(SimulationConfig())
    broken, sound = simulation.add_camera("broken", PLACE), simulation.add_camera("sound", PLACE)
    got = {"broken": [], "sound": []}
    for camera in (broken, sound):
        camera.on_frame, camera.enabled = got[camera.sensor.config.name].append, True

    broken.sensor = DamagedSensor(broken.sensor.config, broken.sensor.renderer)

    def run():
        for _ in range(100):
            simulation.step()
        return [len(frames) for frames in got.values()]

    with caplog.at_level(logging.INFO, "aras_sim_bridge.camera.mounting"):
        assert run() == [0, 3]
        broken.sensor.is_damaged = False
        assert run() == [3, 6]
    simulation.close()
    assert [r.getMessage() for r in caplog.records if "mounting" in r.name] == [
        "camera 'broken' delivers no images: mesh 'a.stl' is damaged",
        "camera 'broken' delivers images again",
    ]


def test_cameras_differ_in_their_noise():
    assert mounting.derive_seed(0, "left") != mounting.derive_seed(0, "right")


def test_next_picture_is_told():
    simulation = Simulation()
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
    simulation.close()


def test_instants_at_which_nobody_looked_are_not_made_up_for():
    """That picture would show a later world than its stamp says."""
    simulation = Simulation(SimulationConfig())
    camera = simulation.add_camera("c", {**PLACE, "update_rate": 40.0})
    stamps = []
    camera.on_frame = lambda frame: stamps.append(frame.stamp_ns // 1_000_000)
    for looked_at, steps in ((False, 30), (True, 30), (False, 50), (True, 20)):
        camera.enabled = looked_at
        for _ in range(steps):
            simulation.step()
    assert stamps == [50, 125]
    simulation.close()


def test_a_reset_of_the_simulation_is_one_of_its_cameras():
    """They expose from time 0 on again, and what waited to be sent is of another world."""
    simulation = Simulation(SimulationConfig())
    camera = simulation.add_camera("c", {**PLACE, "update_rate": 40.0, "latency": 0.003})
    stamps = []
    camera.on_frame = lambda frame: stamps.append((simulation.time_ns // MS, frame.stamp_ns // MS))
    camera.enabled = True
    for steps in (51, 54):
        simulation.reset_simulation()
        for _ in range(steps):
            simulation.step()
    assert stamps == [(28, 25), (28, 25), (53, 50)]
    simulation.close()


def test_pictures_are_lit_by_the_sun_that_there_is():
    """By its colour, however opaque; ambient light stays where it goes."""
    sun = Light("sun", direction=(0.0, 0.0, -1.0), diffuse=(0.1, 0.2, 0.0, 1.0))
    simulation = Simulation(SimulationConfig(lights=(sun,)))
    camera = simulation.add_camera("c", {**PLACE, "pose": [0, 0, 1, 0, np.pi / 2, 0]})
    grey = []
    camera.on_frame, camera.enabled = lambda frame: grey.append(frame.image[12, 16]), True
    for change in (lambda: None, lambda: simulation.set_light(replace(sun, diffuse=(0.5,) * 4)),
                   lambda: simulation.delete_light("sun")):
        change()
        for _ in range(35):
            simulation.step()
    ambient = grey[2][0] / 0.4
    assert ambient > 100
    expected = ambient * np.array([[0.5, 0.6, 0.4], [0.9] * 3, [0.4] * 3])
    assert np.abs(grey - expected).max() <= 2
    simulation.close()


@pytest.mark.parametrize("kind", ["camera", "depth", "multicamera"])
def test_intrinsics_of_a_lens_are_drawn_and_published(kind):
    """Gazebo counts cx and cy from the image's corner; a pixel's middle has whole numbers here."""
    eye = (f"<gazebo reference='eye'><sensor name='s' type='{kind}'><camera name='left'>"
           "<horizontal_fov>1</horizontal_fov><image><width>64</width><height>48</height></image>"
           "<lens><intrinsics><fx>30</fx><fy>40</fy><cx>30</cx><cy>20</cy></intrinsics></lens>"
           "</camera></sensor></gazebo>")
    simulation = Simulation(SimulationConfig(ground_plane=False))
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
    simulation.close()


@pytest.mark.parametrize(("kind", "inside", "reason"), [
    ("wideanglecamera", "<intrinsics/>", "<intrinsics> is ignored, because a wideanglecamera has "
                                         "none"),
    ("camera", "<type>equidistant</type>", "needs a wideanglecamera; this camera is drawn"),
])
def test_what_a_lens_has_in_vain_is_named(kind, inside, reason):
    made = parse_urdf(
        f"<robot name='r'><link name='eye'/><gazebo reference='eye'><sensor name='s' type='{kind}'>"
        f"<camera><lens>{inside}</lens></camera></sensor></gazebo></robot>")
    (warning,) = made.warnings
    assert reason in warning


def test_focal_lengths_of_a_lens_are_positive():
    with pytest.raises(DescriptionError, match="fx 0.0 and fy 277.0 are focal lengths in pixels"):
        parse_urdf("<robot name='r'><link name='eye'/><gazebo reference='eye'><sensor name='s' "
                   "type='camera'><camera><lens><intrinsics><fx>0</fx></intrinsics></lens></camera>"
                   "</sensor></gazebo></robot>")
