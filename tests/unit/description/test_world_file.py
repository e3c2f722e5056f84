"""World files: physics, models and lights as written, otherwise Gazebo's defaults."""

import math
from dataclasses import astuple, replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from aras_sim_bridge.description import read_sdf, world_file
from aras_sim_bridge.description.lights import check_light
from aras_sim_bridge.description.types import SUN
from aras_sim_bridge.errors import DescriptionError, SimError, WorldError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_base import safe_xml

WORLDS = Path(__file__).parents[2] / "worlds"

BOX = ("<model name='{}'><pose>1 2 3 0 0 0.5</pose><static>1</static><link name='a'>"
       "<collision name='c'><geometry><box><size>1 1 1</size></box></geometry></collision></link>"
       "</model>")


def test_what_a_world_is_without_a_file_and_with_one(read):
    found = world_file.load_world("")
    assert (found.time_step, found.gravity, found.update_rate) == (0.001, (0, 0, -9.8), 1000.0)
    assert found.ground_plane and found.lights == (SUN,) and not found.models
    found = read("<gravity>1 2 3</gravity><physics><max_step_size>.002</max_step_size>"
                  "<real_time_update_rate>500</real_time_update_rate></physics>" + BOX.format("m")
                  + "<light name='l' type='point'/><plugin filename='x.so'/>")
    assert (found.time_step, found.gravity, found.update_rate) == (0.002, (1, 2, 3), 500.0)
    assert not found.ground_plane
    assert [m.name for m in found.models] == ["m"] and [i.name for i in found.lights] == ["l"]
    assert found.warnings == ("world: plugin 'x.so' is ignored, because it is not known",)
    old = "<physics><gravity>0 0 -1</gravity></physics>"
    for text, gravity in ((old, (0, 0, -1)), ("<physics/>", (0, 0, -9.8)),
                          (old + "<gravity>1 2 3</gravity>", (1, 2, 3))):
        found = read(text)
        assert (found.time_step, found.gravity, found.update_rate) == (0.001, gravity, 1000.0)


def test_models_are_put_where_the_file_has_them(read):
    found = read(BOX.format("m") + BOX.format("n"))
    simulation = Simulation(SimulationConfig(ground_plane=False))
    world_file.populate(simulation.spawn, found)
    assert list(simulation.world.models) == ["m", "n"]
    assert simulation.world.models["n"].pose().xyz == (1, 2, 3)
    assert simulation.world.models["n"].pose().quat[2] == pytest.approx(0.24740395925)
    with pytest.raises(SimError, match="model 'm' of the world file: a model named 'm' exists"):
        world_file.populate(simulation.spawn, found)
    simulation.close()


@pytest.mark.parametrize("inside, reason", [
    ("<physics><max_step_size>fast</max_step_size></physics>", "<max_step_size>: 'fast' is not a"),
    ("<gravity>0 0</gravity>", "<gravity>: needs 3 numbers"),
    ("<state><sim_time>1</sim_time></state>", "sim_time: needs 2 numbers"),
    *((f"<scene><{tag}>0 0 -1</{tag}></scene>", f"scene: {tag} 0 0 -1 must not be negative")
      for tag in ("ambient", "background")),
    ("<scene><aras:shadows>long</aras:shadows></scene>", "'long' is unknown; use none, hard, soft"),
])
def test_what_is_wrong_is_named_with_the_file(read, inside, reason):
    with pytest.raises(DescriptionError, match=reason) as refused:
        read(inside)
    assert "a.world" in str(refused.value)


def test_files_that_are_no_world(tmp_path):
    with pytest.raises(DescriptionError, match="the world file cannot be read"):
        world_file.load_world(str(tmp_path / "gone.world"))
    path = tmp_path / "a.world"
    path.write_text("<sdf/>")
    with pytest.raises(DescriptionError, match="has no <world> in <sdf>"):
        world_file.load_world(str(path))
    path.write_bytes(b"\xff\xfe<")
    with pytest.raises(DescriptionError, match="the world file cannot be read"):
        world_file.load_world(str(path))


DIRECTIONS = ("origin_xyz", "origin_rpy", "direction")
STRENGTHS = ("diffuse", "specular", "spot_inner", "spot_outer", "spot_falloff", *(
    f"attenuation_{part}" for part in ("constant", "linear", "quadratic", "range")))


@pytest.mark.parametrize("what", [*DIRECTIONS, *STRENGTHS])
def test_each_number_of_a_light_is_finite_and_each_strength_not_negative(what):
    value = getattr(SUN, what)
    count = len(value) if isinstance(value, tuple) else 0
    for bad, kind in ((math.nan, "is not finite"), (-math.inf, "is not finite"),
                      (-1e-9, "must not be negative")):
        light = replace(SUN, **{what: (*value[:-1], bad) if count else bad})
        if bad == -1e-9 and what in DIRECTIONS:
            assert check_light(light) is light
        else:
            with pytest.raises(WorldError, match=f"light 'sun': {what} .* {kind}"):
                check_light(light)
    dark = replace(SUN, **{what: (0.0,) * count if count else 0.0})
    if what != "direction":
        assert check_light(dark) is dark
    else:
        with pytest.raises(WorldError, match="direction is the zero vector"):
            check_light(dark)
    with pytest.raises(WorldError, match="has no name"):
        check_light(replace(SUN, name=""))


@pytest.mark.parametrize(("inside", "expected"), [
    ("", ((0.4, 0.4, 0.4, 1.0), (0.7, 0.7, 0.7, 1.0), False, "none")),
    ("<scene/>", ((0.4, 0.4, 0.4, 1.0), (0.7, 0.7, 0.7, 1.0), False, "none")),
    ("<scene><ambient>.1 .2 .3</ambient></scene>",
     ((0.1, 0.2, 0.3, 1.0), (0.7, 0.7, 0.7, 1.0), False, "none")),
    ("<scene><background>.1 .2 .3 0</background><aras:shadows>hard</aras:shadows></scene>",
     ((0.4, 0.4, 0.4, 1.0), (0.1, 0.2, 0.3, 0.0), False, "hard")),
    ("<scene><sky/><shadows>0</shadows></scene>",
     ((0.4, 0.4, 0.4, 1.0), (0.7, 0.7, 0.7, 1.0), True, "none"))])
def test_what_is_around_in_full(read, inside, expected):
    found = read(inside)
    assert astuple(found.scene) == expected
    assert astuple(found)[:5] == (0.001, (0.0, 0.0, -9.8), 1000.0, (), ())
    assert (found.ground_plane, found.warnings, found.time_ns) == (False, (), 0)


@pytest.mark.parametrize("count", [3, 7])
def test_a_mesh_that_many_models_lack_is_named_in_one_line(read, count):
    """A course of barriers gave 180 lines."""
    model = ("<model name='m{}'><link name='l'><visual name='v'><geometry><mesh><uri>gone.dae</uri>"
             "</mesh></geometry></visual></link></model>")
    found = read(*map(model.format, range(count)))
    told = [one for one in found.warnings if "gone.dae" in one]
    assert len(told) == (3 if count == 3 else 1)
    assert "model 'm0'" in told[0]
    assert told[0].endswith(" (and in 6 more places)") == (count == 7)


def test_what_a_model_warns_of_is_named_with_the_model(read):
    inside = "<model name='{0}'><link name='a'><sensor type='{1}'/></link></model>"
    found = read("<actor name='x'/>" + inside.format("m", "ray")
                  + inside.format("n", "sonar"))
    assert found.warnings == (
        "SDF: <actor> 'x' is ignored, because it is not supported",
        "model 'm': link 'a': a sensor is ignored, because its type 'ray' is not supported",
        "model 'n': link 'a': a sensor is ignored, because its type 'sonar' is not supported")


def test_files_that_a_world_names_lie_beside_it(tmp_path, monkeypatch):
    (tmp_path / "worlds").mkdir()
    (tmp_path / "part.stl").touch()
    (tmp_path / "worlds" / "own.stl").touch()
    path = tmp_path / "worlds" / "a.world"
    mesh = "<visual name='v'><geometry><mesh><uri>{}</uri></mesh></geometry></visual>"
    path.write_text("<sdf><world name='w'><model name='m'><link name='a'>"
                    + mesh.format("own.stl") + mesh.format("../part.stl")
                    + mesh.format("package://p/part.stl") + "</link></model></world></sdf>")
    monkeypatch.chdir(tmp_path)
    for name in (str(path), "worlds/a.world"):
        found = world_file.load_world(name, lambda package: str(tmp_path))
        assert found.warnings == ()
        assert [visual.geometry.filename for visual in found.models[0].links["a"].visuals] == [
            str(tmp_path / "worlds/own.stl"), *[str(tmp_path / "part.stl")] * 2]


@pytest.mark.parametrize("name", ["arm_cell", "stereo_table", "storeroom"])
def test_what_was_parsed_is_read_and_not_changed(tmp_path, monkeypatch, name):
    """A text that was parsed once may be read again, and gives the same."""
    for key in ("GAZEBO_MODEL_PATH", "HOME"):
        monkeypatch.setenv(key, str(tmp_path))
    root = safe_xml.parse((WORLDS / f"{name}.world").read_text(), "SDF")
    root.find("world").extend(ElementTree.fromstring(
        "<more><model name='lamp'><link name='a'/></model><joint name='j' type='fixed'><parent>"
        "world</parent><child>lamp</child></joint><population name='p'><model name='n'><pose>1 2 3"
        " 0 0 0</pose><link name='a'/></model><distribution><type>grid</type><rows>2</rows>"
        "</distribution></population><model name='o'><model name='p'><pose>1 2 3 0 0 0</pose>"
        "<link name='a'/></model></model></more>"))
    before = ElementTree.tostring(root)
    first = read_sdf(root)
    assert ElementTree.tostring(root) == before
    roots = {model.name: model.root for model in first.models}
    assert (roots["lamp"], roots["n_clone_1"], roots["o"]) == ("world", "a", "p::a")
    assert repr(read_sdf(root)) == repr(first)
