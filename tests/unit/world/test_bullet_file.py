"""Files that Bullet loads: written by the bridge, with visuals only for Bullet's window."""

import html
import os
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pybullet
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.inertia import inertia_tensor
from aras_sim_bridge.world import Pose, bullet_files

INERTIAL = ('<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
            "</inertial>")


def tetrahedron(path):
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    return path


@pytest.fixture
def client():
    client = pybullet.connect(pybullet.DIRECT)
    yield client
    pybullet.disconnect(client)


def robot(tmp_path):
    """A red link with a mesh in an odd place, joined to a white one with a tilted plane."""
    name = html.escape(str(tetrahedron(tmp_path / "an odd & 'quoted' name.obj")))
    shape = f"<geometry><mesh filename='{name}' scale='2 1 1'/></geometry>"
    return parse_urdf(
        f"<robot name='r'><link name='a &lt; b'>{INERTIAL}<visual>{shape}</visual>"
        f"<collision>{shape}</collision></link><link name='c'>{INERTIAL}"
        "<visual><geometry><plane normal='1 0 0'/>"
        "</geometry></visual></link><joint name='j' type='fixed'><parent link='a &lt; b'/>"
        "<child link='c'/></joint><gazebo reference='a &lt; b'><material>Gazebo/Red</material>"
        "</gazebo></robot>")


def test_the_window_shows_the_links_in_their_colours(client, tmp_path, monkeypatch):
    """By files of the bridge's own, which are gone when Bullet has read them."""
    described, folder = robot(tmp_path), tmp_path / "out"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with bullet_files.BulletFiles(described, True, True) as files:
        body = pybullet.loadURDF(files.urdf, physicsClientId=client)
        # One mesh for visual and collision, and a plane; the small file may lie in memory.
        assert len(list(folder.glob("*.stl"))) == 2
    shown = pybullet.getVisualShapeData(body, physicsClientId=client)
    assert [(s[1], s[7]) for s in shown] == [(-1, (1, 0, 0, 1)), (0, (1, 1, 1, 1))]
    assert all(os.path.dirname(s[4].decode()) == str(folder) for s in shown)
    assert not list(folder.iterdir())


def test_a_world_without_a_window_makes_no_pictures_in_bullet(world, tmp_path):
    model = world.spawn(robot(tmp_path), "m")
    shown = pybullet.getVisualShapeData(model.body_id, physicsClientId=world.client)
    assert [s[2] for s in shown if s[2] != pybullet.GEOM_BOX] == []
    assert all(s[3] == (0, 0, 0) for s in shown)
    low, high = pybullet.getAABB(model.body_id, -1, physicsClientId=world.client)
    assert np.subtract(high, low) == pytest.approx([2, 1, 1], abs=0.05)


TILTED = (0.3, 0.4, 0.5, 0.05, -0.04, 0.03)


def assert_same_inertial(one, other, at=Pose()):  # noqa: B008
    """`other` is that of a body at `at`."""
    assert one.mass == other.mass
    assert one.origin_xyz == pytest.approx(at.apply(other.origin_xyz))
    turn = one.pose.matrix()[:3, :3]
    turned = at.matrix()[:3, :3] @ other.pose.matrix()[:3, :3]
    np.testing.assert_allclose(turn @ inertia_tensor(one.inertia) @ turn.T,
                               turned @ inertia_tensor(other.inertia) @ turned.T, atol=1e-12)


def test_a_massless_root_takes_the_heaviest_inertial_that_is_fixed_to_it(make):
    """Over two fixed joints, where it stands; not what a joint moves, however heavy."""
    text = make.robot(
        '<link name="base_link"/>', make.link("plate", 2.0),
        make.link("chassis", 5.0, "0.1 0.2 0.3", TILTED), make.link("boom", 50.0),
        make.joint("a", "base_link", "plate", "fixed", "1 0 0", rpy="0 0 0.5"),
        make.joint("b", "plate", "chassis", "fixed", "0 2 0", rpy="0.3 0 0"),
        make.joint("c", "base_link", "boom", "revolute"))
    described = parse_urdf(text)
    found = bullet_files.give_root_mass(described)
    lent, lender = found.links["base_link"].inertial, described.links["chassis"].inertial
    at = Pose.from_rpy((1, 0, 0), (0, 0, 0.5)) @ Pose.from_rpy((0, 2, 0), (0.3, 0, 0))
    assert found.links["chassis"].inertial is None
    assert_same_inertial(lent, lender, at)
    for name in ("plate", "boom"):
        assert found.links[name] is described.links[name]
    assert [bullet_files.is_root_fixed(described, asked) for asked in (None, True, False)] == [
        False, True, False]
    for name in ("base_link", "chassis"):  # one that gravity does not pull at is enough
        light = f'<gazebo reference="{name}"><gravity>0</gravity></gazebo></robot>'
        weightless = bullet_files.give_root_mass(parse_urdf(text.replace("</robot>", light)))
        assert not weightless.links["base_link"].gravity
    assert found.links["base_link"].gravity
    named = parse_urdf(text.replace("base_link", "world"))
    assert bullet_files.give_root_mass(named) is named
    assert bullet_files.is_root_fixed(named)


@pytest.mark.parametrize("static", [False, True])
def test_what_bullet_is_given_is_the_model_but_for_what_the_world_does(make, tmp_path, static):
    """Read again: no friction, damping or mimicking, and principal axes."""
    mesh = tetrahedron(tmp_path / "m.obj")
    shapes = "".join(
        f'<collision><origin xyz="{k} 0.5 0.2" rpy="0.1 {k} 0.3"/><geometry>{shape}</geometry>'
        "</collision>" for k, shape in enumerate((
            '<box size="0.1 0.2 0.3"/>', '<sphere radius="0.4"/>',
            f'<mesh filename="file://{mesh}" scale="1 2 3"/>', f'<mesh filename="file://{mesh}"/>',
        )))
    described = replace(parse_urdf(make.robot(
        make.link("base", 3.0, "0.1 0.2 0.3", TILTED, shapes),
        make.link("arm", 2.0, "0 0 1", TILTED), make.link("car", 1.0), '<link name="bare"/>',
        make.joint("turn", "base", "arm", "revolute", "1 2 3", "0.6 0 0.8", -1.0, 2.5, 7.0, 0.5,
                   0.25, "0.1 0.2 0.3"),
        make.joint("rail", "arm", "car", "prismatic", "0 0 1", "0 1 0", -0.25, 0.75,
                   extra='<mimic joint="turn" multiplier="2"/>'),
        make.joint("spin", "car", "bare", "continuous"), name="a &amp; b")), static=static)
    with bullet_files.BulletFiles(described, False, False) as files:
        text = Path(files.urdf).read_text()
        # Bullet alone reads shapes of no size, and meshes in their own unit.
        found = parse_urdf(re.sub("<visual>.*?</visual>", "", text))
    assert text.count(".stl") == 2
    assert found.name == "a & b" and list(found.links) == list(described.links)
    for name, link in found.links.items():
        was = described.links[name]
        assert (link.inertial is None) is (was.inertial is None) and not link.visuals
        if link.inertial is not None:
            assert_same_inertial(link.inertial, was.inertial)
            assert link.inertial.inertia[1::3] == (0.0, 0.0) and link.inertial.inertia[2] == 0.0
        for part, old in zip(link.collisions, was.collisions, strict=True):
            assert (part.origin_xyz, part.origin_rpy) == (old.origin_xyz, old.origin_rpy)
            assert replace(part.geometry, filename=None) == replace(old.geometry, filename=None)
    for name, joint in found.joints.items():
        was = described.joints[name]
        assert (joint.parent, joint.child, joint.origin_xyz, joint.origin_rpy) == (
            was.parent, was.child, was.origin_xyz, was.origin_rpy)
        assert joint.kind == ("fixed" if static else was.kind)
        assert (joint.damping, joint.friction, joint.mimic) == (0.0, 0.0, None)
        if not static:
            assert joint.axis == pytest.approx(was.axis) and joint.stops == was.stops
            assert joint.limits == was.limits or joint.kind == "continuous"


def written(described, fixed_base):
    with bullet_files.BulletFiles(described, fixed_base, False) as files:
        return Path(files.urdf).read_text()


def test_hollows_are_kept_of_the_root_s_meshes_alone_where_it_never_moves(make, tmp_path):
    mesh = tetrahedron(tmp_path / "m.obj")
    shapes = make.box("1 1 1") + f'<collision><geometry><mesh filename="file://{mesh}"/>' \
        "</geometry></collision>"
    described = parse_urdf(make.robot(make.link("a", shapes=shapes), make.link("b", shapes=shapes),
                                      make.joint("j", "a", "b")))
    for bolted in (True, False):
        first, second = written(described, bolted).split('<link name="b">')
        assert first.count('concave="yes"') == bolted and "concave" not in second
