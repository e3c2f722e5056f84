"""A link of a world's model as a target of the nodes: its mesh, and its pose without simulation."""

from pathlib import Path

import numpy as np
import pytest
import rospy
import yaml
from gazebo_msgs.msg import LinkState
from gazebo_msgs.srv import GetLinkState, GetWorldProperties
from geometry_msgs.msg import Point, Pose, Quaternion

from aras_visual_servo_bench.ros import target_link
from aras_visual_servo_bench.ros.target_link import main
from aras_visual_servo_camera.model_tracker import read_solid

BOX = "<geometry><box><size>{}</size></box></geometry>"
WORLD = f"""<sdf version="1.6"><world name="a"><model name="crate">
  <static>1</static>
  <pose>0.2 -0.1 0.64 0 0 0.6</pose>
  <link name="body"><visual name="v">{BOX.format("0.08 0.05 0.06")}
  </visual></link>
  <link name="lid"><pose>0 0 0.1 0 0 0</pose><visual name="v">{BOX.format("0.1 0.1 0.01")}
  </visual></link></model></world></sdf>"""


@pytest.fixture
def asked(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    monkeypatch.setattr(target_link.tempfile, "tempdir", str(tmp_path))
    (tmp_path / "a.world").write_text(WORLD)

    def ask(*words):
        status = main([*words, "--world", str(tmp_path / "a.world")])
        return status, capsys.readouterr()
    return ask


def test_its_mesh_is_kept_and_its_pose_is_that_of_the_file(asked, tmp_path):
    status, told = asked("crate::body", "mesh")
    assert status == 0
    span = np.ptp(read_solid(told.out).vertices, axis=0)
    np.testing.assert_allclose(span, [0.08, 0.05, 0.06], atol=1e-6)
    kept = Path(told.out)
    assert kept.parents[2] == tmp_path and kept.name == f"crate__body{kept.suffix}"
    before = kept.read_bytes()
    assert asked("crate::body", "mesh")[1].out == told.out and kept.read_bytes() == before
    other = Path(asked("crate::lid", "mesh")[1].out)
    assert other.parent != kept.parent and other.read_bytes() != before == kept.read_bytes()
    status, told = asked("crate::body", "start")
    x, y, z, *rpy = yaml.safe_load(told.out)["pose"]
    assert (x, y, z) == pytest.approx((0.2, -0.1, 0.64), abs=1e-6)
    assert rpy == pytest.approx([0.0, 0.0, 0.6], abs=1e-6)


@pytest.mark.parametrize(("models", "base"), [(["ground", "arm", "crate"], "arm"), (["crate"], "")])
def test_where_a_simulation_has_it_its_pose_is_that_of_now(asked, graph, models, base):
    graph.parameters["/robot_description"] = '<robot name="arm"/>'
    there, found = Pose(Point(0.4, -0.2, 0.7), Quaternion(0.0, 0.0, np.sin(0.15), np.cos(0.15))), {}

    def state(request):
        found["asked"] = request.link_name, request.reference_frame
        return GetLinkState._response_class(success=found["there"],
                                            link_state=LinkState(pose=there))

    rospy.Service(target_link.WORLD, GetWorldProperties,
                  lambda _: GetWorldProperties._response_class(model_names=models, success=True))
    rospy.Service(target_link.STATE, GetLinkState, state)
    for found["there"], pose in ((True, (0.4, -0.2, 0.7, 0.0, 0.0, 0.3)),
                                 (False, (0.2, -0.1, 0.64, 0.0, 0.0, 0.6))):
        status, told = asked("crate::body", "start")
        assert status == 0 and found["asked"] == ("crate::body", base)
        assert yaml.safe_load(told.out)["pose"] == pytest.approx(pose, abs=1e-6)


@pytest.mark.parametrize(("link", "why"), [
    ("crate", "model 'crate' has 2 links with visuals (body, lid); name the target's"),
    ("crate::bod", "has no link 'bod' with visuals: did you mean 'body'"),
    ("crat::body", "there is no model 'crat' in world")])
def test_what_is_not_there_is_said_in_one_line(asked, link, why):
    status, told = asked(link, "mesh")
    assert status == 1 and told.out == ""
    assert why in told.err and told.err.count("\n") == 1


def test_a_folder_that_cannot_be_made_is_one_line(asked, tmp_path):
    (tmp_path / "aras_targets").write_text("a file")
    status, told = asked("crate::body", "mesh")
    assert status == 1 and told.out == ""
    assert "the mesh into" in told.err and told.err.count("\n") == 1
