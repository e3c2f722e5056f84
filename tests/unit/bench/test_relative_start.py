"""Starts relative to the goal: closed forms of each kind, and random poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.experiment.starts import RelativeStart
from aras_visual_servo_bench.setup.assembly import assemble

GOAL = matrix_from_xyz_rpy((0.1, -0.2, 0.9), (np.pi - 0.1, 0.2, 0.4))
TARGET = matrix_from_xyz_rpy((0.3, 0.1, 0.2), (0.1, -0.2, 0.5))


def posed(start, seed=0):
    x = start.compute_pose(GOAL, TARGET, seed)
    return matrix_from_xyz_rpy(x[:3], x[3:])


def turned(rotation):
    made = np.eye(4)
    made[:3, :3] = rotation.as_matrix()
    return made


def test_each_kind_is_what_it_says():
    about = turned(Rotation.from_rotvec(np.radians(50.0) * np.array([0.0, 0.6, 0.8])))
    found = posed(RelativeStart("turned", angle=50.0, axis=(0.0, 3.0, 4.0)))
    np.testing.assert_allclose(found, GOAL @ about, atol=1e-12)
    back = GOAL.copy()
    back[:3, 3] -= 0.35 * GOAL[:3, 2]
    np.testing.assert_allclose(posed(RelativeStart("back", distance=0.35)), back, atol=1e-12)
    round_ = TARGET @ turned(Rotation.from_euler("x", 25.0, degrees=True)) @ np.linalg.inv(TARGET)
    np.testing.assert_allclose(posed(RelativeStart("plane", angle=25.0)), round_ @ GOAL, atol=1e-12)


LOOKING = RelativeStart("looking", box=(0.3, 0.2, 0.1), radii=(0.05, 0.15), turn=100.0, of=21)


def test_it_looks_at_points_of_circles_from_within_a_box_turned_evenly():
    places, points, spun = [], [], []
    for seed in range(200):
        pose = posed(LOOKING, seed)
        places.append(GOAL[:3, :3].T @ (pose[:3, 3] - GOAL[:3, 3]))
        place, ray = (np.linalg.inv(TARGET) @ pose)[:3, 3], TARGET[:3, :3].T @ pose[:3, 2]
        hit = place - ray * place[2] / ray[2]  # where the optical axis meets the target's plane
        points.append(hit[:2])
        level = np.cross(pose[:3, 2], np.cross(GOAL[:3, 0], pose[:3, 2]))
        level /= np.linalg.norm(level)  # the goal's right, square to the optical axis
        spun.append(np.degrees(np.arctan2(np.cross(level, pose[:3, 0]) @ pose[:3, 2],
                                          level @ pose[:3, 0])))
    places, points = np.array(places), np.array(points)
    for values, most in zip(places.T, LOOKING.box, strict=True):
        assert -most <= values.min() < -0.95 * most and 0.95 * most < values.max() <= most
    radii = np.round(np.hypot(*points.T), 9)
    assert set(radii) == {0.05, 0.15} and 70 < (radii == 0.05).sum() < 130
    around = np.arctan2(*points.T[::-1])
    assert np.histogram(around, bins=4, range=(-np.pi, np.pi))[0].min() > 30
    wanted = [-100.0 + 10.0 * (seed % 21) for seed in range(200)]
    np.testing.assert_allclose(spun, wanted, atol=1e-6)
    alone = RelativeStart("looking", of=1, turn=30.0, box=(0.0, 0.0, 0.0))
    assert np.array_equal(posed(alone, 3)[:3, 3].round(12), GOAL[:3, 3].round(12))


@pytest.mark.parametrize(("offset", "turn"), [(0.02, 0.0), (0.0, 5.0)])
def test_scatter_is_along_and_about_each_axis(offset, turn):
    start = RelativeStart("back", distance=0.1, scatter=(offset, turn))
    plain = posed(RelativeStart("back", distance=0.1))
    moved = [np.linalg.inv(plain) @ posed(start, seed) for seed in range(150)]
    shifts = np.array([pose[:3, 3] for pose in moved])
    turns = Rotation.from_matrix([pose[:3, :3] for pose in moved]).as_rotvec(degrees=True)
    # The exponential's shift is bent by half a turn of 9 degrees at most.
    for values, most, slack in ((shifts, offset, 0.2 * offset), (turns, turn, 1e-9)):
        assert np.abs(values).max() <= most + slack + 1e-12
        for column in values.T:
            assert column.min() <= 1e-12 - 0.9 * most and column.max() >= 0.9 * most - 1e-12
    np.testing.assert_array_equal(posed(start, 7), posed(start, 7))
    assert np.abs(posed(start, 7) - posed(start, 8)).max() > 1e-4


def test_an_experiment_starts_about_its_goal_s_pose():
    goal, target = (0.1, -0.2, 0.9, np.pi - 0.1, 0.2, 0.4), (0.3, 0.1, 0.2, 0.1, -0.2, 0.5)
    start = RelativeStart("plane", angle=25.0, scatter=(0.01, 1.0))
    asked = Experiment(plant="free", goal={"pose": goal}, start=start, seed=9,
                       target={"shape": "square", "pose": target})  # fmt: skip
    assert asked.with_absolute_start.start.pose == start.compute_pose(GOAL, TARGET, 9)
    assert asked.with_absolute_start.with_absolute_start == asked.with_absolute_start
    with pytest.raises(ExperimentError, match="'back' is relative to the goal pose: set goal"):
        assemble(Experiment(start=RelativeStart("back")))
