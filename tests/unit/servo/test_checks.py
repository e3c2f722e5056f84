"""Checks of the error over time: oscillation, and whether the target can be the goal's target."""

from types import SimpleNamespace

import numpy as np
import pytest
from loop_rig import scaled

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.diagnosis.diagnoses.wrong_object import ShapeCheck
from aras_visual_servo_controller.diagnosis.oscillation_check import (
    OscillationCheck,
    _find_dominant_wave,
    _find_largest_error,
    _find_peaks,
)

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


@pytest.mark.parametrize(("shrinks", "rung"), [(0.73, True), (0.68, False)])
def test_it_dies_away_where_two_swings_halve_it(shrinks, rung):
    """Three swings after the first they are compared: 0.73 squared is above a half."""
    swings = 60.0 * shrinks ** np.arange(5)
    extremes = np.cumsum([0.0, *swings * [1, -1, 1, -1, 1]])
    assert (rings(zigzag(*extremes)) is not None) is rung
    # and a half is no less than a half
    for first, rung in ((20, True), (21, False)):
        said = rings(zigzag(0, first, first - 10, first, first - 10, first, half=0.375, rate=16.0))
        assert (said is not None) is rung


def test_the_loudest_of_the_later_half_is_looked_at():
    ringing = zigzag(0, 9, 0, 9, 0, 9)
    assert rings(ringing, lambda t: 50.0 * (t < 0.5)) is not None
    assert rings(ringing, lambda t: 50.0 * (t > 1.2)) is None  # that one makes a single step
    assert rings(ringing, lambda t: 8.0 * (t > 1.2)) is not None


def test_only_the_last_two_seconds_count():
    oscillation = OscillationCheck()
    for t, e in zigzag(0, 9, 0, 9, 0, 9):
        last, answer = t, oscillation.add(t, np.array([e]))
    assert answer is not None
    for k in range(200):
        answer = oscillation.add(last + 0.01 * (k + 1), np.array([9.0]))
    assert answer is None


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


def turning_points(error, least):
    """Indices of the ends of its swings: where it is farthest before a way back of `least`."""
    points, up = [0], 0.0
    for i, now in enumerate(error):
        on = (now - error[points[-1]]) * up
        if up and on >= 0.0:
            points[-1] = i
        elif abs(now - error[points[-1]]) >= least:
            up = np.sign(now - error[points[-1]])
            points.append(i)
    return points


@pytest.mark.parametrize("seed", range(4))
def test_turning_points_are_where_the_way_back_is_long_enough(seed):
    random = np.random.default_rng(seed)
    for _ in range(20):  # whole numbers: some ways are as long as is asked, some errors equal
        error = 7.0 + np.cumsum(random.integers(-3, 4, 40)).astype(float)
        assert _find_peaks(error, 4.0).tolist() == turning_points(error, 4.0)
        errors = random.normal(size=(random.integers(2, 9), 4)) * [1.0, 2.0, 1.0, 2.0]
        assert _find_largest_error(errors) == np.ptp(errors[len(errors) // 2 :], axis=0).argmax()


def best_wave(time, error, about):
    """Return (frequency, residual fraction) of the wave that best explains the error about a line.
    """
    def left(*columns):
        A = np.column_stack(columns)
        A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-9)
        return np.sum((error - A @ np.linalg.lstsq(A, error, rcond=1e-6)[0]) ** 2)

    time = time - time.mean()
    line, found = (np.ones_like(time), time), []
    for frequency in about * np.linspace(0.7, 1.2, 41):
        wave = np.cos(2.0 * np.pi * frequency * time), np.sin(2.0 * np.pi * frequency * time)
        found.append((left(*line, *wave, *time * wave), frequency))
    least, frequency = min(found)
    return frequency, least / left(*line)


@pytest.mark.parametrize("seed", range(4))
def test_the_wave_that_leaves_least_is_found(seed):
    random = np.random.default_rng(seed)
    for count in (12, 25, 60):
        stamps = 90.0 + np.cumsum(random.uniform(0.02, 0.05, count))
        time = stamps - stamps[0]
        error = 5.0 - 20.0 * time + (4.0 + 9.0 * time) * np.sin(2.0 * np.pi * 2.2 * time + seed)
        error += 1.5 * random.normal(size=count)
        for about in (2.0, 2.5, 9.0):
            frequency, rest = _find_dominant_wave(stamps, error, about)
            wanted = best_wave(stamps, error, about)
            assert (frequency, rest) == pytest.approx(wanted, rel=1e-6)


def test_of_two_images_a_period_a_wave_has_but_one_height():
    """Its sine, or cosine, is 0 at each of them."""
    stamps, error = 0.25 * np.arange(16.0), np.resize([3.0, -2.0, 2.0, -2.5, 0.5], 16)
    assert _find_dominant_wave(stamps, error, 2.0) == pytest.approx(best_wave(stamps, error, 2.0))


def swinging(stamps, errors):
    """Return the frequency that Oscillation reports for a span, Hz, or 0."""
    half = errors[len(errors) // 2 :]
    error = errors[:, np.ptp(half, axis=0).argmax()]
    points = turning_points(error, 6.0)
    ways = np.abs(np.diff(error[points]))
    if len(ways) < 5 or ways[-3:].max() < 0.5 * ways[:-2].max():
        return 0.0
    first, last, between = stamps[points[1]], stamps[points[-1]], len(points) - 2
    if stamps[-1] - last > 1.5 * (last - first) / between:
        return 0.0
    for begin in (0, len(stamps) // 2):
        if len(stamps) - begin < 12:
            return 0.0
        frequency, rest = best_wave(stamps[begin:], error[begin:], between / (last - first) / 2.0)
        if rest < 0.5 and rest < 1e-8 ** (2.0 / (len(stamps) - begin - 6)):
            return frequency
    return 0.0


@pytest.mark.parametrize("seed", range(6))
def test_swings_are_told_as_least_squares_say_at_the_images_that_are_looked_at(seed):
    random, oscillation, said = np.random.default_rng(seed), OscillationCheck(), set()
    stamps = 40.0 + np.cumsum(random.uniform(0.06, 0.1, 150))
    time = stamps - stamps[0]
    wave = 14.0 * np.sin(2.0 * np.pi * (0.4, 1.1, 2.1)[seed % 3] * time) * np.exp(-0.2 * time)
    wave = np.where(time < 2.0, 30.0 * (time < 0.7), wave) if seed > 2 else wave
    errors = np.column_stack([random.normal(size=150), wave, 8.0 * (time > 9.0)])
    errors[:, 1] += 1.5 * random.normal(size=150)
    for k in range(150):
        told, wanted = oscillation.add(stamps[k], errors[k]), None
        if told is None and k % 5:
            continue
        for span, every in ((2.0, 1), (5.0, 6), (12.0, 12)):
            lately = (stamps >= stamps[k] - span) & (np.arange(150) <= k)
            if (k + 1) % every == 0 and lately.sum() >= 7:
                wanted = wanted or swinging(stamps[lately], errors[lately]) or None
        assert told == (wanted if wanted is None else pytest.approx(wanted)), k
        said.add(wanted is None)
    assert len(said) == 2


# -- is it the target? -----------------------------------------------------------

CORNERS = np.array([[-0.10, -0.05], [0.12, -0.04], [0.08, 0.06], [-0.03, 0.09]])


def of(corners):
    return Moments.from_polygon(np.asarray(corners), 4)


def said_of(evidence, seen, wanted, count=3):
    """Return what is reported after each of `count` images."""
    see = SimpleNamespace(moments=seen, plane=None)
    return [evidence.add(see, SimpleNamespace(moments=wanted)) for _ in range(count)]


def shaped(moments, order, j, by):
    """The moments with a central one of an order other by so much, free of scale."""
    centred = moments.centred.copy()
    centred[order - j, j] += by * moments.m00 ** (1.0 + 0.5 * order)
    return Moments(moments.order, moments.kind, moments.m00, moments.xg, moments.yg, centred)


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


def test_a_target_that_is_as_spread_out_as_no_tilt_makes_it_is_another():
    """To the last digit: of 4/5 or 5/4 the area, its radius of gyration the same 2."""
    def of_area(m00):
        second = np.zeros((3, 3))
        second[2, 0] = second[0, 2] = 2.0 * m00
        return Moments(2, "dense", m00, 0.0, 0.0, second)

    for seen, wanted in ((4.0, 5.0), (5.0, 4.0)):
        assert said_of(ShapeCheck(), of_area(seen), of_area(wanted))[-1]


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
