"""Checks of the error over time: oscillation, and whether the target can be the goal's target."""

import numpy as np
import pytest
from loop_rig import an_image, scaled

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.diagnosis.diagnoses.wrong_object import ShapeCheck
from aras_visual_servo_controller.diagnosis.oscillation_check import OscillationCheck
from aras_visual_servo_controller.goals.goal import Goal

# -- does it ring? -------------------------------------------------------------------------------


def zigzag(*extremes, half=0.3, rate=100.0):
    """[(stamp, error)] of straight lines from one extreme to the next, `half` seconds each."""
    stamps = np.arange(0.0, half * (len(extremes) - 1) + 1e-9, 1.0 / rate)
    return list(zip(stamps, np.interp(stamps, half * np.arange(len(extremes)), extremes),
                    strict=True))  # fmt: skip


def rings(samples, beside=lambda t: 0.0):
    """Return what OscillationCheck reports at the end for an error, next to another error."""
    answers = []
    for place in (0, 1):
        oscillation = OscillationCheck()
        for t, e in samples:
            both = (e, beside(t)) if place == 0 else (beside(t), e)
            answer = oscillation.add(t, np.array(both))
        answers.append(answer)
    assert answers[0] == answers[1]
    return answers[0]


@pytest.mark.parametrize("half", [0.2, 0.3])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_frequency_of_five_swings_is_told(half, sign):
    """To a twentieth: the wave that is laid through them may begin and end anywhere."""
    assert rings(zigzag(*sign * np.array([0, 9, 0, 9, 0, 9.0]), half=half)) == pytest.approx(
        0.5 / half, rel=0.055
    )


@pytest.mark.parametrize(("frequency", "seconds"), [
    (0.25, 14.0), (0.7, 6.0), (2.0, 3.0), (3.7, 3.0), (6.3, 3.0),
])  # fmt: skip
def test_the_frequency_of_a_lasting_wave_is_told_to_a_hundredth(frequency, seconds):
    times = 50.0 + np.arange(0.0, seconds, 1.0 / 30.0)
    wave = list(zip(times, 9.0 * np.sin(2.0 * np.pi * frequency * times), strict=True))
    assert rings(wave) == pytest.approx(frequency, rel=0.01)


def test_a_wave_is_told_beside_a_drift_from_twelve_images_on_and_no_longer_once_it_has_ended():
    times = np.arange(0.0, 2.0, 1.0 / 30.0)
    drifting = 20.0 * times + 9.0 * np.sin(4.0 * np.pi * times)
    assert rings(list(zip(times, drifting, strict=True))) == pytest.approx(2.0, rel=0.02)
    few = [(0.1 * k, 9.0 * np.sin(0.5 * np.pi * k)) for k in range(12)]
    assert rings(few) == pytest.approx(2.5) and rings(few[:-1]) is None
    swings = 0, 9, 0, 9, 0, 9, 4
    assert rings(zigzag(*swings, half=0.2)) is not None
    assert rings(zigzag(*swings, 4, half=0.2)) is None  # for 0.4 s


def test_a_wave_that_something_else_went_before_is_told_once_it_lasts():
    """Of five seconds two swung from stop to stop; in the last two there are too few swings."""
    times = np.arange(0.0, 5.0, 1.0 / 30.0)
    stops = 15.0 * np.sign(np.sin(2.0 * np.pi * 1.3 * times))
    later = 12.0 * np.sin(2.0 * np.pi * 0.8 * times)
    samples = list(zip(times, np.where(times < 2.0, stops, later), strict=True))
    assert rings(samples) == pytest.approx(0.8, rel=0.01)


@pytest.mark.parametrize(("span", "frequency"), [(2.0, 2.0), (5.0, 0.75), (12.0, 0.28)])
def test_a_swing_after_a_great_step_is_told_once_the_step_is_long_enough_ago(span, frequency):
    """Beside a step no swing stands out: how far back is looked depends on how slow it is."""
    oscillation, told = OscillationCheck(), None
    for t in np.arange(-0.5, 14.0, 1.0 / 30.0):
        error = 9.0 * np.sin(2.0 * np.pi * frequency * t) if t >= 0.0 else 90.0
        if oscillation.add(t, np.array([error])) is not None:
            told = t
            break
    assert told == pytest.approx(span + 0.2, abs=0.25)


@pytest.mark.parametrize("phase", [0.0, 0.25])
def test_of_few_images_a_wave_that_grows_from_nothing_is_told(phase):
    times = np.arange(29) / 30.0
    turns = 4.0 * (times - times.mean()) / times[-1] + phase
    growing = 200.0 * times * np.sin(2.0 * np.pi * turns)
    assert rings(list(zip(times, growing, strict=True))) == pytest.approx(30 / 7, rel=0.03)


def test_five_swings_that_take_longer_than_twelve_seconds_are_none():
    oscillation = OscillationCheck()
    for t in np.arange(0.0, 24.0, 1.0 / 30.0):
        assert oscillation.add(t, np.array([9.0 * np.sin(2.0 * np.pi * 0.15 * t)])) is None


def test_five_reversals_are_needed():
    assert rings(zigzag(0, 9, 0, 9, 0)) is None
    assert rings(zigzag(0, 9, 0, 9, 0, 5.5)) is None  # the fifth is no longer than noise
    assert rings(zigzag(0, 9, 0, 9, 0, 6.5)) is not None


def test_what_is_no_longer_than_noise_is_no_reversal():
    assert rings(zigzag(0, 5.8, 0, 5.8, 0, 5.8, 0, half=0.2)) is None
    assert rings(zigzag(0, 6.2, 0, 6.2, 0, 6.2, 0, half=0.2)) is not None
    # nor does a step of noise on the way end the swing
    assert rings(zigzag(0, 9, 5, 14, 0, 9, 0, half=0.2)) is None


def test_the_loudest_of_the_later_half_is_looked_at():
    ringing = zigzag(0, 9, 0, 9, 0, 9)
    assert rings(ringing, lambda t: 50.0 * (t < 0.7)) is not None
    assert rings(ringing, lambda t: 50.0 * (t > 1.2)) is None  # that one makes a single step
    assert rings(ringing, lambda t: 8.0 * (t > 1.2)) is not None


@pytest.mark.parametrize(
    "error",
    [
        lambda t: 10.0 * np.exp(-3 * t),
        lambda t: 30.0 * np.exp(-2 * t) * np.cos(6.0 * t),  # dies away
        lambda t: 2.0 * np.sin(20.0 * t),  # no louder than noise
        lambda t: 40.0 * (t < 1.0),  # the target was moved
    ],
)
def test_what_dies_away_or_is_quiet_is_no_oscillation(error):
    oscillation = OscillationCheck()
    assert all(oscillation.add(t, np.array([error(t)])) is None for t in np.arange(0, 4, 1 / 30))


@pytest.mark.parametrize("way", ["at rest", "approaching", "following"])
@pytest.mark.parametrize("seed", range(2))
def test_noise_that_is_louder_than_the_tolerances_is_no_oscillation(way, seed):
    random, oscillation = np.random.default_rng(seed), OscillationCheck()
    error = 0.0
    for k, noise in enumerate(random.normal(0.0, 8.0, (400, 2))):
        if way == "following":  # a loop that moves by what noise it saw
            error = 0.9 * error + 0.3 * noise[0]
        elif way == "approaching":
            error = 60.0 * np.exp(-k / 60.0)
        assert oscillation.add(k / 30.0, error + noise) is None


@pytest.mark.parametrize(("half", "heights", "swings", "grows"), [
    (4, (9, -9, 9, -9), True, False), (3, (9, -9, 9, -9), False, False),  # noise is as quick
    (4, (8, -9, 10, -11), True, True), (4, (8, -9, 10, -10), True, False),
    (4, (20, 9, 20, 9), False, False), (4, (1, -1, 1, -1), False, False),
])  # fmt: skip
def test_swings_too_seldom_for_a_frequency_are_told(half, heights, swings, grows):
    oscillation = OscillationCheck()
    for t, e in zigzag(*heights, half=0.3 * half, rate=1.0 / 0.3):
        assert oscillation.add(t, np.array([e, 0.0])) is None
    assert (oscillation.is_oscillating, oscillation.is_growing) == (swings, grows)


@pytest.mark.parametrize("growth", [0.0, 2.0])
def test_an_oscillation_is_told_in_noise_and_while_it_grows(growth):
    random, oscillation = np.random.default_rng(1), OscillationCheck()
    found = None
    for t in np.arange(0.0, 2.5, 1 / 30):
        wave = 12.0 * np.exp(growth * (t - 1.0)) * np.sin(2 * np.pi * 2.5 * t)
        found = oscillation.add(t, np.array([wave + random.normal(0.0, 3.0)]))
    assert found == pytest.approx(2.5, rel=0.1)


# -- is it the target? -----------------------------------------------------------

CORNERS = np.array([[-0.10, -0.05], [0.12, -0.04], [0.08, 0.06], [-0.03, 0.09]])


def of(corners):
    return Moments.from_polygon(np.asarray(corners), 4)


def said_of(evidence, seen, wanted, count=3):
    """Return what is reported after each of `count` images."""
    see = an_image(0.0, 0.1, moments=seen)
    return [evidence.add(see, Goal(moments=wanted)) for _ in range(count)]


def test_three_strange_images_must_follow_each_other():
    wanted, other = of(CORNERS), of(CORNERS * [1.0, 0.2])
    for evidence in (ShapeCheck(),):
        assert not any(said_of(evidence, other, wanted, 2))
        assert not any(said_of(evidence, wanted, wanted, 1))
        assert not any(said_of(evidence, other, wanted, 2))
        assert all(said_of(evidence, other, wanted, 2))


def test_what_cannot_be_compared_is_not_judged():
    wanted, other = of(CORNERS), of(CORNERS * [1.0, 3.0])
    points = Moments.from_points(CORNERS * [1.0, 3.0], 4)
    for seen, goal in ((None, wanted), (other, None), (points, wanted)):
        assert not any(said_of(ShapeCheck(), seen, goal, 5))


@pytest.mark.parametrize(("factor", "strange"), [(1.2, False), (1.3, True)])
def test_how_spread_out_the_target_may_be(factor, strange):
    """Second moments that grow by a factor where the area stays: a ring for a disc, or back."""
    wanted = of(CORNERS)
    for by, seen in ((factor, wanted), (1.0 / factor, scaled(wanted, 2.0))):
        centred = seen.centred.copy()
        for i, j in ((2, 0), (1, 1), (0, 2)):
            centred[i, j] *= by
        spread = Moments(4, "dense", seen.m00, seen.xg, seen.yg, centred)
        words = said_of(ShapeCheck(), spread, wanted)[-1]
        assert bool(words) is strange
        if strange:
            assert f"its spread is {by:.2f} times" in words and "differs by 0.00" in words


@pytest.mark.parametrize(("longer", "strange"), [(0.27, False), (0.33, True)])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_how_long_the_target_may_be(longer, strange, way):
    def of_length(length):
        centred = np.zeros((5, 5))
        centred[2, 0], centred[0, 2] = 0.5 + 0.5 * length, 0.5 - 0.5 * length
        return Moments(4, "dense", 2.0, 0.0, 0.0, centred)

    words = said_of(ShapeCheck(), of_length(0.5 + way * longer), of_length(0.5))[-1]
    assert bool(words) is strange
    if strange:
        assert f"its elongation differs by {longer:.2f}" in words
