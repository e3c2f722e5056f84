"""Two fixed cameras and an arm that carries the target: docs/examples by launch arguments, to the
goal that the runner taught."""

import os
from pathlib import Path

import pytest
import yaml
from aras_visual_servo_controller.msg import ServoState
from gazebo_calls import time_goes_on
from sensor_msgs.msg import JointState

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.setup.assembly import assemble

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SPACE = "/aras_visual_servo"
JOINTS = ("along", "across", "up", "wrist")
PORTAL = yaml.safe_load((EXAMPLES / "portal.yaml").read_text())
CAMERAS = {"left": {"namespace": "/left"}, "right": {"namespace": "/right"}}
SCHEME = "stereo_ibvs:StereoIBVS"


@pytest.fixture
def portal(launch, ros_node, ros_master, monkeypatch):
    """The arm, and a camera node for each camera; nodes find the examples."""
    monkeypatch.chdir(EXAMPLES)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    before = ros_master.environment["PYTHONPATH"]
    monkeypatch.setitem(ros_master.environment, "PYTHONPATH", f"{EXAMPLES}{os.pathsep}{before}")
    launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"], paused=True,
           robot="portal", urdf=EXAMPLES / "portal.urdf", target="none",
           gains=EXAMPLES / "portal_controllers.yaml",
           controllers=" ".join(f"{joint}_position_controller" for joint in JOINTS))
    for name in CAMERAS:
        launch("aras_visual_servo_gazebo", "one_camera.launch", name=name,
               nodes=[f"{SPACE}_camera_{name}"])


def test_two_cameras_servo_the_arm_by_launch_arguments(portal, launch, collect, tmp_path):
    goal = assemble(Experiment.from_mapping({**PORTAL, "scheme": SCHEME})).goal
    (tmp_path / "goal.yaml").write_text(goal.to_yaml("for a test"))
    (tmp_path / "cameras.yaml").write_text(
        yaml.safe_dump({"cameras": CAMERAS, "target_frame": "hand"}))
    states = collect(f"{SPACE}/controller/state", ServoState)
    joints = collect(f"{SPACE}/joint_states", JointState)
    nodes = launch("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch", scheme=SCHEME,
                   nodes=[f"{SPACE}_controller"], start=str(PORTAL["start"]),
                   goal=tmp_path / "goal.yaml", cameras=tmp_path / "cameras.yaml")
    try:
        with time_goes_on():
            states.wait(timeout=60.0, where=lambda state: state.phase == "converged")
    finally:
        print([(m.phase, m.reason) for m in states.messages[-1:]], nodes.output()[-1500:])
    last = joints.wait(len(joints.messages) or 1)
    found = dict(zip(last.name, last.position, strict=True))
    assert [found[joint] for joint in JOINTS] == pytest.approx(PORTAL["goal"], abs=1e-3)
    assert all(state.scheme == SCHEME for state in states.messages)
