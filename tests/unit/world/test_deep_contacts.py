"""Deeply penetrating bodies separate slowly, as in Gazebo, and are reported in one line."""

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, World

INERTIAL = """<inertial><mass value="1"/>
  <inertia ixx="0.01" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>"""
BOX = f"""<robot name="box"><link name="body">{INERTIAL}
  <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link></robot>"""


def chain(links: int) -> str:
    """A bolted arm of balls that hangs straight down, a tenth of a metre a link."""
    parts = [f'<link name="l{k}">{INERTIAL}<collision><origin xyz="0 0 -0.05"/><geometry>'
             '<sphere radius="0.02"/></geometry></collision></link>' for k in range(links)]
    joints = [f'<joint name="j{k}" type="continuous"><parent link="{f"l{k - 1}" if k else "world"}"'
              f'/><child link="l{k}"/><origin xyz="0 0 -0.1"/><axis xyz="{k % 2} {1 - k % 2} 0"/>'
              "</joint>" for k in range(links)]
    return f'<robot name="chain"><link name="world"/>{"".join(parts + joints)}</robot>'


def test_a_box_that_is_put_into_the_ground_leaves_it_at_gazebos_speed(caplog):
    with World() as world:
        world.spawn_ground_plane()
        box = world.spawn(parse_urdf(BOX), "box", Pose((0.0, 0.0, 0.07)))
        for _ in range(1000):
            world.step()
        assert box.pose().xyz[2] == pytest.approx(0.08, abs=1e-3)
        for _ in range(3000):
            world.step()
        assert box.pose().xyz[2] == pytest.approx(0.1, abs=1e-4)
        (line,) = [record.getMessage() for record in caplog.records]
        assert "box::body and ground_plane::link overlap by 30 mm and move apart at 10 mm/s" in line
        # It rests as one that was never in the ground, and falls as fast.
        box.set_pose(Pose((0.0, 0.0, 0.11)))
        for _ in range(300):
            world.step()
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


def test_joints_that_are_put_into_something_are_judged_again(caplog):
    with World() as world:
        world.spawn_ground_plane()
        arm = world.spawn(parse_urdf(chain(2)), "arm", Pose((0.0, 0.0, 0.3)))
        world.step()
        assert not caplog.records
        world.delete("arm")
        arm = world.spawn(parse_urdf(chain(4)), "arm", Pose((0.0, 0.0, 0.3)),
                          {"j0": 3.0})
        world.step()
        assert not caplog.records
        arm.set_joint_positions({"j0": 0.3})
        for _ in range(300):
            world.step()
            assert max(map(abs, arm.read_joints()[1])) < 100.0
        assert [record.levelname for record in caplog.records] == ["WARNING"]
