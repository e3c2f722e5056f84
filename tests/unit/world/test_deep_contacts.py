"""Deeply penetrating bodies are found, separate slowly, as in Gazebo, and are reported."""

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, World
from aras_sim_bridge.world.overlaps import find_overlaps

INERTIAL = """<inertial><mass value="1"/>
  <inertia ixx="0.01" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>"""
BOX = f"""<robot name="box"><link name="body">{INERTIAL}
  <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link></robot>"""


def chain(links: int) -> str:
    """A bolted arm of balls that hangs straight down, a tenth of a metre a link."""
    parts = ""
    for k in range(links):
        parent = f"l{k - 1}" if k else "world"
        parts += (f'<link name="l{k}">{INERTIAL}<collision><origin xyz="0 0 -0.05"/><geometry>'
                  '<sphere radius="0.02"/></geometry></collision></link>'
                  f'<joint name="j{k}" type="continuous"><parent link="{parent}"/>'
                  f'<child link="l{k}"/><origin xyz="0 0 -0.1"/><axis xyz="{k % 2} {1 - k % 2} 0"/>'
                  "</joint>")
    return f'<robot name="chain"><link name="world"/>{parts}</robot>'


def test_a_box_that_is_put_into_the_ground_leaves_it_at_gazebos_speed(world, ground, make, caplog):
    box = world.spawn(parse_urdf(BOX), "box", Pose((0.0, 0.0, 0.07)))
    make.step(world, 1000)
    assert box.pose().xyz[2] == pytest.approx(0.08, abs=1e-3)
    make.step(world, 3000)
    assert box.pose().xyz[2] == pytest.approx(0.1, abs=1e-4)
    (line,) = [record.getMessage() for record in caplog.records]
    assert "box::body and ground_plane::link overlap by 30 mm and move apart at 10 mm/s" in line
    # It rests as one that was never in the ground, and falls as fast.
    box.set_pose(Pose((0.0, 0.0, 0.11)))
    make.step(world, 300)
    assert box.pose().xyz[2] == pytest.approx(0.1, abs=2e-5)
    assert len(caplog.records) == 1


def test_an_arm_that_the_ground_pushes_along_its_links_stays_finite(caplog):
    """No joint gives way to such a push, and impulses grew without bound."""
    with World() as world:
        world.spawn_ground_plane()
        arm = world.spawn(parse_urdf(chain(6)), "arm", Pose((0.0, 0.0, 0.5)))
        for _ in range(1500):
            world.step()
            assert max(map(abs, arm.read_joints()[1])) < 100.0
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(
        "arm::l5 and ground_plane::link overlap by 170 mm (further pairs of their links that "
        "overlap: 1) and")


def test_joints_that_are_put_into_something_are_judged_again(world, ground, caplog):
    for links, joints in ((2, {}), (4, {"j0": 3.0})):
        arm = world.spawn(parse_urdf(chain(links)), "arm", Pose((0.0, 0.0, 0.3)), joints)
        world.step()
        assert not caplog.records
        if links == 2:
            world.delete("arm")
    arm.set_joint_positions({"j0": 0.3})
    for _ in range(300):
        world.step()
        assert max(map(abs, arm.read_joints()[1])) < 100.0
    assert [record.levelname for record in caplog.records] == ["WARNING"]


SHAPE = '<collision><geometry><box size="{}"/></geometry></collision>'
ROBOT = f"""<robot name="robot"><link name="world"/>
  <link name="base">{INERTIAL}{SHAPE.format("0.2 0.3 0.4")}</link>
  <joint name="bolts" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0 0 1"/></joint>
  <link name="slide">{INERTIAL}{SHAPE.format("0.1 0.12 0.14")}</link>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="slide"/>
    <origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/></joint></robot>"""


def test_only_links_that_joints_move_count_and_the_deepest_is_first(world):
    robot = world.spawn(parse_urdf(ROBOT), "robot")
    for name, x in (("at_base", 0.11), ("before", 0.57), ("above", 0.5)):
        text = f'<robot name="{name}"><link name="l">{INERTIAL}{SHAPE.format("0.1 0.1 0.1")}' \
            "</link></robot>"
        z = 1.115 if name == "above" else 1.0
        world.spawn(parse_urdf(text), name, Pose((x, 0.0, z), (0.0, 0.0, 0.0, 1.0)))
    found = find_overlaps(world, robot, before_step=True)
    places = [(one.link, one.model, one.other_link) for one in found]
    assert list(dict.fromkeys(places)) == [("slide", "before", "l"), ("slide", "above", "l")]
    assert found[0].depth == pytest.approx(0.03, abs=2e-3)
    assert found[-1].depth == pytest.approx(0.005, abs=2e-3)


def spawn_at_plate(world, thickness, x):
    """Spawn the robot, and a fixed upright plate of this thickness (m) before its slide."""
    shape = SHAPE.format(f"{thickness} 0.4 0.4")
    plate = parse_urdf(f'<robot name="plate"><link name="l">{shape}</link></robot>')
    world.spawn(plate, "plate", Pose((x, 0.0, 1.0)))
    return world.spawn(parse_urdf(ROBOT), "robot")


def test_a_posture_is_judged_by_itself(world):
    """A contact of the posture before stayed, 0.1 m deep, as long as boxes overlapped."""
    robot = spawn_at_plate(world, 0.001, 0.6)
    depths = []
    for x in (0.0506, 0.1503, 0.0506):  # on its one side, on its other
        robot.set_joint_positions({"rail": x})
        depths.append(max(one.depth for one in find_overlaps(world, robot, before_step=True)))
    assert depths == pytest.approx([1.1e-3, 0.2e-3, 1.1e-3], abs=1e-6)


def test_without_a_posture_contacts_are_those_of_the_last_step():
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        robot = spawn_at_plate(world, 0.02, 0.61)
        robot.set_joint_positions({"rail": 0.0515})
        assert find_overlaps(world, robot) == []  # none was made
        (first, *_) = find_overlaps(world, robot, before_step=True)
        assert (first.link, first.model, first.depth) == ("slide", "plate", pytest.approx(1.5e-3))
        robot.set_joint_positions({"rail": -0.2})
        assert find_overlaps(world, robot)[0] == first
        assert find_overlaps(world, robot, before_step=True) == []
