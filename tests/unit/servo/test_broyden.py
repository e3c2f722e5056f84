"""Broyden's estimate of L: it converges to the true L, needs no model, and can be reset."""

import numpy as np
import pytest
from loop_rig import STARTS, Rig, an_image, an_output, the_servo

from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.features.moments import ImageMoments
from aras_visual_servo_controller.laws import Proportional
from aras_visual_servo_controller.schemes import FeatureScheme, create_scheme
from aras_visual_servo_controller.schemes.broyden_estimator import BroydenEstimator

DT, ALONG = 1.0 / 30.0, 0.01 * np.eye(6)


@pytest.mark.parametrize(("seed", "drift"), [(0, 0.0), (1, 0.0), (0, [0.3, -0.2, 0.1, 0.5])])
def test_it_comes_to_the_true_one(seed, drift):
    """The estimate begins somewhere else; the motion of a target is taken out."""
    random, drift = np.random.default_rng(seed), np.array(drift)
    truth, wrong = random.normal(size=(2, 4, 6))
    estimator, error = BroydenEstimator(1.0), np.zeros(4)
    for k in range(400):
        twist = 0.02 * random.normal(size=6)
        if k:
            error = error + truth @ twist + drift * DT
        found = estimator(an_image(k * DT, DT, twist), an_output(error, wrong, error_drift=drift))
        assert k or (found == wrong).all()
    np.testing.assert_allclose(found, truth, atol=0.03)


def second(estimator, L, error, twist=ALONG[0], stamp=DT, dt=DT, begin=0.0):
    """Return the estimate after a second image, whose error is that after a camera's twist (6,)."""
    error = np.asarray(error, float)
    estimator(an_image(0.0, DT, np.zeros(6)), an_output(np.full(len(L), begin), L))
    return estimator(an_image(stamp, dt, twist), an_output(error, np.ones((len(error), 6))))


def test_one_motion_changes_no_more_than_it_showed():
    truth, wrong = np.arange(24.0).reshape(4, 6) - 10.0, np.zeros((4, 6))
    twist = ALONG[0] + ALONG[5]
    found = second(BroydenEstimator(gain=1.0, floor=1e-9), wrong, truth @ twist, twist)
    np.testing.assert_allclose(found @ twist, truth @ twist, rtol=1e-6)
    assert np.abs(found[:, 1:5]).max() < 1e-9
    # a radian weighs as 0.3 m, squared
    np.testing.assert_allclose(found[:, 5], 0.09 * found[:, 0], rtol=1e-9)
    every, all_ways = BroydenEstimator(gain=1.0, floor=1e-9, start=wrong), 0.01 * np.ones(6)
    found = second(every, wrong, truth @ all_ways, all_ways)
    weights = [1.0, 1.0, 1.0, 0.09, 0.09, 0.09]
    np.testing.assert_allclose(found, np.outer(found[:, 0], weights), rtol=1e-9)
    found = second(BroydenEstimator(floor=1e-9, start=wrong), truth, truth @ twist, twist)
    np.testing.assert_allclose(found @ twist, 0.5 * (truth @ twist), rtol=1e-6)


@pytest.mark.parametrize(("error", "image"), [
    ([0.5], {"twist": 1e-6 * ALONG[0]}),  # noise
    ([3.0], {}),  # an angle that wrapped
    ([0.5], {"stamp": 5 * DT}),  # its image before was not measured
    ([0.5], {"dt": 2 * DT}),  # nor is this the one since which it moved
    ([0.5], {"stamp": 2 * DT}), ([0.5, 0.5], {}),  # of another length
])  # fmt: skip
def test_small_motions_wraps_and_gaps_teach_nothing(error, image):
    found = second(BroydenEstimator(1.0), np.ones((1, 6)), error, **image)
    np.testing.assert_allclose(found, np.ones((len(error), 6)), atol=1e-2)


def test_it_needs_no_more_than_its_name_and_may_be_an_estimator_of_ones_own():
    scheme = create_scheme("moments", Proportional(5.0), interaction="estimated")
    rig = Rig(the_servo(scheme=scheme, hold=1.0), STARTS["2016"])
    assert rig.run(4.0)[-1].outcome == "converged" and rig.missed[0] < 0.2e-3
    mine = lambda observation, measured: 2.0 * measured.L  # noqa: E731
    scheme = FeatureScheme(ImageMoments(), Proportional(5.0), "estimated", estimator=mine)
    first, plain = (Rig(servo, STARTS["2016"]).run(0.2)[0].desired_twist[:3]
                    for servo in (the_servo(scheme=scheme), the_servo()))  # fmt: skip
    np.testing.assert_allclose(2.0 * first, plain, rtol=0.05)
    with pytest.raises(ConfigurationError, match="can be used only with interaction 'estimated'"):
        FeatureScheme(ImageMoments(), estimator=mine)
