"""Three worlds saved by Gazebo load, and their models have the poses of `<state>`."""

import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from aras_sim_bridge.description import world_file
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base.poses import Pose

WORLDS = Path(__file__).parents[2] / "worlds"
sys.path.insert(0, str(WORLDS))

import model_folders  # noqa: E402


@pytest.fixture
def load(tmp_path, monkeypatch):
    """(simulation, world file) of a saved world."""
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(model_folders.write(tmp_path)))
    made = []

    def read(name):
        found = world_file.load_world(str(WORLDS / f"{name}.world"))
        simulation = Simulation(SimulationConfig(
            found.time_step, found.gravity, ground_plane=False, lights=found.lights))
        made.append(simulation)
        simulation.time_ns = found.time_ns
        world_file.populate(simulation.spawn, found)
        return simulation, found

    yield read
    for simulation in made:
        simulation.close()


def pose_of(element):
    values = [float(value) for value in element.find("pose").text.split()]
    return Pose.from_rpy(values[:3], values[3:])


def saved(name):
    """(model, link) -> pose of a world's state, links of inner models as inner::link; and of each
    model itself, as (model, '')."""

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
    ("storeroom", 4, 7_001_000_000),
])
def test_models_stand_where_the_state_puts_them(load, name, count, time_ns):
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
    for _ in range(20):
        simulation.step()
