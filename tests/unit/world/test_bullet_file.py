"""What Bullet is given: our own files, with visuals for its window alone."""

import os
import tempfile

import numpy as np
import pybullet
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import World, bullet_file

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
    monkeypatch.setattr(bullet_file, "MEMORY", str(folder))
    with bullet_file.BulletFiles(described, True, True) as files:
        body = pybullet.loadURDF(files.urdf, physicsClientId=client)
        assert len(list(folder.iterdir())) == 3  # one mesh for visual and collision, a plane
    shown = pybullet.getVisualShapeData(body, physicsClientId=client)
    assert [(s[1], s[7]) for s in shown] == [(-1, (1, 0, 0, 1)), (0, (1, 1, 1, 1))]
    assert all(os.path.dirname(s[4].decode()) == str(folder) for s in shown)
    assert not list(folder.iterdir())


def test_files_of_a_model_that_cannot_be_written_are_gone_too(tmp_path, monkeypatch):
    described, folder = robot(tmp_path), tmp_path / "out"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setattr(bullet_file, "_joint", lambda joint, static: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        bullet_file.BulletFiles(described, True, True)
    assert not list(folder.iterdir())


def test_a_world_without_a_window_makes_no_pictures_in_bullet(tmp_path):
    with World() as world:
        model = world.spawn(robot(tmp_path), "m")
        shown = pybullet.getVisualShapeData(model.body_id, physicsClientId=world.client)
        assert [s[2] for s in shown if s[2] != pybullet.GEOM_BOX] == []
        assert all(s[3] == (0, 0, 0) for s in shown)
        low, high = pybullet.getAABB(model.body_id, -1, physicsClientId=world.client)
        assert np.subtract(high, low) == pytest.approx([2, 1, 1], abs=0.05)
