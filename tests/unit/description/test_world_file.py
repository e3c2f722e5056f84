"""World files: physics, models and lights as written, Gazebo's defaults for the rest."""

import pytest

from aras_sim_bridge.description import world_file
from aras_sim_bridge.description.lights import SUN, checked_light
from aras_sim_bridge.errors import DescriptionError, SimError, WorldError
from aras_sim_bridge.simulation import Simulation, SimulationConfig

BOX = ("<model name='{}'><pose>1 2 3 0 0 0.5</pose><static>1</static><link name='a'>"
       "<collision name='c'><geometry><box><size>1 1 1</size></box></geometry></collision></link>"
       "</model>")


def world(tmp_path, inside):
    """The world file of this text, read."""
    path = tmp_path / "a.world"
    path.write_text(f"<sdf version='1.6'><world name='default'>{inside}</world></sdf>")
    return world_file.read(str(path))


def test_without_a_file_there_are_gazebo_s_ground_and_sun():
    found = world_file.read("")
    assert (found.time_step, found.gravity, found.update_rate) == (0.001, (0, 0, -9.8), 1000.0)
    assert found.ground_plane and found.lights == (SUN,) and not found.models


def test_a_file_says_all_itself(tmp_path):
    found = world(tmp_path, "<gravity>1 2 3</gravity><physics><max_step_size>.002</max_step_size>"
                  "<real_time_update_rate>500</real_time_update_rate></physics>" + BOX.format("m")
                  + "<light name='l' type='point'/><plugin filename='x.so'/>")
    assert (found.time_step, found.gravity, found.update_rate) == (0.002, (1, 2, 3), 500.0)
    assert not found.ground_plane
    assert [m.name for m in found.models] == ["m"] and [i.name for i in found.lights] == ["l"]
    assert found.warnings == ("world: plugin 'x.so' is not known; ignored",)
    old = world(tmp_path, "<physics><gravity>0 0 -1</gravity></physics>")
    assert (old.time_step, old.gravity, old.update_rate) == (0.001, (0, 0, -1), 1000.0)


def test_models_are_put_where_the_file_has_them(tmp_path):
    found = world(tmp_path, BOX.format("m") + BOX.format("n"))
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
    ("<light name='l' type='candle'/>", "type 'candle' is unknown; use directional"),
    ("<light name='l'/><light name='l'/>", "two lights are named 'l'"),
    (BOX.format("m") * 2, "two models are named 'm'"),
    ("<riverbed/>", "<riverbed> is not supported"),
    ("<state><sim_time>1</sim_time></state>", "sim_time: needs 2 numbers"),
])
def test_what_is_wrong_is_named_with_the_file(tmp_path, inside, reason):
    with pytest.raises(DescriptionError, match=reason) as refused:
        world(tmp_path, inside)
    assert "a.world" in str(refused.value)


def test_files_that_are_no_world(tmp_path):
    with pytest.raises(DescriptionError, match="the world file cannot be read"):
        world_file.read(str(tmp_path / "gone.world"))
    path = tmp_path / "a.world"
    path.write_text("<sdf/>")
    with pytest.raises(DescriptionError, match="there is no <sdf><world> in it"):
        world_file.read(str(path))
    path.write_bytes(b"\xff\xfe<")
    with pytest.raises(DescriptionError, match="the world file cannot be read"):
        world_file.read(str(path))


def test_a_light_s_numbers(tmp_path):
    (light,) = world(
        tmp_path, "<light name='l' type='directional'><pose>1 2 3 0 0 0</pose><diffuse>.1 .2 .3"
        "</diffuse><specular>.4 .5 .6 .7</specular><direction>0 3 -4</direction><attenuation>"
        "<constant>.1</constant><linear>.2</linear><quadratic>.3</quadratic></attenuation>"
        "<cast_shadows>1</cast_shadows></light>").lights
    assert (light.kind, light.origin_xyz) == ("directional", (1, 2, 3))
    assert (light.diffuse, light.specular) == ((0.1, 0.2, 0.3, 1), (0.4, 0.5, 0.6, 0.7))
    assert light.direction == pytest.approx((0, 0.6, -0.8))
    assert (light.attenuation_constant, light.attenuation_linear) == (0.1, 0.2)
    assert (light.attenuation_quadratic, light.cast_shadows) == (0.3, True)
    (bare,) = world(tmp_path, "<light name='l'/>").lights
    assert (bare.kind, bare.direction, bare.diffuse) == ("point", (0, 0, -1), (1, 1, 1, 1))


@pytest.mark.parametrize("changes, reason", [
    ({"name": ""}, "needs a name"), ({"direction": (0.0, 0.0, 0.0)}, "its direction is zero"),
    ({"diffuse": (1.0, -0.1, 0.0, 1.0)}, "diffuse .* must not be negative"),
    ({"attenuation_linear": float("nan")}, "attenuation_linear nan is not finite"),
    ({"origin_xyz": (0.0, float("inf"), 0.0)}, "origin_xyz .* is not finite"),
])
def test_lights_that_cannot_be(changes, reason):
    from dataclasses import replace
    assert checked_light(SUN) is SUN
    with pytest.raises(WorldError, match=reason):
        checked_light(replace(SUN, **changes))


def test_a_mesh_that_is_missing_is_left_out_and_named(tmp_path, monkeypatch):
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path))
    (tmp_path / "crate").mkdir()
    part = "<geometry><mesh><uri>model://{}</uri></mesh></geometry>"
    box = "<geometry><box><size>1 2 3</size></box></geometry>"
    path = tmp_path / "one.world"
    path.write_text(
        '<sdf version="1.6"><world name="w"><model name="m"><link name="l">'
        f'<visual name="a">{part.format("nowhere/a.dae")}</visual>'
        f'<visual name="b">{box}<material><diffuse>1 0 0 1</diffuse></material></visual>'
        f'<collision name="c">{part.format("crate/c.stl")}</collision>'
        f'<collision name="d">{box}</collision></link></model></world></sdf>')
    found = world_file.read(str(path))
    link = found.models[0].links["l"]
    assert [v.name for v in link.visuals] == ["b"]
    assert [c.name for c in link.collisions] == ["d"]
    first, second = found.warnings
    assert "visual 'a'" in first and "nowhere" in first and "left out" in first
    assert "collision 'c'" in second and "c.stl" in second
    path.write_text(path.read_text().replace("nowhere/a.dae", "crate/../../a.dae"))
    with pytest.raises(DescriptionError, match="climbs out"):
        world_file.read(str(path))
