"""Changes of features between images, compared with L: jumps, errors, occlusions."""

import numpy as np
import pytest
from loop_rig import an_image, an_output

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.diagnosis.step_check import StepCheck, predict_distance
from aras_visual_servo_controller.goals.goal import Goal

DT, COUNT = 1 / 30, 3
ANGLES = np.zeros(COUNT, bool)
TOLERANCES = np.full(COUNT, 1e-3)
OUTLINE = np.array([[-0.1, -0.08], [0.1, -0.09], [0.08, 0.1], [-0.07, 0.06]])
GOAL = Goal(
    moments=Moments.from_polygon(OUTLINE), depth=0.4,
    world_T_camera=matrix_from_xyz_rpy((0, 0, 1), (0,) * 3),
)  # fmt: skip


def followed(images, error_of, check=None, rests=0):
    """A check that has followed features, error_of(k, error by L and the camera's motion), of a
    camera that first rests for some images."""
    check, draw = check or StepCheck(), np.random.default_rng(3)
    L, told = draw.normal(size=(COUNT, 6)), np.zeros(COUNT)
    for k in range(images):
        motion = 4e-3 * np.cos([0.1 * k, 0.3, 0.2 * k, 0.0, 0.0, 0.1]) * (k >= rests)
        told = told + L @ motion * (k > 0)
        decision = an_output(error_of(k, told), L, names=("x", "y", "size"))
        check.add(decision, an_image(k * DT, DT, motion), TOLERANCES, ANGLES)
    return check


def test_features_that_move_as_the_camera_says_are_no_one_s_fault():
    draw = np.random.default_rng(5)
    check = followed(60, lambda k, told: told + 1e-3 * draw.normal(size=COUNT))
    assert check.correlation > 0.98 and check.feature_correlations.min() > 0.9
    assert (
        check.unchanged_since is None and check.first_jump is None and not check.has_frequent_jumps
    )


def test_features_that_stay_the_same_before_a_camera_that_moves_are_noted_with_their_beginning():
    check = followed(30, lambda k, told: told if k < 10 else np.full(COUNT, 0.05))
    assert check.unchanged_since == pytest.approx(10 * DT)
    assert followed(31, lambda k, told: told, check).unchanged_since is None


def test_a_jump_is_reported_with_its_feature_its_size_and_its_time():
    check = followed(40, lambda k, told: told + [0.0, 0.3 * (k >= 20), 0.0])
    jump = check.first_jump
    assert (jump.feature, len(check.jumps)) == ("y", 1) and not check.has_frequent_jumps
    assert jump.stamp == pytest.approx(20 * DT) and jump.size == pytest.approx(0.3, abs=0.05)
    assert str(jump).endswith("at 0.67 s, but L and the camera's motion explain only 0.018")
    assert followed(60, lambda k, told: told + [0.3 * (k % 12 > 6), 0, 0]).has_frequent_jumps


def test_the_motion_of_a_target_that_runs_away_is_known_also_once_it_is_lost():
    check = followed(20, lambda k, told: told + [0.4 * max(k - 12, 0), 0.0, 0.0])
    check.interrupt()
    assert check.target_motion_part > 0.9
    assert followed(20, lambda k, told: told).target_motion_part == 0.0
    assert followed(1, lambda k, told: told, check).target_motion_part == 0.0  # it is visible again


def test_features_that_move_on_before_a_camera_at_rest_drift():
    drifting = followed(30, lambda k, told: told + 1e-3 * k, rests=8)
    assert drifting.has_drift
    draw = np.random.default_rng(5)
    noisy = followed(30, lambda k, told: told + 5e-3 * draw.normal(size=COUNT), rests=30)
    assert not noisy.has_drift
    assert not followed(30, lambda k, told: told, rests=8).has_drift
    assert not followed(30, lambda k, told: told + 1e-3 * k).has_drift  # it never rested


@pytest.mark.parametrize("feature", range(COUNT))
def test_a_feature_with_the_wrong_sign_moves_against_its_l(feature):
    signs = np.where(np.arange(COUNT) == feature, -1.0, 1.0)
    against = followed(60, lambda k, told: signs * told).feature_correlations
    assert against[feature] < -0.95 and np.delete(against, feature).min() > 0.95


def view(area, stamp=0.0, height=1.0, touched_borders=()):
    """An observation of the goal's target, of which a part is visible."""
    return an_image(
        stamp, DT, moments=Moments.from_polygon(np.sqrt(area) * OUTLINE),
        touched_borders=touched_borders,
        world_T_camera=matrix_from_xyz_rpy((0, 0, height), (0,) * 3),
    )  # fmt: skip


def test_a_part_that_disappears_inside_the_image_is_covered_until_it_comes_back():
    check = StepCheck()
    for k, area in enumerate([1.0] * 10 + [0.7] * 10):
        check.add_area(view(area, k * DT), GOAL)
    assert check.occluded_since == pytest.approx(10 * DT) and check.visible_part == pytest.approx(
        0.7
    )
    check.add_area(view(1.0, 1.0), GOAL)
    assert check.occluded_since is None


@pytest.mark.parametrize("seen", [
    [view(1.0 - 0.02 * k) for k in range(20)],  # the camera goes away, step by step
    [view(1.0 + 0.3 * (-1) ** k) for k in range(40)],  # noise
    [view(1.0)] * 10 + [view(0.6, touched_borders=("left",))] * 10,
    [view(1.0)] * 10 + [view(0.7)] + [view(1.0)] * 10,  # one bad image
    [view(1.0)] * 10 + [view(0.7, height=0.9)] * 10,  # it went back by as much
])  # fmt: skip
def test_what_is_not_covered(seen):
    check = StepCheck()
    for observation in seen:
        check.add_area(observation, GOAL)
    assert check.occluded_since is None


def test_the_distance_by_kinematics_is_that_along_the_optical_axis():
    assert predict_distance(matrix_from_xyz_rpy((0.1, 0, 0.8), (0,) * 3), GOAL) == pytest.approx(
        1.5
    )
    assert predict_distance(None, GOAL) == 1.0
