"""What a link looks like: Gazebo's materials by name; names that Gazebo does not have."""

import pytest

from aras_sim_bridge.description import parse_sdf, parse_urdf
from aras_sim_bridge.description.gazebo_materials import COLOURS, WHITE
from aras_sim_bridge.simulation import Simulation

BOX = "<geometry><box size='1 1 1'/></geometry>"
SDF_BOX = "<geometry><box><size>1 1 1</size></box></geometry>"


def painted(name):
    """A URDF and an SDF whose link has this material."""
    yield parse_urdf(f"<robot name='r'><link name='a'><visual>{BOX}</visual></link>"
                     f"<gazebo reference='a'><material>{name}</material></gazebo></robot>")
    yield parse_sdf(f"<sdf><model name='r'><static>1</static><link name='a'><visual name='v'>"
                    f"{SDF_BOX}<material><script><name>{name}</name></script></material></visual>"
                    "</link></model></sdf>")


def test_gazebo_s_materials_are_known():
    for description in painted("Gazebo/Black"):
        assert description.colours == {"a": (0.0, 0.0, 0.0, 1.0)}
        assert not description.warnings
    assert COLOURS["Gazebo/Orange"] == (1.0, 0.5088, 0.0468, 1.0)


LIGHTS = {"Red": "r", "Green": "g", "Blue": "b", "Yellow": "rg", "Purple": "rb",
          "Turquoise": "gb", "White": "rgb", "Black": ""}


@pytest.mark.parametrize("name", LIGHTS)
def test_pure_colours_are_what_they_are_called(name):
    pure = tuple(float(light in LIGHTS[name]) for light in "rgb")
    assert COLOURS[f"Gazebo/{name}"] == (*pure, 1.0)
    for ending, alpha in (("Glow", 1.0), ("Transparent", 0.5)):
        if f"Gazebo/{name}{ending}" in COLOURS:
            assert COLOURS[f"Gazebo/{name}{ending}"] == (*pure, alpha)


def test_all_other_colours_are_of_their_hue():
    grey = {name for name, (r, g, b, _) in COLOURS.items() if r == g == b}
    called = {name for name in COLOURS if any(word in name for word in (
        "Grey", "Gray", "White", "Black", "Road", "Residential"))}
    assert grey == called
    light = [sum(COLOURS[f"Gazebo/{name}"][:3]) for name in (
        "Black", "FlatBlack", "DarkGrey", "Road", "Residential", "Grey", "LightGrey", "White")]
    assert light == sorted(light) and len(set(light)) == len(light)
    assert COLOURS["Gazebo/DarkGrey"] == COLOURS["Gazebo/DarkGray"]
    assert COLOURS["Gazebo/Grey"] == COLOURS["Gazebo/Gray"]
    for name in ("RedBright", "ZincYellow", "Orange", "Gold", "Wood", "WoodFloor", "Bricks"):
        r, g, b, alpha = COLOURS[f"Gazebo/{name}"]
        assert r > g > b and alpha == 1.0, name
    r, g, b, _ = COLOURS["Gazebo/DarkYellow"]
    assert r == g > b == 0.0
    r, g, b, _ = COLOURS["Gazebo/SkyBlue"]
    assert r < g < b
    r, g, b, _ = COLOURS["Gazebo/Indigo"]
    assert g == 0.0 < r < b
    assert all(0.0 <= part <= 1.0 for rgba in COLOURS.values() for part in rgba)
    see_through = {name for name, rgba in COLOURS.items() if rgba[3] != 1.0}
    assert see_through == {name for name in COLOURS if name.endswith("Transparent")}


@pytest.mark.parametrize("name, nearest", [
    ("Gazebo/Chrome", "Gazebo/"), ("Black", "Gazebo/Black"), ("Gazebo/Blak", "Gazebo/Black"),
    ("Mine/Gold", "Gazebo/Gold"),
])
def test_an_unknown_material_is_white_with_a_warning_and_costs_no_robot(name, nearest):
    for description in painted(name):
        assert description.colours == {"a": WHITE}
        (warning,) = description.warnings
        assert f"link 'a': material '{name}'" in warning
        assert f"The nearest is '{nearest}" in warning
        simulation = Simulation()
        simulation.spawn(description, "r")
        assert "r" in simulation.world.models
        simulation.close()
