"""Files that Bullet loads: written by the bridge, with visuals only for Bullet's window."""

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
from aras_sim_bridge.world import Pose, World, bullet_files

INERTIAL = ('<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
            "</inertial>")


@pytest.fixture
def client():
    client = pybullet.connect(pybullet.DIRECT)
    yield client
    pybullet.disconnect(client)


def robot(tmp_path):
    """A red link with a mesh in an odd place, joined to a white one with a tilted plane."""
    mesh = tmp_path / "an odd & 'quoted' name.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    name = str(mesh).replace("&", "&amp;").replace("'", "&apos;")
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


def test_a_world_without_a_window_makes_no_pictures_in_bullet(tmp_path):
    with World() as world:
        model = world.spawn(robot(tmp_path), "m")
        shown = pybullet.getVisualShapeData(model.body_id, physicsClientId=world.client)
        assert [s[2] for s in shown if s[2] != pybullet.GEOM_BOX] == []
        assert all(s[3] == (0, 0, 0) for s in shown)
        low, high = pybullet.getAABB(model.body_id, -1, physicsClientId=world.client)
        assert np.subtract(high, low) == pytest.approx([2, 1, 1], abs=0.05)


def test_a_massless_root_takes_the_heaviest_inertial_that_is_fixed_to_it(make):
    """Over two fixed joints, where it stands; not what a joint moves, however heavy."""
    tilted = (0.3, 0.4, 0.5, 0.05, -0.04, 0.03)
    text = make.robot(
        '<link name="base_link"/>', make.link("plate", 2.0),
        make.link("chassis", 5.0, "0.1 0.2 0.3", tilted), make.link("boom", 50.0),
        make.joint("a", "base_link", "plate", "fixed", "1 0 0", rpy="0 0 0.5"),
        make.joint("b", "plate", "chassis", "fixed", "0 2 0", rpy="0.3 0 0"),
        make.joint("c", "base_link", "boom", "revolute"))
    described = parse_urdf(text)
    found = bullet_files.give_root_mass(described)
    lent, lender = found.links["base_link"].inertial, described.links["chassis"].inertial
    at = Pose.from_rpy((1, 0, 0), (0, 0, 0.5)) @ Pose.from_rpy((0, 2, 0), (0.3, 0, 0))
    assert lent.mass == 5.0 and found.links["chassis"].inertial is None
    assert lent.origin_xyz == pytest.approx(at.apply((0.1, 0.2, 0.3)))
    turn = lent.pose.matrix()[:3, :3]
    world = at.matrix()[:3, :3] @ lender.pose.matrix()[:3, :3]
    np.testing.assert_allclose(turn @ inertia_tensor(lent.inertia) @ turn.T,
                               world @ inertia_tensor(lender.inertia) @ world.T, atol=1e-12)
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


def same_inertial(one, other):
    turn, turned = one.pose.matrix()[:3, :3], other.pose.matrix()[:3, :3]
    np.testing.assert_allclose(turn @ inertia_tensor(one.inertia) @ turn.T,
                               turned @ inertia_tensor(other.inertia) @ turned.T, atol=1e-12)
    return one.mass == other.mass and one.origin_xyz == pytest.approx(other.origin_xyz)


@pytest.mark.parametrize("static", [False, True])
def test_what_bullet_is_given_is_the_model_but_for_what_the_world_does(make, tmp_path, static):
    """Read again by our own parser: links, inertia, shapes, frames, axes and limits; no friction,
    damping or mimicking, and principal axes."""
    mesh = tmp_path / "m.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    tilted = (0.3, 0.4, 0.5, 0.05, -0.04, 0.03)
    shapes = "".join(
        f'<collision><origin xyz="{k} 0.5 0.2" rpy="0.1 {k} 0.3"/><geometry>{shape}</geometry>'
        "</collision>" for k, shape in enumerate((
            '<box size="0.1 0.2 0.3"/>', '<sphere radius="0.4"/>',
            f'<mesh filename="file://{mesh}" scale="1 2 3"/>', f'<mesh filename="file://{mesh}"/>',
        )))
    described = parse_urdf(make.robot(
        make.link("base", 3.0, "0.1 0.2 0.3", tilted, shapes),
        make.link("arm", 2.0, "0 0 1", tilted), make.link("car", 1.0), '<link name="bare"/>',
        make.joint("turn", "base", "arm", "revolute", "1 2 3", "0.6 0 0.8", -1.0, 2.5, 7.0, 0.5,
                   0.25, "0.1 0.2 0.3"),
        make.joint("rail", "arm", "car", "prismatic", "0 0 1", "0 1 0", -0.25, 0.75,
                   extra='<mimic joint="turn" multiplier="2"/>'),
        make.joint("spin", "car", "bare", "continuous"), name="a &amp; b"))
    described = replace(described, static=static)
    with bullet_files.BulletFiles(described, False, False) as files:
        text = Path(files.urdf).read_text()
        assert text.count(".stl") == 2
        # Bullet alone reads shapes of no size, and meshes in their own unit.
        found = parse_urdf(re.sub("<visual>.*?</visual>", "", text))
        assert found.name == "a & b" and list(found.links) == list(described.links)
        for name, link in found.links.items():
            was = described.links[name]
            if was.inertial is None:
                assert link.inertial is None
                continue
            assert same_inertial(link.inertial, was.inertial)
            assert link.inertial.inertia[1::3] == (0.0, 0.0) and link.inertial.inertia[2] == 0.0
            assert len(link.collisions) == len(was.collisions) and not link.visuals
            for part, old in zip(link.collisions, was.collisions, strict=True):
                assert (part.origin_xyz, part.origin_rpy) == (old.origin_xyz, old.origin_rpy)
                assert replace(part.geometry, filename=None) == replace(old.geometry, filename=None)
    for name, joint in found.joints.items():
        was = described.joints[name]
        assert (joint.parent, joint.child) == (was.parent, was.child)
        assert (joint.origin_xyz, joint.origin_rpy) == (was.origin_xyz, was.origin_rpy)
        assert joint.kind == ("fixed" if static else was.kind)
        assert (joint.damping, joint.friction, joint.mimic) == (0.0, 0.0, None)
        if not static:
            assert joint.axis == pytest.approx(was.axis) and joint.stops == was.stops
        if not static and joint.kind != "continuous":
            assert joint.limits == was.limits


def test_a_tensor_that_bullet_would_not_take_is_a_sphere_s_in_its_file(make):
    """bullet_body.py tells Bullet the true moments; those it takes are as they are."""
    for moments, written in (((1.0, 2.0, 4.0), (4.0, 4.0, 4.0)), ((1.0, 3.0, 4.0), (1.0, 3.0, 4.0)),
                             ((1.0, 2.0, 2.5), (1.0, 2.0, 2.5))):
        described = parse_urdf(make.robot(make.link("a", inertia=(*moments, 0, 0, 0))))
        with bullet_files.BulletFiles(described, False, False) as files:
            found = parse_urdf(Path(files.urdf).read_text()).links["a"].inertial.inertia
        assert (found[0], found[3], found[5]) == written


def written(described, fixed_base):
    with bullet_files.BulletFiles(described, fixed_base, False) as files:
        return Path(files.urdf).read_text()


def test_hollows_are_kept_of_the_root_s_meshes_alone_where_it_never_moves(make, tmp_path):
    mesh = tmp_path / "m.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    shapes = make.box("1 1 1") + f'<collision><geometry><mesh filename="file://{mesh}"/>' \
        "</geometry></collision>"
    described = parse_urdf(make.robot(make.link("a", shapes=shapes), make.link("b", shapes=shapes),
                                      make.joint("j", "a", "b")))
    for bolted in (True, False):
        first, second = written(described, bolted).split('<link name="b">')
        assert first.count('concave="yes"') == bolted and "concave" not in second
