"""What a link looks like: Gazebo's materials by name; names that Gazebo does not have."""

import pytest

from aras_sim_bridge.description import parse_sdf, parse_urdf
from aras_sim_bridge.description.gazebo_materials import COLOURS, WHITE
from aras_sim_bridge.simulation import Simulation, SimulationConfig

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
        simulation = Simulation(SimulationConfig(renderer="tiny"))
        simulation.spawn(description, "r")
        assert "r" in simulation.world.models
        simulation.close()
