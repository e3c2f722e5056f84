"""Fixed camera with a target on the arm: the closed loop in the runner."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from aras_visual_servo_base.poses import inverse, pose_difference, xyz_rpy_from_matrix
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_controller.kinematics import Arm

# Three slides and a wrist that carry the plate; the camera is fixed above them.
ROBOT = """<robot name="portal"><link name="world"/><link name="eye"/>
<joint name="eye_joint" type="fixed"><parent link="world"/><child link="eye"/>
  <origin xyz="0 0 1" rpy="3.141592653589793 0 0.4"/></joint>
<link name="x"/><link name="y"/><link name="z"/><link name="hand"/>
<joint name="along" type="prismatic"><parent link="world"/><child link="x"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1" velocity="1" effort="9"/></joint>
<joint name="across" type="prismatic"><parent link="x"/><child link="y"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" velocity="1" effort="9"/></joint>
<joint name="up" type="prismatic"><parent link="y"/><child link="z"/><axis xyz="0 0 1"/>
  <origin xyz="0 0 0.5"/><limit lower="-0.4" upper="0.4" velocity="1" effort="9"/></joint>
<joint name="wrist" type="revolute"><parent link="z"/><child link="hand"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" velocity="2" effort="9"/></joint>
</robot>"""
SHAPE = [[-0.05, -0.03], [0.05, -0.03], [0.03, 0.04], [-0.05, 0.01]]
GOAL, START = [0.02, -0.03, 0.1, 0.3], [0.1, 0.05, -0.02, -0.4]


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    path = tmp_path_factory.mktemp("portal") / "portal.urdf"
    path.write_text(ROBOT)
    return Experiment.from_mapping({
        "plant": "chain", "target": {"shape": SHAPE}, "goal": GOAL, "start": START,
        "robot": {"urdf": str(path), "camera_frame": "eye", "target_frame": "hand"},
    })  # fmt: skip


@pytest.mark.parametrize(
    ("scheme", "interaction"), [("moments", "estimated"), ("points", "current")])
def test_the_arm_brings_the_target_before_the_camera(experiment, scheme, interaction):
    result = run(
        experiment.with_changes(scheme=scheme, controller_parameters={"interaction": interaction})
    )
    assert result.outcome == "converged" and result.verdict.is_reached
    assert set(result.outcomes) == {"running", "converged"}
    assert result.compute_settling_time() < 1.2
    np.testing.assert_allclose(result.measured_positions[-1], GOAL, atol=2e-4)
    # poses are those of the camera before the target
    camera, hand = Arm.from_urdf(ROBOT, "hand"), np.eye(4)
    q = result.measured_positions[40]
    to_hand = {name: value for name, value in zip(result.joint_names, q, strict=True)}
    hand = camera.pose(np.array([to_hand[name] for name in camera.names]))
    eye = ElementTree.fromstring(ROBOT).find("joint[@name='eye_joint']/origin").get("xyz")
    seen = hand @ result.true_pose[40]
    np.testing.assert_allclose(seen[:3, 3], np.array(eye.split(), float), atol=1e-9)


def test_a_target_in_the_hand_is_no_target_in_the_world(experiment):
    """The same robot with a camera that the arm is believed not to move: nothing to servo with."""
    arm = Arm.from_urdf(ROBOT, "eye", target_frame="hand")
    assert set(arm.names) == {"along", "across", "up", "wrist"}
    a, b = arm.pose(np.zeros(4)), arm.pose(np.array([0.1, 0.0, 0.0, 0.5]))
    distance, angle = pose_difference(a, b)
    assert angle == pytest.approx(0.5) and distance > 0.05
    x, _ = xyz_rpy_from_matrix(inverse(a))
    assert x[2] == pytest.approx(0.5)
