"""Joint springs on fixed models, next to bodies that Bullet steps, and on free models."""

import math

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import World

MASS = "<inertial><mass value='{m}'/><inertia ixx='{i}' iyy='{i}' izz='{i}'/></inertial>"


def robot(root, kind="continuous", stiffness=40.0, rest=0.3, damping=0.0):
    """A link of 0.5 kg m² on a spring; the root is bolted where it is called world."""
    inside = "" if root == "world" else MASS.format(m=1.0, i=1.0)
    return parse_urdf(
        f"<robot name='r'><link name='{root}'>{inside}</link><link name='b'>"
        f"{MASS.format(m=0.5, i=0.5)}</link><joint name='j' type='{kind}'><parent link='{root}'/>"
        "<child link='b'/><axis xyz='0 0 1'/><limit lower='-9' upper='9' effort='9' velocity='9'/>"
        f"<dynamics damping='{damping}'/></joint><gazebo reference='j'><springStiffness>{stiffness}"
        f"</springStiffness><springReference>{rest}</springReference></gazebo></robot>")


@pytest.mark.parametrize("kind", ["continuous", "prismatic"])
@pytest.mark.parametrize(("root", "inertia"), [("world", 0.5), ("a", None)])
def test_a_mass_on_a_spring_swings_about_its_reference(kind, root, inertia):
    """At sqrt(k / I); a free base of 1 swings against it, with 1 and 0.5 in series."""
    inertia = inertia or 1.0 / (1.0 / 1.0 + 1.0 / 0.5)
    period = 2.0 * math.pi * math.sqrt(inertia / 40.0)
    with World(time_step=1e-4, gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(robot(root, kind), "r")
        made = 0
        for share, expected in ((0.25, 0.3), (0.5, 0.6), (1.0, 0.0)):
            while made < round(share * period / 1e-4):
                world.step()
                made += 1
            assert model.read_joints()[0][0] == pytest.approx(expected, abs=5e-3)


@pytest.mark.parametrize("root", ["world", "a"])
@pytest.mark.parametrize("stiffness", [1e3, 1e6, 1e9])
def test_a_stiff_spring_stays_stable(root, stiffness):
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(robot(root, stiffness=stiffness, damping=1.0), "r")
        for _ in range(3000):
            world.step()
        assert model.read_joints()[0][0] == pytest.approx(0.3, abs=2e-3)
