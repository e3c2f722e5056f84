"""Postures of an arm whose own plate can come between its camera and the target."""

import logging

import numpy as np
import pytest
from made_arm import write_arm

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import log_once
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble

JOINTS = ("x", "y", "z", "fan", "head")
AXES = ("1 0 0", "0 1 0", "0 0 1", "0 0 1", "0 0 1")
# Three slides, and two joints about one axis, which turn the camera; the first carries a plate
# below it, that reaches from the axis along its x.
PLATE = ('<visual><origin xyz="0.1 0 -0.08"/><geometry><box size="0.2 0.2 0.004"/></geometry>'
         "</visual>")
TARGET = {"shape": "l_shape", "size": [0.06, 0.05], "pose": [0.0, 0.0, 0.001, 0.0, 0.0, 0.0]}
DOWN = [np.pi, 0.0, 0.0]
GOAL = {"pose": [-0.06, 0.01, 0.25, *DOWN]}  # the target lies to the side that the plate is on
START = {"pose": [-0.05, 0.02, 0.28, np.pi, 0.0, 0.1]}


TABLE = """<link name="table"><visual><geometry><box size="2 2 0.02"/></geometry></visual></link>
<joint name="stands" type="fixed"><parent link="world"/><child link="table"/>
  <origin xyz="0 0 -0.011"/></joint>"""


@pytest.fixture
def experiment(tmp_path):
    def made(turn=3.0, **keys):
        """`turn`: limit of the joint that carries the plate, rad."""
        joints = [(name, name in "xyz", "0 0 0", axis, (-most, most), PLATE * (name == "fan"))
                  for name, axis, most in zip(JOINTS, AXES, (1, 1, 1, turn, 3), strict=True)]
        robot = write_arm(joints, np.pi / 2, tmp_path, TABLE)
        keys = {"target": TARGET, "goal": GOAL, "start": START, "camera": {}, "scheme": "points",
                **keys}
        return Experiment(robot=robot, **keys)
    log_once.cache_clear()
    return made


def of(experiment):
    parts = assemble(experiment)
    parts.plant.close()
    return parts


def test_the_first_posture_is_taken_where_it_hides_nothing(experiment):
    for goal in ({"pose": [0.06, 0.01, 0.25, *DOWN]}, {"pose": [0.07, -0.02, 0.3, *DOWN]}):
        found = of(experiment(goal=goal, start=goal)).postures
        pose = matrix_from_xyz_rpy(goal["pose"][:3], goal["pose"][3:])
        plain = found.arm.inverse_kinematics(pose, np.zeros(5))
        np.testing.assert_array_equal(found.find_joints(pose), plain)
        np.testing.assert_array_equal(found.find_start_joints(pose, None), plain)


def test_a_posture_that_hides_nothing_is_preferred(experiment):
    parts = of(experiment())
    pose, found = matrix_from_xyz_rpy(GOAL["pose"][:3], DOWN), parts.postures
    first = found.arm.inverse_kinematics(pose, np.zeros(5))
    assert found.compute_occlusion(first) > 0.95
    chosen = found.find_joints(pose)
    assert found.compute_occlusion(chosen) == 0.0 and not parts.notes
    np.testing.assert_allclose(found.arm.pose(chosen), pose, atol=1e-8)
    start = matrix_from_xyz_rpy(START["pose"][:3], START["pose"][3:])
    begun = found.find_start_joints(start, chosen)
    assert abs(begun[3] - chosen[3]) < 0.5  # it comes to the goal as it began
    np.testing.assert_array_equal(parts.plant.joint_names, JOINTS)


@pytest.mark.parametrize("keys", [{"plant": "chain"}, {"features": "exact"}])
def test_where_the_arm_is_not_drawn_postures_are_as_before(experiment, keys):
    found = of(experiment(**keys)).postures
    pose = matrix_from_xyz_rpy(GOAL["pose"][:3], DOWN)
    plain = found.arm.inverse_kinematics(pose, np.zeros(5))
    np.testing.assert_array_equal(found.find_joints(pose), plain)


def test_where_every_posture_hides_it_one_line_says_so(experiment, caplog):
    pose = matrix_from_xyz_rpy((-0.012, 0.01, 0.25), DOWN)
    asked = experiment(turn=0.3, scheme="moments", goal={"pose": [-0.012, 0.01, 0.25, *DOWN]})
    with caplog.at_level(logging.WARNING):
        parts = of(asked)
    note, at_start = parts.notes
    told = [r.getMessage() for r in caplog.records if "hides" in r.getMessage()]
    assert told == [note, at_start] and "at the goal" in note and "at the start" in at_start
    part = float(note.split("hides ")[1].split(" %")[0]) / 100
    chosen = parts.postures.find_joints(pose)
    assert part == pytest.approx(parts.postures.compute_occlusion(chosen), abs=0.006)
    others = [parts.postures.compute_occlusion([*chosen[:3], q, -q])
              for q in np.linspace(-0.3, 0.3, 7)]  # fmt: skip
    assert 0.3 < part < min(others) + 0.03 < max(others)


def test_what_the_chain_sees_through_is_said(experiment, caplog):
    with caplog.at_level(logging.WARNING):
        result = run(experiment(plant="chain"))
    assert result.converged
    (note,) = result.notes
    assert "hides" in note and "arm is transparent" in note and note in caplog.messages
    hidden = of(experiment(plant="chain")).postures.compute_occlusion(result.measured_positions[-1])
    assert float(note.split("hides ")[1].split(" %")[0]) == pytest.approx(100 * hidden, abs=1.0)
    assert not run(experiment(plant="chain", duration=0.1)).notes  # it has not converged
    aside = {"pose": [0.06, 0.01, 0.25, *DOWN]}
    start = {"pose": [0.05, 0.02, 0.28, np.pi, 0.0, 0.1]}
    result = run(experiment(plant="chain", goal=aside, start=start))
    assert result.converged and not result.notes
