"""Collisions of the moving links of a model, without those of its base."""

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, World
from aras_sim_bridge.world.overlaps import find_overlaps

BOX = '<collision><geometry><box size="{}"/></geometry></collision>'
INERTIAL = """<inertial><mass value="1"/>
  <inertia ixx="0.01" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>"""
ROBOT = f"""<robot name="robot"><link name="world"/>
  <link name="base">{INERTIAL}{BOX.format("0.2 0.3 0.4")}</link>
  <joint name="bolts" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0 0 1"/></joint>
  <link name="slide">{INERTIAL}{BOX.format("0.1 0.12 0.14")}</link>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="slide"/>
    <origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/></joint></robot>"""


def test_only_links_that_joints_move_count_and_the_deepest_is_first():
    with World() as world:
        robot = world.spawn(parse_urdf(ROBOT), "robot")
        for name, x in (("at_base", 0.11), ("before", 0.57), ("above", 0.5)):
            text = f'<robot name="{name}"><link name="l">{INERTIAL}{BOX.format("0.1 0.1 0.1")}' \
                "</link></robot>"
            z = 1.115 if name == "above" else 1.0
            world.spawn(parse_urdf(text), name, Pose((x, 0.0, z), (0.0, 0.0, 0.0, 1.0)))
        found = find_overlaps(world, robot, before_step=True)
        places = [(one.link, one.model, one.other_link) for one in found]
        assert list(dict.fromkeys(places)) == [("slide", "before", "l"), ("slide", "above", "l")]
        assert found[0].depth == pytest.approx(0.03, abs=2e-3)
        assert found[-1].depth == pytest.approx(0.005, abs=2e-3)


def test_a_posture_is_judged_by_itself():
    """A contact of the posture before stayed, 0.1 m deep, as long as boxes overlapped."""
    plate = parse_urdf('<robot name="plate"><link name="l"><collision><geometry>'
                       '<box size="0.001 0.4 0.4"/></geometry></collision></link></robot>')
    with World() as world:
        robot = world.spawn(parse_urdf(ROBOT), "robot")
        world.spawn(plate, "plate", Pose((0.6, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)))
        depths = []
        for x in (0.0506, 0.1503, 0.0506):  # on its one side, on its other
            robot.set_joint_positions({"rail": x})
            depths.append(max(one.depth for one in find_overlaps(world, robot, before_step=True)))
        assert depths == pytest.approx([1.1e-3, 0.2e-3, 1.1e-3], abs=1e-6)


def test_without_a_posture_contacts_are_those_of_the_last_step():
    plate = parse_urdf('<robot name="plate"><link name="l"><collision><geometry>'
                       '<box size="0.02 0.4 0.4"/></geometry></collision></link></robot>')
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        robot = world.spawn(parse_urdf(ROBOT), "robot")
        world.spawn(plate, "plate", Pose((0.61, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)))
        robot.set_joint_positions({"rail": 0.0515})
        assert find_overlaps(world, robot) == []  # none was made
        (first, *_) = find_overlaps(world, robot, before_step=True)
        assert (first.link, first.model, first.depth) == ("slide", "plate", pytest.approx(1.5e-3))
        robot.set_joint_positions({"rail": -0.2})
        assert find_overlaps(world, robot)[0] == first
        assert find_overlaps(world, robot, before_step=True) == []
