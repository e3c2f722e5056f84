"""Gains of the laws."""

import numpy as np
import pytest

from aras_visual_servo_controller.before.laws import Adaptive, Diagonal, Proportional
from aras_visual_servo_controller.errors import ConfigurationError

ERROR = np.array([0.2, -0.1])
L = np.array([[-1.0, 0.0, 0.5], [0.0, -2.0, 0.1]])


@pytest.mark.parametrize("law", [Proportional(2.0), Adaptive(), Diagonal([1.0, 4.0])])
def test_features_decay_at_the_gain(law):
    v = law.velocity(L, ERROR, elapsed=10.0)
    np.testing.assert_allclose(L @ v, -law.gain(ERROR, 10.0) * ERROR)


def test_ramp_begins_at_zero_and_ends_at_the_gain():
    law = Proportional(3.0, ramp=0.1)
    assert law.gain(ERROR, 0.0)[0] == 0.0
    assert law.gain(ERROR, 0.1)[0] == pytest.approx(3.0 * (1 - np.exp(-1)))
    assert law.gain(ERROR, 9.0)[0] == pytest.approx(3.0)


def test_adaptive_gain_has_its_limits_and_slope():
    law = Adaptive(zero=5.0, infinity=2.0, slope=30.0)
    assert law.gain(np.zeros(2), 0.0)[0] == pytest.approx(5.0)
    assert law.gain(np.full(2, 10.0), 0.0)[0] == pytest.approx(2.0)
    rise = (law.gain(np.full(2, 1e-6), 0.0)[0] - 5.0) / 1e-6
    assert rise == pytest.approx(-30.0, rel=1e-3)


def test_wrong_gains_are_refused():
    for make in (
        lambda: Proportional(-1.0),
        lambda: Proportional(float("nan")),
        lambda: Proportional(1.0, ramp=-0.1),
        lambda: Adaptive(zero=1.0, infinity=2.0),
        lambda: Diagonal([1.0, 0.0]),
        lambda: Diagonal([1.0]).gain(ERROR, 0.0),
    ):
        with pytest.raises(ConfigurationError):
            make()
