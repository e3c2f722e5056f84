"""Synchronised cameras, and stereo reconstruction from their images."""

import logging
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from aras_sim_bridge.camera.mounting import find_simultaneous
from aras_sim_bridge.description import world_file
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.simulation import Simulation, SimulationConfig

WORLDS = Path(__file__).parents[2] / "worlds"
sys.path.insert(0, str(WORLDS))

import model_folders  # noqa: E402


@pytest.fixture
def simulation(tmp_path, monkeypatch):
    """The saved world with a table below two eyes."""
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(model_folders.write(tmp_path)))
    found = world_file.load_world(str(WORLDS / "stereo_table.world"))
    assert all("ground_plane" in text for text in found.warnings)
    made = Simulation(SimulationConfig(ground_plane=False, lights=found.lights))
    world_file.populate(made.spawn, found)
    yield made
    made.close()


def pictures(simulation, count):
    """The next `count` frames of each camera."""
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
    for eye in (left, right):
        assert find_simultaneous(eye, simulation.cameras) == [left, right]
    (description,) = [m.description for n, m in simulation.world.models.items() if "head" in n]
    simulation.delete("stereo_head")
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


def test_eyes_of_two_heads_expose_each_head_by_itself(simulation):
    left, right = simulation.cameras
    other = {"robot_namespace": "other"}
    simulation.spawn(left.model.description, "twin",
                     cameras={"stereo": {"camera": {"left": other, "right": other}}})
    assert len(simulation.cameras) == 4
    assert find_simultaneous(left, simulation.cameras) == [left, right]
