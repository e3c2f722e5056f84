"""Broyden's estimate of L: it converges to the true L, needs no model, and can be reset."""


import numpy as np
import pytest
from loop_rig import STARTS, Rig, an_image, an_output, the_servo

from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.features.moments import ImageMoments
from aras_visual_servo_controller.laws import Proportional
from aras_visual_servo_controller.schemes import FeatureScheme, create_scheme
from aras_visual_servo_controller.schemes.broyden_estimator import BroydenEstimator

DT = 1.0 / 30.0


def image(stamp, twist, dt=DT):
    return an_image(stamp, dt, twist)


def seen(error, L, error_drift=0.0):
    return an_output(error, L, error_drift=error_drift)


def learnt(count=400, gain=1.0, error_drift=0.0, seed=0):
    """Truth and estimate after `count` random motions; the estimate began somewhere else."""
    random = np.random.default_rng(seed)
    truth, wrong = random.normal(size=(2, 4, 6))
    estimator, error = BroydenEstimator(gain), np.zeros(4)
    for k in range(count):
        twist = 0.02 * random.normal(size=6)
        if k:
            error = error + truth @ twist + error_drift * DT
        found = estimator(image(k * DT, twist), seen(error, wrong, error_drift))
        if k == 0:
            assert (found == wrong).all()
    return truth, found


@pytest.mark.parametrize("seed", range(3))
def test_it_comes_to_the_true_one(seed):
    truth, found = learnt(seed=seed)
    np.testing.assert_allclose(found, truth, atol=0.03)


def test_a_target_that_moves_is_taken_out():
    truth, found = learnt(error_drift=np.array([0.3, -0.2, 0.1, 0.5]))
    np.testing.assert_allclose(found, truth, atol=0.03)


def test_one_motion_changes_no_more_than_it_showed():
    truth, wrong = np.arange(24.0).reshape(4, 6) - 10.0, np.zeros((4, 6))
    estimator = BroydenEstimator(gain=1.0, floor=1e-9)
    estimator(image(0.0, np.zeros(6)), seen(np.zeros(4), wrong))
    twist = np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.01])
    found = estimator(image(DT, twist), seen(truth @ twist, wrong))
    np.testing.assert_allclose(found @ twist, truth @ twist, rtol=1e-6)
    assert np.abs(found[:, 1:5]).max() < 1e-9
    # a radian weighs as 0.3 m, squared
    np.testing.assert_allclose(found[:, 5], 0.09 * found[:, 0], rtol=1e-9)
    every = BroydenEstimator(gain=1.0, floor=1e-9, start=wrong)
    every(image(0.0, np.zeros(6)), seen(np.zeros(4), wrong))
    all_ways = 0.01 * np.ones(6)
    found = every(image(DT, all_ways), seen(truth @ all_ways, wrong))
    weights = [1.0, 1.0, 1.0, 0.09, 0.09, 0.09]
    np.testing.assert_allclose(found, np.outer(found[:, 0], weights), rtol=1e-9)
    half = BroydenEstimator(floor=1e-9, start=wrong)
    half(image(0.0, np.zeros(6)), seen(np.zeros(4), truth))
    found = half(image(DT, twist), seen(truth @ twist, truth))
    np.testing.assert_allclose(found @ twist, 0.5 * (truth @ twist), rtol=1e-6)


def test_small_motions_wraps_and_gaps_teach_nothing():
    L = np.ones((1, 6))
    along = 0.01 * np.eye(6)[0]
    for twist, error, second in (
        (1e-6 * along, [0.5], image(DT, 1e-6 * along)),  # noise
        (along, [3.0], image(DT, along)),  # an angle that wrapped
        (along, [0.5], image(5 * DT, along)),  # its image before was not measured
        (along, [0.5], image(DT, along, dt=2 * DT)),  # nor is this the one since which it moved
        (along, [0.5], image(2 * DT, along, dt=DT)),
        (along, [0.5, 0.5], image(DT, along)),  # of another length
    ):
        estimator = BroydenEstimator(1.0)
        estimator(image(0.0, twist), seen([0.0], L))
        found = estimator(second, seen(error, np.ones((len(error), 6))))
        np.testing.assert_allclose(found, 1.0, atol=1e-2)


@pytest.mark.parametrize(("jump", "learnt"), [(1.0, True), (-1.0, True), (1.01, False)])
def test_what_changes_by_more_than_any_camera_makes_is_not_learnt(jump, learnt):
    """Of the feature whose change is the greatest, up or down."""
    estimator = BroydenEstimator(1.0, floor=1e-9)
    along = 0.1 * np.eye(6)[1]
    estimator(image(0.0, along), seen([0.5, 0.2], np.zeros((2, 6))))
    found = estimator(image(DT, along), seen([0.5 + jump, 0.25], np.zeros((2, 6))))
    expected = [10.0 * jump, 0.5] if learnt else [0.0, 0.0]
    np.testing.assert_allclose(found[:, 1], expected, rtol=1e-6)
    assert not found[:, [0, 2, 3, 4, 5]].any()


def test_it_needs_no_more_than_its_name():
    scheme = create_scheme("moments", Proportional(5.0), interaction="estimated")
    rig = Rig(the_servo(scheme=scheme, hold=1.0), STARTS["2016"])
    assert rig.run(4.0)[-1].outcome == "converged" and rig.missed[0] < 0.2e-3


def test_an_estimator_of_ones_own_and_for_nothing_else():
    mine = lambda observation, measured: 2.0 * measured.L  # noqa: E731
    scheme = FeatureScheme(ImageMoments(), Proportional(5.0), "estimated", estimator=mine)
    states = Rig(the_servo(scheme=scheme), STARTS["2016"]).run(0.2)
    plain = Rig(the_servo(), STARTS["2016"]).run(0.2)
    np.testing.assert_allclose(
        2.0 * states[0].desired_twist[:3], plain[0].desired_twist[:3], rtol=0.05
    )
    with pytest.raises(ConfigurationError, match="can be used only with interaction 'estimated'"):
        FeatureScheme(ImageMoments(), estimator=mine)
