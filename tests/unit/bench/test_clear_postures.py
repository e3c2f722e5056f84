"""Postures of an elbow above the ground that do not run into it."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from made_arm import write_arm

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench import Experiment, Loop, assemble, run
from aras_visual_servo_bench.errors import log_once


def solid(at, size):
    """XML of a box, by its middle and size, m."""
    box = f'<geometry><box size="{size}"/></geometry>'
    return f'<collision><origin xyz="{at}"/>{box}</collision>'


ELBOW = (
    ("yaw", False, "0 0 0.1", "0 0 1", (-3, 3), ""),
    ("lift", False, "0 0 0.02", "0 1 0", (-2.5, 2.5), solid("0.15 0 0", "0.3 0.06 0.07")),
    ("bend", False, "0.3 0 0", "0 1 0", (-2.6, 2.6), solid("0.14 0 0", "0.28 0.05 0.06")),
    ("nod", False, "0.28 0 0", "0 1 0", (-3, 3), ""),
    ("turn", False, "0.03 0 0", "1 0 0", (-3.1, 3.1), ""),
)
DOWN = [np.pi, 0.0]
LAID = {"shape": "l_shape", "size": [0.08, 0.06]}


OTHER = "ground_plane"


@pytest.fixture
def experiment(tmp_path):
    log_once.cache_clear()
    return Experiment(
        robot=write_arm(ELBOW, 0.0, tmp_path), camera={}, scheme="points", features="exact",
        target={**LAID, "pose": [0.33, 0.12, 0.001, 0.0, 0.0, 0.4]}, gain=2.0,
        goal={"pose": [0.32, 0.13, 0.2, *DOWN, 0.7]}, start={"pose": [0.36, 0.1, 0.23, *DOWN, 0.5]},
        time_after_convergence=0.3,
    )  # fmt: skip


def find_first(experiment, found):
    pose = matrix_from_xyz_rpy(experiment.goal.pose[:3], experiment.goal.pose[3:])
    return found.arm.inverse_kinematics(pose, np.zeros(5)), pose


def test_a_posture_that_runs_into_something_is_left_out(experiment):
    parts = assemble(experiment)
    found = parts.postures
    first, pose = find_first(experiment, found)
    assert found.find_collision(first) == f"link 'lift_link' of the arm is in '{OTHER}'"
    chosen = found.find_joints(pose)
    assert found.find_collision(chosen) == ""
    np.testing.assert_allclose(found.arm.pose(chosen), pose, atol=1e-8)
    # The goal says the posture, and the start is found from it, as on a graph.
    assert parts.goal.get_joints(found.arm.names) == pytest.approx(chosen)
    begun = parts.plant.read_joints()[0]
    assert np.abs(begun - chosen).max() < 0.5
    xyz, rpy = experiment.start.pose[:3], experiment.start.pose[3:]
    node = replace(parts.settings, start={"xyz": xyz, "rpy": rpy}).make_servo(found.arm, parts.goal)
    np.testing.assert_allclose(node.settings.start, begun, atol=1e-9)
    loop = Loop(experiment, parts)
    loop.run_to_end()
    result = loop.make_run()
    assert result.converged and result.verdict.is_reached and not result.notes
    loop.close()


def test_joints_that_run_into_something_are_said_and_the_advice_names_it(experiment, caplog):
    parts = assemble(experiment)
    parts.plant.close()
    first, _ = find_first(experiment, parts.postures)
    above = first - [0.0, 0.4, 0.0, 0.0, 0.0]  # what is in something already stays there
    with caplog.at_level(logging.WARNING):
        result = run(experiment.with_changes(goal=[*first], start=[*above], duration=3.0))
    (note,) = result.notes
    assert f"(link 'lift_link' of the arm is in '{OTHER}'); give other joints" in note
    assert "at the goal" in note and note in caplog.messages
    assert result.outcome == "joints_do_not_follow"
    assert f"is in collision with '{OTHER}'" in result.reason and OTHER in result.remedy


def test_where_every_posture_runs_into_something_one_line_says_so(experiment, caplog):
    """The target lies in a pit that the ground plane knows nothing of."""
    low = {"pose": [*experiment.goal.pose[:2], -0.1, *experiment.goal.pose[3:]]}
    target = {**LAID, "pose": [*experiment.target.pose[:2], -0.3, 0.0, 0.0, 0.2]}
    with caplog.at_level(logging.WARNING):
        parts = assemble(experiment.with_changes(goal=low, start=low, target=target))
    parts.plant.close()
    note, at_start = parts.notes
    assert "at the goal (link" in note and "'ground_plane'), and no posture without" in note
    assert "at the start" in at_start and caplog.messages == [note, at_start]
