"""spawn_model: the effect of each argument on the simulator."""

from __future__ import annotations

import math

import pytest

from aras_sim_bridge.ros.cli import spawn_model
from aras_sim_bridge.ros.cli.spawn_model import SpawnError, parse, spawn

BOX = '<robot name="box"><link name="l"></link></robot>'


@pytest.fixture
def asked(api, monkeypatch):
    """Function that runs the program with arguments in the world of `api`."""
    monkeypatch.setattr(spawn_model.rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(spawn_model.rospy, "get_namespace", lambda: "/")

    def ask(*argv: str) -> None:
        spawn(parse([*argv]))

    ask.graph = api.graph
    return ask


def test_a_model_is_put_where_the_arguments_say(asked):
    asked.graph.set("/text", BOX)
    asked("-urdf", "-param", "/text", "-model", "m", "-x", "1", "-y", "2", "-z", "3",
          "-R", "0.1", "-P", "0.2", "-Y", str(math.pi / 2))  # fmt: skip
    pose = asked.graph.call("/gazebo/get_model_state", "m", "").pose
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.0, 2.0, 3.0)
    q = pose.orientation
    # Rz(90°) Ry(0.2) Rx(0.1): the model's x axis points along y, dipped by 0.2 rad.
    x_axis = (1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.z * q.w), 2 * (q.x * q.z - q.y * q.w))
    assert x_axis == pytest.approx((0.0, math.cos(0.2), -math.sin(0.2)), abs=1e-12)
    dipped = 2 * (q.y * q.z + q.x * q.w)
    assert dipped == pytest.approx(math.cos(0.2) * math.sin(0.1), abs=1e-12)


def test_what_cannot_be_read_or_spawned_is_said(asked, tmp_path):
    with pytest.raises(SpawnError, match="parameter /nothing does not exist"):
        asked("-urdf", "-param", "/nothing", "-model", "m")
    with pytest.raises(SpawnError, match="cannot read the model file"):
        asked("-urdf", "-file", str(tmp_path / "no.urdf"), "-model", "m")
    (tmp_path / "no.urdf").write_bytes(b"<robot name='\xff'/>")
    with pytest.raises(SpawnError, match="cannot read the model file"):
        asked("-urdf", "-file", str(tmp_path / "no.urdf"), "-model", "m")
    with pytest.raises(SpawnError, match="there is no model database"):
        asked("-urdf", "-database", "m", "-model", "m")
    (tmp_path / "box.urdf").write_text(BOX)
    with pytest.raises(SpawnError, match="-J takes a joint name and a number"):
        asked("-urdf", "-file", str(tmp_path / "box.urdf"), "-model", "m", "-J", "a", "b")
    with pytest.raises(SpawnError, match="model_name is empty"):
        asked("-urdf", "-file", str(tmp_path / "box.urdf"), "-model", "")
