"""Joints between the models of a world: fixed models, and joints that are left out."""

import numpy as np
import pytest

from aras_sim_bridge.description import world_file
from aras_sim_bridge.simulation import Simulation, SimulationConfig

BODY = "<collision name='c'><geometry><box><size>0.1 0.2 0.3</size></box></geometry></collision>"
LINK = "<link name='{}'><pose>{} 0 0.1 0 0 0.4</pose>{}</link>"
HINGE = ("<joint name='hinge' type='revolute'><pose>-0.3 0 0 0 0 0</pose><parent>base</parent>"
         "<child>arm</child><axis>"
         "<xyz>0 1 0</xyz></axis></joint>")


def model(name, height, static=0):
    return (f"<model name='{name}'><static>{static}</static><pose>1 2 {height} 0.1 0.2 0.3</pose>"
            f"{LINK.format('body', 0, BODY)}</model>")


def arm(height):
    return (f"<model name='arm'><pose>-3 0 {height} 0 0 0</pose>{LINK.format('base', 0, BODY)}"
            f"{LINK.format('arm', 0.5, BODY)}{HINGE}</model>")


def joint(parent, child, kind="fixed", name="j"):
    return (f"<joint name='{name}' type='{kind}'><parent>{parent}</parent><child>{child}</child>"
            "</joint>")


def fallen(found):
    """How far each model's last link comes down in 0.2 s, m; a free one falls by 0.196 m."""
    simulation = Simulation(SimulationConfig(ground_plane=False))
    world_file.populate(simulation.spawn, found)
    models = simulation.world.models
    seen = {name: "arm" if name == "arm" else "body" for name in models}
    before = {name: one.link_pose(seen[name]) for name, one in models.items()}
    put = {name: np.array(one.description.initial_pose[0]) for name, one in models.items()}
    for _ in range(200):
        simulation.step()
    down = {}
    for name, one in models.items():
        assert np.linalg.norm(before[name].xyz - put[name]) < 0.6  # it is put where it was
        down[name] = before[name].xyz[2] - one.link_pose(seen[name]).xyz[2]
    simulation.close()
    return down


@pytest.mark.parametrize(("parent", "child"), [
    ("world", "lamp::body"), ("lamp::body", "world"), ("table::body", "lamp::body"),
    ("lamp", "table")])
def test_what_is_fixed_to_what_stands_is_bolted_down(read, parent, child):
    found = read(model("table", 0.5, static=1), model("lamp", 2.0), model("loose", 4.0),
                 joint(parent, child))
    assert found.warnings == ()
    down = fallen(found)
    assert down["table"] == down["lamp"] == 0.0
    assert down["loose"] == pytest.approx(0.196, abs=2e-3)


def test_joints_of_a_world_of_what_hangs_and_of_what_is_static(read):
    found = read(model("lamp", 2.0), arm(5.0), joint("world", "lamp", name="a"),
                 joint("lamp::body", "arm::base", name="b"))
    assert found.warnings == ()
    down = fallen(found)
    assert down["lamp"] == 0.0 and down["arm"] > 0.01
    assert "hinge" in found.models[1].joints
    found = read(model("a", 0.5, 1), model("b", 2.0, 1), joint("a::body", "b::body"))
    assert found.warnings == () and all("world" not in m.links for m in found.models)


@pytest.mark.parametrize(("added", "reason"), [
    (joint("world", "lamp::body", "revolute"), "only a fixed joint can connect two models"),
    (joint("world", "ghost::body"), "there is no link 'ghost::body'"),
    (joint("world", "lamp::wick"), "there is no link 'lamp::wick'"),
    (joint("world", ""), "there is no link ''"),
    ("<joint name='j' type='fixed'/>", "there is no link ''"),
    (joint("arm::base", "lamp::body"), "neither of its models is fixed in the world"),
    (joint("world", "arm::arm"),
     "link 'arm' is the child of another joint; use the root link of 'arm'"),
    (joint("world", "arm::base").replace("'j'", "'hinge'"),
     "name is missing or is that of another joint"),
    (joint("world", "lamp::body", name=""), "name is missing or is that of another joint"),
    (joint("arm::arm", "lamp::body"), "neither of its models is fixed in the world")])
def test_a_joint_that_cannot_be_served_is_one_warning_and_the_rest_goes_on(read, added, reason):
    found = read(model("lamp", 2.0), arm(5.0), added)
    assert [m.name for m in found.models] == ["lamp", "arm"]
    (warning,) = found.warnings
    assert "of the world is ignored: " in warning and reason in warning
    down = fallen(found)
    assert down["lamp"] == pytest.approx(0.196, abs=2e-3)


def towered(top, bolted=True, kind="fixed"):
    """A model whose base is bolted to the world or not, with a link `top` on it."""
    bolt = "<joint name='bolt' type='fixed'><parent>world</parent><child>base</child></joint>"
    return (f"<model name='tower'><pose>1 2 3 0 0 0</pose>{LINK.format('base', 0, BODY)}"
            f"{LINK.format(top, 0.5, BODY)}{bolt if bolted else ''}<joint name='on' type='{kind}'>"
            f"<parent>base</parent><child>{top}</child></joint></model>")


@pytest.mark.parametrize(("tower", "end", "reason"), [
    (towered("top", bolted=False), "top", "link 'top' is the child of another joint"),
    (towered("top", kind="revolute"), "top", "link 'top' is the child of another joint"),
    (towered("top"), "base", ""), (towered("top", bolted=False), "base", ""),
    (towered("top", bolted=False), "", "")])
def test_what_stands_is_what_its_own_joint_bolts_to_the_world(read, tower, end, reason):
    """Not what another joint has, nor what a bolted link carries."""
    name = f"tower::{end}" if end else "tower"
    found = read(tower, joint("world", name))
    assert len(found.warnings) == bool(reason) and reason in "".join(found.warnings)
    if not reason:
        (tower,) = found.models
        (own,) = (one for one in tower.joints.values() if one.parent == "world")
        assert (own.child, own.kind) == ("base", "fixed")
