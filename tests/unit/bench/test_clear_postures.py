"""Postures of an elbow above the ground, and of a gantry with a paddle beside a post, that run into
neither."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from made_arm import write_arm

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import log_once
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import Loop, run
from aras_visual_servo_bench.setup.assembly import assemble


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
GANTRY = (
    ("along", True, "0 0 0", "1 0 0", (-1, 1), ""),
    ("across", True, "0 0 0", "0 1 0", (-1, 1), ""),
    ("up", True, "0 0 0", "0 0 1", (-1, 1), ""),
    ("paddle", False, "0 0 0", "0 0 1", (-3, 3), solid("0.11 0 0.04", "0.2 0.05 0.02")),
    ("head", False, "0 0 0", "0 0 1", (-3, 3), ""),
)
POST = """<sdf version="1.6"><world name="a"><model name="post"><static>1</static>
  <pose>0.16 0.2 0.3 0 0 0.2</pose><link name="wood"><collision name="c"><geometry><box>
  <size>0.06 0.05 0.6</size></box></geometry></collision></link></model></world></sdf>"""
DOWN = [np.pi, 0.0]
LAID = {"shape": "l_shape", "size": [0.08, 0.06]}


@pytest.fixture(params=["elbow", "gantry"])
def clear(request, tmp_path):
    """An experiment whose goal's first posture runs into something, and into what."""
    log_once.cache_clear()
    keys = {"camera": {}, "scheme": "points", "features": "exact", "gain": 4.0,
            "time_after_convergence": 0.1}  # fmt: skip
    if request.param == "elbow":
        return Experiment(
            robot=write_arm(ELBOW, 0.0, tmp_path),
            target={**LAID, "pose": [0.33, 0.12, 0.001, 0.0, 0.0, 0.4]},
            goal={"pose": [0.32, 0.13, 0.2, *DOWN, 0.7]},
            start={"pose": [0.36, 0.1, 0.23, *DOWN, 0.5]}, **keys,
        ), "lift_link", "ground_plane"  # fmt: skip
    (tmp_path / "post.world").write_text(POST)
    return Experiment(
        robot=write_arm(GANTRY, np.pi / 2, tmp_path), world=str(tmp_path / "post.world"),
        target={**LAID, "pose": [0.05, 0.06, 0.001, 0.0, 0.0, -0.3]},
        goal={"pose": [0.04, 0.05, 0.25, *DOWN, 0.2]},
        start={"pose": [0.05, 0.03, 0.28, *DOWN, 0.0]}, **keys,
    ), "paddle_link", "post"  # fmt: skip


def first_found(experiment, found):
    """Joints at the goal that are found first, and its pose (4, 4)."""
    pose = matrix_from_xyz_rpy(experiment.goal.pose[:3], experiment.goal.pose[3:])
    return found.arm.inverse_kinematics(pose, np.zeros(5)), pose


def test_a_posture_that_runs_into_something_is_left_out(clear):
    experiment, link, other = clear
    parts = assemble(experiment)
    found = parts.postures
    first, pose = first_found(experiment, found)
    assert found.find_collision(first) == f"link '{link}' of the arm is in '{other}'"
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


@pytest.mark.parametrize("clear", ["elbow"], indirect=True)
def test_joints_that_run_into_something_are_said_and_the_advice_names_it(clear, caplog):
    experiment, link, other = clear
    parts = assemble(experiment)
    parts.plant.close()
    first, _ = first_found(experiment, parts.postures)
    with caplog.at_level(logging.WARNING):
        above = first - [0.0, 0.4, 0.0, 0.0, 0.0]  # what is in something already stays there
        result = run(
            experiment.with_changes(goal=first.tolist(), start=above.tolist(), duration=2.0)
        )
    said = f"(link '{link}' of the arm is in '{other}'); give other joints"
    (note,) = result.notes
    assert said in note and "at the goal" in note
    assert all(note in caplog.messages for note in result.notes)
    assert result.outcome == "joints_do_not_follow"
    assert f"is in collision with '{other}'" in result.reason and other in result.remedy


@pytest.mark.parametrize("clear", ["elbow"], indirect=True)
def test_where_every_posture_runs_into_something_one_line_says_so(clear, caplog):
    """The target lies in a pit that the ground plane knows nothing of."""
    experiment, _, _ = clear
    low = {"pose": [*experiment.goal.pose[:2], -0.1, *experiment.goal.pose[3:]]}
    target = {**LAID, "pose": [*experiment.target.pose[:2], -0.3, 0.0, 0.0, 0.2]}
    with caplog.at_level(logging.WARNING):
        parts = assemble(experiment.with_changes(goal=low, start=low, target=target))
    parts.plant.close()
    note, at_start = parts.notes
    assert "at the goal (link" in note and "'ground_plane'), and no posture without" in note
    assert "at the start" in at_start and caplog.messages == [note, at_start]
