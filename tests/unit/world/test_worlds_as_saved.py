"""Three worlds saved by Gazebo: poses of `<state>`, and distances by their two eyes."""

import logging
import sys
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from aras_sim_bridge.camera.mounting import find_simultaneous
from aras_sim_bridge.description import world_file
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base.poses import Pose

WORLDS = Path(__file__).parents[2] / "worlds"
sys.path.insert(0, str(WORLDS))

import model_folders  # noqa: E402


@pytest.fixture
def load(tmp_path, monkeypatch):
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(model_folders.write(tmp_path)))
    made = []

    def read(name):
        found = world_file.load_world(str(WORLDS / f"{name}.world"))
        made.append(Simulation(SimulationConfig(
            found.time_step, found.gravity, ground_plane=False, lights=found.lights)))
        made[-1].time_ns = found.time_ns
        world_file.populate(made[-1].spawn, found)
        return made[-1], found

    yield read
    for simulation in made:
        simulation.close()


def pose_of(element):
    values = [float(value) for value in element.find("pose").text.split()]
    return Pose.from_rpy(values[:3], values[3:])


def saved(name):
    """(model, link or '') -> pose of a world's state; links of inner models as inner::link."""

    def links(node, prefix):
        for link in node.findall("link"):
            yield prefix + link.get("name"), pose_of(link)
        for inner in node.findall("model"):
            yield from links(inner, f"{prefix}{inner.get('name')}::")

    state = ElementTree.parse(WORLDS / f"{name}.world").getroot().find("world/state")
    found = {}
    for model in state.findall("model"):
        found[model.get("name"), ""] = pose_of(model)
        found |= {(model.get("name"), link): pose for link, pose in links(model, "")}
    return found


@pytest.mark.parametrize(("name", "count", "time_ns"), [
    ("stereo_table", 4, 41_260_000_000), ("arm_cell", 6, 12_345_000_000),
    ("storeroom", 4, 7_001_000_000)])
def test_models_stand_where_the_state_puts_them(make, load, name, count, time_ns):
    simulation, found = load(name)
    assert found.time_ns == time_ns
    assert all(text.endswith("not supported") for text in found.warnings)
    expected = saved(name)
    assert sum(not link for _, link in expected) == count
    for (name_, link), pose in expected.items():
        model = simulation.world.model(name_)
        if link != model.description.root:  # its frame is the model's, as the README says
            stands = model.link_pose(link) if link else model.pose()
            np.testing.assert_allclose(stands.matrix(), pose.matrix(), atol=1e-5)
    make.step(simulation, 20)


@pytest.fixture
def simulation(load):
    simulation, found = load("stereo_table")
    simulation.time_ns = 0
    return simulation


def pictures(simulation, count):
    frames = [[] for _ in simulation.cameras]
    for camera, found in zip(simulation.cameras, frames, strict=True):
        camera.on_frame, camera.enabled = found.append, True
    while any(len(found) < count for found in frames):
        simulation.step()
    return frames


def test_disparity_gives_the_distance_of_the_table(simulation):
    left, right = pictures(simulation, 2)
    assert [f.stamp_ns for f in left] == [f.stamp_ns for f in right] == [66_666_667, 133_333_333]
    grey = [cv2.cvtColor(f.image, cv2.COLOR_RGB2GRAY) for f in (left[0], right[0])]
    matcher = cv2.StereoSGBM_create(0, 96, 7, P1=8 * 49, P2=32 * 49, uniquenessRatio=10)
    disparity = matcher.compute(*grey) / 16.0
    P = simulation.cameras[1].sensor.info.P
    assert P[0, 3] == pytest.approx(-0.06 * P[0, 0])
    assert simulation.cameras[0].sensor.info.P[0, 3] == 0.0
    distance = -P[0, 3] / disparity[disparity > 1.0]  # as stereo nodes reckon
    top = 0.7 + model_folders.SIZES["bench"][2] / 2
    true = 1.52 - top
    assert np.median(distance) == pytest.approx(true, rel=0.01)
    assert np.mean(abs(distance / true - 1.0) < 0.01) > 0.7  # the rest: the wedge and the ground


def test_the_rate_of_one_eye_is_that_of_both(simulation, caplog):
    left, right = simulation.cameras
    description, other = left.model.description, {"robot_namespace": "other"}
    simulation.spawn(description, "twin",
                     cameras={"stereo": {"camera": {"left": other, "right": other}}})
    for eye in (left, right):  # each head by itself
        assert find_simultaneous(eye, simulation.cameras) == [left, right]
    for name in ("twin", "stereo_head"):
        simulation.delete(name)
    with caplog.at_level(logging.WARNING):
        simulation.spawn(description, "head", cameras={
            "stereo": {"camera": {"right": {"update_rate": 20.0}}}})
    (line,) = [text for text in caplog.messages if "same shutter" in text]
    assert "'stereo_right'" in line and "15 Hz instead of 20 Hz" in line
    assert [camera.sensor.rate for camera in simulation.cameras] == [15.0, 15.0]
    with pytest.raises(CameraError, match="rate is 0.0 Hz"):
        simulation.cameras[0].sensor.set_rate(0.0, 0, simulation.step_ns)
    frames = pictures(simulation, 3)
    assert [f.stamp_ns for f in frames[0]] == [f.stamp_ns for f in frames[1]]
