"""Control laws: error rates, internal state, reset, and invalid arguments."""

import numpy as np
import pytest

from aras_visual_servo_base.registry import list_parameters
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.laws import LAWS, create_law
from aras_visual_servo_controller.laws.adaptive import Adaptive
from aras_visual_servo_controller.laws.diagonal import Diagonal
from aras_visual_servo_controller.laws.pi import ProportionalIntegral
from aras_visual_servo_controller.laws.proportional import Proportional
from aras_visual_servo_controller.laws.sliding_mode import SlidingMode
from aras_visual_servo_controller.laws.wrappers import ContinuousStart, Ramp

E = np.array([0.2, -0.1, 0.04])
L = np.random.default_rng(0).normal(size=(3, 6))
ROTATED = np.linalg.pinv(L) @ E
DT = 1 / 30


def rate(law, error=E, t=0.0, dt=DT, rotated=ROTATED):
    return law.desired_error_rate(np.asarray(error, float), L, rotated, t, dt)


def of_adaptive(size, sign):
    """ViSP's gain, of the largest component, and the rate by it."""
    rotated = np.array([0.0, 0.0, sign * size, 0.5 * size, 0.0, -0.2 * size])
    gain = (4.0 - 0.4) * np.exp(-30.0 * size / (4.0 - 0.4)) + 0.4
    return Adaptive(4.0, 0.4, 30.0), rotated, -gain * E


@pytest.mark.parametrize(("law", "rotated", "expected"), [
    (Proportional(3.0), ROTATED, -3.0 * E),
    (Diagonal([1.0, 2.0, 30.0]), ROTATED, [-0.2, 0.2, -1.2]),
    (SlidingMode(3.0, 0.02, 0.1), ROTATED, -3.0 * E - 0.02 * np.array([1.0, -1.0, 0.4])),
    (SlidingMode(3.0, 0.02, 0.05), ROTATED, -3.0 * E - 0.02 * np.array([1.0, -1.0, 0.8])),
    of_adaptive(0.0, 1.0), of_adaptive(0.01, -1.0), of_adaptive(0.07, 1.0), of_adaptive(5.0, -1.0),
])  # fmt: skip
def test_the_rate_of_each_law(law, rotated, expected):
    np.testing.assert_allclose(rate(law, rotated=rotated), expected, atol=1e-15)


def test_pi_takes_away_what_a_steady_drift_leaves():
    """e_dot = drift + law: proportional alone stays behind by drift / gain."""
    drift = np.array([0.05])
    for law, left in ((Proportional(4.0), 0.0125), (ProportionalIntegral(4.0, 2.0), 0.0)):
        e = np.array([0.1])
        for i in range(600):
            e = e + DT * (
                drift + law.desired_error_rate(e, np.zeros((1, 6)), np.zeros(6), i * DT, DT))
        assert e[0] == pytest.approx(left, abs=2e-4)


@pytest.mark.parametrize(("bound", "most"), [({"bound": 0.5}, 1.0), ({}, 2.0)])
def test_the_integral_is_that_of_the_error_is_bounded_and_is_reset(bound, most):
    """By bound x gain x the greatest error; without a bound as much as the gain's part."""
    law = ProportionalIntegral(2.0, 3.0, **bound)
    np.testing.assert_allclose(rate(law, t=0.0, dt=0.0), -2.0 * E)
    np.testing.assert_allclose(rate(law, dt=0.1), -2.0 * E - 3.0 * 0.1 * E)
    for error in (0.1 * E, E, 0.01 * E):  # it grows with the error and never shrinks
        for _ in range(300):
            last = rate(law, error, dt=0.1)
    np.testing.assert_allclose(last, -2.0 * 0.01 * E - most * E)
    other = law.desired_error_rate(np.ones(2), L[:2], ROTATED, 0.0, 0.0)
    np.testing.assert_allclose(other, -2.0 * np.ones(2))  # other features: it begins anew
    rate(law, dt=0.1)
    law.reset()
    np.testing.assert_allclose(rate(law, dt=0.0), -2.0 * E)


def test_continuous_start_begins_at_rest_and_ends_as_the_law(begin=7.0):
    law = ContinuousStart(Proportional(2.0), 4.0)
    np.testing.assert_allclose(np.linalg.pinv(L) @ rate(law, t=begin), 0.0, atol=1e-12)
    later = rate(law, 0.5 * E, t=begin + 0.25, rotated=0.5 * ROTATED)
    np.testing.assert_allclose(later, -2.0 * (0.5 * E - np.exp(-1.0) * L @ ROTATED))
    np.testing.assert_allclose(rate(law, t=begin + 10.0), -2.0 * E, rtol=1e-9)
    ramp = Ramp(Proportional(2.0), 0.5)
    np.testing.assert_allclose(rate(ramp, t=begin), 0.0)
    np.testing.assert_allclose(rate(ramp, t=begin + 0.5), -2.0 * (1 - np.exp(-1.0)) * E)
    for one in (law, ramp):
        one.reset()
        np.testing.assert_allclose(np.linalg.pinv(L) @ rate(one, t=begin + 11.0), 0.0, atol=1e-12)


@pytest.mark.parametrize("wrapper", [ContinuousStart, Ramp])
def test_wrappers_hand_the_law_inside_what_they_got_and_reset_it(wrapper):
    class Inside(ProportionalIntegral):
        def desired_error_rate(self, *given):
            self.given = given
            return super().desired_error_rate(*given)

    inside = Inside(2.0, 3.0)
    wrapped = wrapper(inside, 1.0)
    rate(wrapped, t=3.0, dt=0.25)
    rate(wrapped, t=80.0, dt=0.25)  # late: what the start changed is forgotten
    for got, wanted in zip(inside.given, (E, L, ROTATED, 80.0, 0.25), strict=True):
        np.testing.assert_allclose(got, wanted)
    wrapped.reset()
    np.testing.assert_allclose(rate(inside, dt=0.0), -2.0 * E)
    # A clock that was set back a little neither turns the motion round nor makes it larger.
    law = wrapper(Proportional(2.0))
    rate(law, t=4.0)
    np.testing.assert_allclose(rate(law, t=3.5), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_is_made_by_name_and_forgets_the_previous_run_when_it_is_reset(name):
    gains = {"values": [1.0, 2.0, 3.0]} if name == "diagonal" else {}
    law = create_law(name, continuous_start=4.0, ramp=0.1, **gains)
    assert isinstance(law, ContinuousStart) and isinstance(law.law, Ramp)
    answer = rate(law, t=1.0)
    assert answer.shape == (3,) and np.isfinite(answer).all()
    law, new = create_law(name, **gains), create_law(name, **gains)
    assert type(law) is LAWS[name] and (law.list_tunable_parameters() or name == "diagonal")
    times = ((0.0, 0.0), (1.0, 1.0), (2.0, 1.0))
    for t, dt in times:
        rate(law, t=t, dt=dt)
    law.reset()
    for t, dt in times:
        np.testing.assert_array_equal(rate(law, -0.5 * E, t, dt), rate(new, -0.5 * E, t, dt))


NUMBERS = [
    (law, parameter.name)
    for law in (Proportional, Adaptive, ProportionalIntegral, SlidingMode, ContinuousStart, Ramp)
    for parameter in list_parameters(law)
]


@pytest.mark.parametrize(("law", "argument"), NUMBERS)
def test_every_number_of_a_law_has_to_be_one_above_0(law, argument):
    inside = (Proportional(),) if law in (ContinuousStart, Ramp) else ()
    wanted = rf"{argument} is .*, must be (> 0|a finite number)"
    for value in (0.0, -2.0, np.nan, np.inf, True, "five"):
        with pytest.raises(ConfigurationError, match=wanted):
            law(*inside, **{argument: value})


@pytest.mark.parametrize(("law", "gains", "most"), [
    ("proportional", "gain", np.float64(1000.0)), ("pi", "gain", 1000.0),
    ("adaptive", "zero", 1000.0), ("diagonal", "values", [1000.0]),
])  # fmt: skip
def test_gains_up_to_a_thousand_are_taken(law, gains, most):
    create_law(law, **{gains: most})
    with pytest.raises(ConfigurationError, match="must be <= 1000 1/s"):
        create_law(law, **{gains: [1001.0] if law == "diagonal" else 1001.0})


@pytest.mark.parametrize(("make", "words"), [
    (lambda: Adaptive(1.0, 2.0), "must be greater than the parameter infinity"),
    (lambda: Adaptive(2.0, 2.0), "must be greater than the parameter infinity"),
    (lambda: Diagonal([]), "values is empty"),
    (lambda: Diagonal([1.0, 0.0]), r"values\[1\] is 0.0"),
    (lambda: rate(Diagonal([1.0, 2.0])), "has 2 gains, must have one for each"),
    (lambda: SlidingMode(gain=500.0, reach=5.1, width=0.01),
     "is 1010 1/s, must be <= 1000 1/s: raise width"),
    (lambda: create_law("proportionl"), "did you mean 'proportional'"),
    (lambda: create_law("proportional", gian=3.0), "takes no 'gian': did you mean 'gain'"),
    (lambda: create_law("diagonal"), "law 'diagonal': missing a required argument: 'values'"),
    (lambda: create_law("numpy:ndarray"), "not a class derived from Law"),
])  # fmt: skip
def test_laws_that_there_are_not(make, words):
    with pytest.raises(ConfigurationError, match=words):
        make()
    SlidingMode(gain=500.0, reach=5.0, width=0.01)


@pytest.mark.parametrize(("law", "gains", "words"), [
    (Proportional(2.0), {"gain": 0.0}, "gain is 0.0"),
    (Adaptive(5.0, 2.0), {"zero": 1.0}, "zero is 1 1/s, must be greater than the parameter infin"),
    (Adaptive(5.0, 2.0), {"slope": 7.0, "infinity": 5.0}, "must be greater"),
    (ProportionalIntegral(), {"integral": -1.0}, "integral is -1.0"),
    (SlidingMode(), {"width": 1e-5}, "raise width"),
    (ContinuousStart(Proportional()), {"mu": 0.0}, "mu is 0.0"),
    (Ramp(Proportional()), {"time": -1.0}, "time is -1.0"),
])  # fmt: skip
def test_gains_that_cannot_be_are_refused_while_it_runs_and_the_old_ones_stay(law, gains, words):
    before = {name: getattr(law, name) for name in law.list_tunable_parameters()}
    with pytest.raises(ConfigurationError, match=words):
        law.set_parameters(**gains)
    assert {name: getattr(law, name) for name in law.list_tunable_parameters()} == before
    law = Proportional(2.0)
    law.set_parameters(gain=4)
    assert isinstance(law.gain, float) and rate(law) == pytest.approx(-4.0 * E)
