"""Checks of errors, features and joints over time, and of poses that look alike."""

import numpy as np
import pytest
from loop_rig import CORNERS, an_image, moments_of, scaled

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import CameraModel, Goal, Moments, Observation, create_scheme
from aras_visual_servo_controller.diagnosis.ambiguous_poses import AmbiguousPoses
from aras_visual_servo_controller.diagnosis.area_check import AreaCheck, predict_distance
from aras_visual_servo_controller.diagnosis.diagnoses.wrong_object import ShapeCheck
from aras_visual_servo_controller.diagnosis.feature_rows import FeatureHistory
from aras_visual_servo_controller.diagnosis.gain_check import GainCheck
from aras_visual_servo_controller.diagnosis.joint_tracking_check import JointTrackingCheck
from aras_visual_servo_controller.diagnosis.oscillation_check import OscillationCheck
from aras_visual_servo_controller.diagnosis.step_check import StepCheck
from aras_visual_servo_controller.diagnosis.vector_history import VectorHistory
from aras_visual_servo_controller.laws import Proportional


# -- does it ring? -------------------------------------------------------------------------------
def zigzag(*extremes, half=0.3, rate=100.0):
    """[(stamp, error)] of straight lines from one extreme to the next, `half` seconds each."""
    stamps = np.arange(0.0, half * (len(extremes) - 1) + 1e-9, 1.0 / rate)
    return wave(stamps, np.interp(stamps, half * np.arange(len(extremes)), extremes))


def wave(stamps, errors):
    return list(zip(stamps, errors, strict=True))


def rings(samples, beside=lambda t: 0.0):
    """Return what OscillationCheck reports at the end for an error, next to another error."""
    checks = OscillationCheck(), OscillationCheck()
    for t, e in samples:
        answers = [checks[0].add(t, np.array([e, beside(t)])),
                   checks[1].add(t, np.array([beside(t), e]))]  # fmt: skip
    assert answers[0] == answers[1]
    return answers[0]


@pytest.mark.parametrize(("half", "sign"), [(0.2, 1.0), (0.3, -1.0)])
def test_the_frequency_of_five_swings_is_told(half, sign):
    """To a twentieth: the wave that is laid through them may begin and end anywhere."""
    swings = zigzag(*sign * np.array([0, 9, 0, 9, 0, 9.0]), half=half)
    assert rings(swings) == pytest.approx(0.5 / half, rel=0.055)
    # The loudest of the later half is looked at; a single step is no swing.
    swings = zigzag(0, 9, 0, 9, 0, 9)
    assert rings(swings, lambda t: 50.0 * (t < 0.7)) is not None
    assert rings(swings, lambda t: 50.0 * (t > 1.2)) is None
    assert rings(swings, lambda t: 8.0 * (t > 1.2)) is not None


@pytest.mark.parametrize(("frequency", "seconds"), [
    (0.25, 14.0), (0.7, 6.0), (2.0, 3.0), (3.7, 3.0), (6.3, 3.0),
])  # fmt: skip
def test_the_frequency_of_a_lasting_wave_is_told_to_a_hundredth(frequency, seconds):
    times = 50.0 + np.arange(0.0, seconds, 1.0 / 30.0)
    lasting = wave(times, 9.0 * np.sin(2.0 * np.pi * frequency * times))
    assert rings(lasting) == pytest.approx(frequency, rel=0.01)
    times = np.arange(29) / 30.0  # of few images one that grows from nothing
    for phase in (0.0, 0.25):
        turns = 4.0 * (times - times.mean()) / times[-1] + phase
        growing = wave(times, 200.0 * times * np.sin(2.0 * np.pi * turns))
        assert rings(growing) == pytest.approx(30 / 7, rel=0.03)


def test_a_wave_is_told_beside_a_drift_from_twelve_images_on_and_no_longer_once_it_has_ended():
    times = np.arange(0.0, 5.0, 1.0 / 30.0)
    drifting = wave(times, 20.0 * times + 9.0 * np.sin(4.0 * np.pi * times))[:60]
    assert rings(drifting) == pytest.approx(2.0, rel=0.02)
    few = [(0.1 * k, 9.0 * np.sin(0.5 * np.pi * k)) for k in range(12)]
    assert rings(few) == pytest.approx(2.5) and rings(few[:-1]) is None
    swings = 0, 9, 0, 9, 0, 9, 4
    assert rings(zigzag(*swings, half=0.2)) is not None
    assert rings(zigzag(*swings, 4, half=0.2)) is None  # for 0.4 s
    # Of five seconds two swung from stop to stop; in the last two there are too few swings.
    stops = 15.0 * np.sign(np.sin(2.0 * np.pi * 1.3 * times))
    later = 12.0 * np.sin(2.0 * np.pi * 0.8 * times)
    assert rings(wave(times, np.where(times < 2.0, stops, later))) == pytest.approx(0.8, rel=0.01)


@pytest.mark.parametrize(("extremes", "half", "found"), [
    ((0, 9, 0, 9, 0), 0.3, False),  # five reversals are needed
    ((0, 9, 0, 9, 0, 5.5), 0.3, False),  # the fifth is no longer than noise
    ((0, 9, 0, 9, 0, 6.5), 0.3, True),
    ((0, 5.8, 0, 5.8, 0, 5.8, 0), 0.2, False), ((0, 6.2, 0, 6.2, 0, 6.2, 0), 0.2, True),
    ((0, 9, 5, 14, 0, 9, 0), 0.2, False),  # nor does a step of noise on the way end the swing
])  # fmt: skip
def test_what_is_no_longer_than_noise_is_no_reversal(extremes, half, found):
    assert (rings(zigzag(*extremes, half=half)) is not None) is found


@pytest.mark.parametrize("error", [
    lambda t: 10.0 * np.exp(-3 * t),
    lambda t: 30.0 * np.exp(-2 * t) * np.cos(6.0 * t),  # dies away
    lambda t: 2.0 * np.sin(20.0 * t),  # no louder than noise
    lambda t: 40.0 * (t < 1.0),  # the target was moved
    lambda t: 9.0 * np.sin(2.0 * np.pi * 0.15 * t),  # five swings take longer than twelve seconds
])  # fmt: skip
def test_what_dies_away_or_is_quiet_is_no_oscillation(error):
    oscillation = OscillationCheck()
    assert all(oscillation.add(t, np.array([error(t)])) is None for t in np.arange(0, 24, 1 / 30))


@pytest.mark.parametrize("way", ["at rest", "approaching", "following"])
@pytest.mark.parametrize("seed", range(2))
def test_noise_that_is_louder_than_the_tolerances_is_no_oscillation(way, seed):
    random, oscillation, error = np.random.default_rng(seed), OscillationCheck(), 0.0
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
def said_of(seen, wanted, count=3):
    evidence, see = ShapeCheck(), an_image(0.0, 0.1, moments=seen)
    return [evidence.add(see, Goal(moments=wanted)) for _ in range(count)]


def test_three_strange_images_must_follow_each_other():
    wanted, other = moments_of(CORNERS), moments_of(CORNERS * [1.0, 0.2])
    evidence = ShapeCheck()
    said = [bool(evidence.add(an_image(0.0, 0.1, moments=seen), Goal(moments=wanted)))
            for seen in (other, other, wanted, other, other, other, other)]  # fmt: skip
    assert said == [False] * 5 + [True] * 2
    points = Moments.from_points(CORNERS * [1.0, 3.0], 4)
    for seen, goal in ((None, wanted), (other, None), (points, wanted)):  # are not compared
        assert not any(said_of(seen, goal, 5))


@pytest.mark.parametrize(("factor", "strange"), [(1.2, False), (1.3, True)])
def test_how_spread_out_the_target_may_be(factor, strange):
    """Second moments that grow by a factor where the area stays: a ring for a disc, or back."""
    wanted = moments_of(CORNERS)
    for by, seen in ((factor, wanted), (1.0 / factor, scaled(wanted, 2.0))):
        centred = np.where(np.add.outer(*(np.arange(5),) * 2) == 2, by, 1.0) * seen.centred
        spread = Moments(4, "dense", seen.m00, seen.xg, seen.yg, centred)
        words = said_of(spread, wanted)[-1]
        assert bool(words) is strange
        if strange:
            assert f"its spread is {by:.2f} times" in words and "differs by 0.00" in words


@pytest.mark.parametrize(("longer", "strange"), [
    (0.27, False), (0.33, True), (-0.27, False), (-0.33, True),
])  # fmt: skip
def test_how_long_the_target_may_be(longer, strange):
    def of_length(length):
        centred = np.zeros((5, 5))
        centred[2, 0], centred[0, 2] = 0.5 + 0.5 * length, 0.5 - 0.5 * length
        return Moments(4, "dense", 2.0, 0.0, 0.0, centred)

    words = said_of(of_length(0.5 + longer), of_length(0.5))[-1]
    assert bool(words) is strange
    assert not strange or f"its elongation differs by {abs(longer):.2f}" in words


# -- a gain that is too high for the delay is reported before the error has oscillated twice ----
PERIOD = 1.0 / 30.0
SCHEME = create_scheme("points", Proportional(1.0))


def delayed(gain, delay, duration=60.0, seconds=4.0, until=np.inf):
    """A check that has followed the error of a loop e' = -gain e(t - delay), and that error."""
    check, scheme = GainCheck(duration), create_scheme("points", Proportional(gain))
    step = 1e-3
    error = np.full(round(seconds / step), 100.0)
    for i in range(1, len(error)):
        late = max(i - round(delay / step), 0)
        error[i] = error[i - 1] - (gain * error[late] * step if i > delay / step else 0.0)
    images = [i for i in range(0, len(error), round(PERIOD / step)) if i * step < until]
    for i in images:
        check.add(i * step, np.array([error[i]]), scheme, delay)
    return check, error[: images[-1]]


@pytest.mark.parametrize("delay", [0.1, 0.25, 0.5])
def test_a_target_that_is_lost_by_an_overshoot_is_lost_by_the_gain(delay):
    found = delayed(1.4 / delay, delay, until=4.0 * delay)[0].explain_loss("the target was lost")
    assert found.kind == "gain_too_high" and found.reason.endswith("the target was lost")
    (change,) = found.remedy.changes
    check, error = delayed(change.value * 1.4 / delay, delay, seconds=20.0)
    assert check.delay_outcome is None and error.min() > -10.0 and abs(error[-1]) < 1.0
    # One that suits the delay loses no target, nor does one before any overshoot.
    for gain, until, suits in ((0.3, 99.0, True), (1.5, 1.2 * delay, False)):
        check, _ = delayed(gain / delay, delay, until=until)
        assert (check.delay_outcome is None) is suits and check.explain_loss("lost") is None
    remedy = delayed(1.5 / delay, delay, duration=3.0)[0].delay_outcome.remedy
    changes = {change.key: change.value for change in remedy.changes}
    if "duration" in changes or delay == 0.25:  # the lower gain has its time
        assert 3.0 * changes["duration"] > 8.0 / (1.5 / delay * changes["gain"])


@pytest.mark.parametrize(("growth", "found"), [(1.5, True), (0.8, False), (0.0, False)])
def test_a_target_that_a_growing_swing_has_lost_before_its_frequency_is_known(growth, found):
    check = GainCheck()
    for k in range(30):
        error = 20.0 * growth ** (k / 6.0) * np.cos(np.pi * k / 6.0)
        check.add(k * PERIOD, np.array([error, 1.0]), SCHEME, 0.0)
    lost = check.explain_loss("the target was lost")
    assert (lost is not None) == found and (not found or "growing amplitude" in lost.reason)


# -- joints that do not follow their commands or oscillate are reported -------------------------
def by_joints(images, commanded, measured, late=lambda k: (False, False), begin=7.0, lengths=1.0):
    """A JointTrackingCheck of J1 and J2 that was shown velocities (2,) by image, 30 a second."""
    check = JointTrackingCheck(("J1", "J2"), lengths)
    for k in range(images):
        check.add(begin + k / 30.0, (np.array(late(k)), np.array(commanded(k), float),
                                     np.array(measured(k), float)))  # fmt: skip
    return check


def test_a_joint_that_swings_by_itself_is_told_at_once_and_before_what_it_does_to_the_picture():
    def swing(k):
        return 0.3, 0.3 + 16.0 * np.cos(40.0 * k / 30.0)

    for images in (10, 14):  # 0.3 s have not passed; every fifth image is looked at
        assert not by_joints(images, lambda k: (0.3, 0.3), swing).reason
    for check in (
        by_joints(15, lambda k: (0.3, 0.3), swing, lambda k: (True, False)),
        by_joints(15, lambda k: (-0.3, -0.3), lambda k: -np.array(swing(k))),
    ):
        assert (check.joints, check.reason) == (
            "J2", "the motion of J2 oscillates without a command, at up to 16.3 rad/s or m/s")
    late = by_joints(60, lambda k: [np.cos(0.3 * k)] * 2, lambda k: [np.cos(0.3 * k - 1.0)] * 2)
    assert not late.reason  # one that follows a swinging command, late


def test_the_speed_of_a_sliding_joint_is_measured_in_its_own_length():
    def swing(k):
        return 0.0, 0.2 * np.cos(40.0 * k / 30.0)

    for commanded, lengths, joints in (
        (lambda k: (0.0, 0.0), 1.0, ""), (lambda k: (0.0, 0.0), np.array([0.2, 1.0]), ""),
        (lambda k: (0.0, 0.0), np.array([1.0, 0.2]), "J2"),
        (swing, np.array([1.0, 0.2]), ""),  # a command in the same units is no difference
    ):
        check = by_joints(15, commanded, swing, lengths=lengths)
        assert check.joints == joints
        assert not joints or check.reason.endswith("at up to 0.2 rad/s or m/s")


@pytest.mark.parametrize(("of_ten", "gone", "told"), [
    (6, 1.0, False), (7, 1.0, True), (2, 0.09, True), (2, 0.11, False), (1, 0.0, False),
])  # fmt: skip
def test_a_joint_stays_behind_where_the_loop_waits_for_it(of_ten, gone, told):
    """In more than six images of ten; or in more than one, where it goes less than a tenth of its
    way: as with velocities, of which a joint is sent new ones once the others stand."""
    check = by_joints(60, lambda k: (0.3, -0.2), lambda k: (0.3, -0.2 * gone),
                      lambda k: (False, k % 10 < of_ten))  # fmt: skip
    assert (check.joints, check.reason) == (
        ("J2", "the motion of J2 does not follow the command") if told else ("", ""))


@pytest.mark.parametrize(("late", "gone", "named"), [
    ([(1, 1)] * 40, 0.0, ""), ([(1, 1)] * 60, 0.0, "J1 and J2"),
    ([(0, k >= 33) for k in range(60)], 1.0, ""),  # of 46 images
    ([(0, k >= 32) for k in range(60)], 1.0, "J2"),
    ([(0, k >= 18) for k in range(45)], 1.0, ""),  # six of ten are not more
    ([(0, k >= 17) for k in range(45)], 1.0, "J2"),
    ([(k < 45, 0) for k in range(90)], 1.0, ""),  # and only of the last 1.5 s
])  # fmt: skip
def test_joints_are_named_together_once_the_loop_has_waited_for_a_second_and_a_half(
    late, gone, named
):
    commanded = np.array([0.3, -0.2])
    check = by_joints(len(late), lambda k: commanded, lambda k: gone * commanded,
                      lambda k: np.array(late[k], bool))  # fmt: skip
    assert check.joints == named


# -- changes of features between images, compared with L ----------------------------------------
DT, COUNT = 1 / 30, 3
TOLERANCES = np.full(COUNT, 1e-3)
OUTLINE = np.array([[-0.1, -0.08], [0.1, -0.09], [0.08, 0.1], [-0.07, 0.06]])
GOAL = Goal(
    moments=Moments.from_polygon(OUTLINE), depth=0.4,
    world_T_camera=matrix_from_xyz_rpy((0, 0, 1), (0,) * 3))  # fmt: skip


def followed(images, error_of, check=None, rests=0, begin=0.0):
    """A check that has followed features, error_of(k, error by L and the camera's motion), of a
    camera that first rests for some images."""
    check, draw, history = check or StepCheck(), np.random.default_rng(3), FeatureHistory()
    L, told = draw.normal(size=(COUNT, 6)), np.zeros(COUNT)
    for k in range(images):
        motion = 4e-3 * np.cos([0.1 * k, 0.3, 0.2 * k, 0.0, 0.0, 0.1]) * (k >= rests)
        told = told + L @ motion * (k > 0)
        image = an_image(begin + k * DT, DT, motion)
        history.add(image, error_of(k, told), L, 0.0, TOLERANCES, False)
        check.add(history, ("x", "y", "size"), image)
    return check


def test_features_that_move_as_the_camera_says_are_no_one_s_fault():
    draw = np.random.default_rng(5)
    check = followed(60, lambda k, told: told + 1e-3 * draw.normal(size=COUNT))
    assert check.correlation > 0.98 and check.feature_correlations.min() > 0.9
    assert check.unchanged_since is check.first_jump is None and not check.has_frequent_jumps
    # Features that stay the same before a camera that moves are noted with their beginning.
    check = followed(30, lambda k, told: told if k < 10 else np.full(COUNT, 0.05))
    assert check.unchanged_since == pytest.approx(10 * DT)
    assert followed(31, lambda k, told: told, check).unchanged_since is None
    for feature in range(COUNT):  # one with the wrong sign moves against its L
        signs = np.where(np.arange(COUNT) == feature, -1.0, 1.0)
        against = followed(60, lambda k, told, signs=signs: signs * told).feature_correlations
        assert against[feature] < -0.95 and np.delete(against, feature).min() > 0.95


def test_a_jump_is_reported_with_its_feature_its_size_and_its_time():
    check = followed(40, lambda k, told: told + [0.0, 0.3 * (k >= 20), 0.0])
    jump = check.first_jump
    assert (jump.feature, len(check.jumps)) == ("y", 1) and not check.has_frequent_jumps
    assert jump.stamp == pytest.approx(20 * DT) and jump.size == pytest.approx(0.3, abs=0.05)
    assert str(jump).endswith("at 0.67 s, but L and the camera's motion explain only 0.018")
    assert followed(60, lambda k, told: told + [0.3 * (k % 12 > 6), 0, 0]).has_frequent_jumps
    # The motion of a target that runs away is known also once it is lost.
    check = followed(20, lambda k, told: told + [0.4 * max(k - 12, 0), 0.0, 0.0])
    assert check.target_motion_part > 0.9
    again = followed(1, lambda k, told: told, check, begin=5.0)  # it is visible again
    assert again.target_motion_part == 0.0
    assert followed(20, lambda k, told: told).target_motion_part == 0.0


@pytest.mark.parametrize(("rests", "drift", "noise", "found"), [
    (8, 1e-3, 0.0, True), (30, 0.0, 5e-3, False), (8, 0.0, 0.0, False),
    (0, 1e-3, 0.0, False),  # it never rested
])  # fmt: skip
def test_features_that_move_on_before_a_camera_at_rest_drift(rests, drift, noise, found):
    draw = np.random.default_rng(5)
    check = followed(30, lambda k, told: told + drift * k + noise * draw.normal(size=COUNT),
                     rests=rests)  # fmt: skip
    assert check.has_drift is found


def test_another_number_of_features_starts_again_with_their_names():
    check, history = StepCheck(), FeatureHistory()
    for k in range(12):
        count, image = 3 if k < 3 else 2, an_image(k * DT, DT, np.zeros(6))
        history.add(image, np.full(count, 2e-3 * k), np.ones((count, 6)), 0.0, 1e-3, False)
        check.add(history, ("x", "y", "size")[:count], image)
        assert check.has_drift is (k >= 7)
    assert check.feature_correlations.tolist() == [0.0, 0.0]
    # also at the first image with L, and at the first with other features
    check, history = StepCheck(), FeatureHistory()
    for k, count in enumerate((None, 3, 3, 3, 2, 2, None, 3)):
        image, L = an_image(k * DT, DT, np.ones(6)), None if count is None else np.ones((count, 6))
        history.add(image, np.full(count or 1, 1e-2 * k), L, 0.0, 1e-3, False)
        check.add(history, ("x", "y", "size")[:count], image)
        assert len(check.names) == len(check.feature_correlations)
    assert check.names == ("x", "y")


def view(area, stamp=0.0, height=1.0, touched_borders=()):
    return an_image(
        stamp, DT, moments=Moments.from_polygon(np.sqrt(area) * OUTLINE),
        touched_borders=touched_borders,
        world_T_camera=matrix_from_xyz_rpy((0, 0, height), (0,) * 3))  # fmt: skip


def test_a_part_that_disappears_inside_the_image_is_covered_until_it_comes_back():
    check = AreaCheck(GOAL)
    for k, area in enumerate([1.0] * 10 + [0.7] * 10):
        check.add(view(area, k * DT))
    assert (check.occluded_since, check.visible_part) == pytest.approx((10 * DT, 0.7))
    check.add(view(1.0, 1.0))
    assert check.occluded_since is None
    aside = matrix_from_xyz_rpy((0.1, 0, 0.8), (0,) * 3)  # the distance is along the optical axis
    assert predict_distance(aside, GOAL) == pytest.approx(1.5)
    assert predict_distance(None, GOAL) == 1.0


@pytest.mark.parametrize("seen", [
    [view(1.0 - 0.02 * k) for k in range(20)],  # the camera goes away, step by step
    [view(1.0 + 0.3 * (-1) ** k) for k in range(40)],  # noise
    [view(1.0)] * 10 + [view(0.6, touched_borders=("left",))] * 10,
    [view(1.0)] * 10 + [view(0.7)] + [view(1.0)] * 10,  # one bad image
    [view(1.0)] * 10 + [view(0.7, height=0.9)] * 10,  # it went back by as much
])  # fmt: skip
def test_what_is_not_covered(seen):
    check = AreaCheck(GOAL)
    for observation in seen:
        check.add(observation)
    assert check.occluded_since is None


# -- poses at which a goal's points have the same image as at the goal, and their distinction ---
CAMERA = CameraModel(320, 240, (300.0, 0.0, 160.0, 0.0, 300.0, 120.0, 0.0, 0.0, 1.0), ())
TRIANGLE = np.array([[-0.15, -0.1], [0.2, -0.05], [0.02, 0.18]])
PLANE = Plane(0.9, -0.6, 2.0)  # at 0.5 m, tilted
WORLD_T_GOAL = matrix_from_xyz_rpy((0.3, -0.2, 0.9), (2.8, 0.3, 0.7))


def goal_of(points, plane=PLANE, k=1.0):
    plane = Plane(*(np.array(plane) / k))
    pose = WORLD_T_GOAL.copy()
    pose[:3, 3] *= k
    return Goal(features={"points": {"points": np.asarray(points).tolist()}}, plane=plane,
                world_T_camera=pose)  # fmt: skip


def seen(corners, plane, accuracy=0.0):
    corners = None if corners is None else np.asarray(corners)
    return Observation(0.0, 0.0, True, "", CAMERA, corners=corners, plane=plane,
                       corner_accuracy=accuracy)  # fmt: skip


def sides(points, plane):
    rays = np.column_stack([points, np.ones(len(points))])
    places = rays / (rays @ np.array(plane))[:, None]
    return np.sort(np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1))


def test_three_points_look_alike_from_other_poses():
    found = AmbiguousPoses(goal_of(TRIANGLE))
    assert found.poses
    for pose in found.poses:
        np.testing.assert_allclose(pose.points, TRIANGLE, atol=1e-9)
        np.testing.assert_allclose(
            sides(pose.points, pose.plane), sides(TRIANGLE, PLANE), rtol=1e-6)
        assert found.find_pose(seen(TRIANGLE, Plane(*pose.plane)))[0] is pose
    assert found.find_pose(seen(TRIANGLE, PLANE)) == (None, ())
    assert found.find_pose(seen(TRIANGLE, None)) == (None, found.poses)  # nothing tells the plane
    scaled = AmbiguousPoses(goal_of(TRIANGLE, k=7.0)).poses
    for one, other in zip(found.poses, scaled, strict=True):
        assert other.distance == pytest.approx(7.0 * one.distance, rel=1e-4)
        assert other.angle == pytest.approx(one.angle, rel=1e-4)
    # Kinematics have the plane where it was, also where the target is displaced along it.
    aside = np.eye(4)
    aside[:3, 3] = np.cross(PLANE, (0.0, 0.1, 0.3))
    plane = found.goal.compute_plane(found.goal.world_T_camera @ aside)
    assert found.find_pose(seen(TRIANGLE, plane)) == (None, ())


SMALL = np.array([[-0.03, -0.02], [0.035, -0.025], [0.03, 0.028], [-0.02, 0.02]])


def test_a_small_quadrilateral_looks_nearly_alike_from_the_mirrored_tilt():
    found = AmbiguousPoses(goal_of(SMALL))
    (pose,) = found.poses
    off = np.abs(pose.points - SMALL).max()
    assert 1e-5 < off < 5e-3 and pose.angle > 0.3
    assert AmbiguousPoses(goal_of(10.0 * SMALL)).poses == ()  # a wide view tells the two apart
    # by the plane, or, where nothing tells that, by the image if it shows the difference
    assert found.find_pose(seen(SMALL, Plane(*pose.plane)))[0] is pose
    assert found.find_pose(seen(pose.points, None, 0.01 * off))[0] is pose
    assert found.find_pose(seen(SMALL, None, 0.01 * off)) == (None, ())
    assert found.find_pose(seen(SMALL, None, 10.0 * off)) == (None, (pose,))
    assert found.find_pose(seen(None, None)) == (None, (pose,))


@pytest.mark.parametrize("goal", [
    Goal(depth=0.5), goal_of(np.column_stack([np.linspace(-0.1, 0.1, 4), np.zeros(4)])),
    goal_of(TRIANGLE, Plane(0.0, 0.0, -2.0)), goal_of(10.0 * SMALL),  # a wide view tells them apart
    # a square looks exactly alike after a quarter of a turn: `up_to` says so
    goal_of([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]], Plane(0.0, 0.0, 2.0)),
])  # fmt: skip
def test_without_points_of_a_plane_in_view_that_look_alike_there_are_none(goal):
    assert AmbiguousPoses(goal).poses == ()


# -- window of the latest errors ----------------------------------------------------------------
@pytest.mark.parametrize("kept", [1, 40, 63, 64, 65, 200])
def test_the_window_holds_the_newest_in_order(kept):
    recent = VectorHistory(max_count=kept)
    for i in range(700):
        recent.add(0.1 * i, np.array([i, -2.0 * i, 0.5]))
        first = max(i + 1 - kept, 0)
        expected = np.arange(first, i + 1)
        assert len(recent.rows) == len(expected)
        np.testing.assert_array_equal(recent.stamps, 0.1 * expected)
        np.testing.assert_array_equal(recent.rows[:, 1], -2.0 * expected)
        assert (recent.rows[:, 2] == 0.5).all()
    assert len(recent.stamps.base) <= max(4 * kept, 64)  # it does not grow for ever


def test_rows_of_another_length_and_older_than_the_span_are_dropped():
    recent = VectorHistory()
    recent.add(0.0, np.zeros(4))
    recent.add(0.1, np.ones(2))
    assert recent.stamps.tolist() == [0.1] and recent.rows.tolist() == [[1.0, 1.0]]
    recent.clear()
    assert len(recent.rows) == 0
    recent = VectorHistory(span=0.35)
    for i in range(10):
        recent.add(0.1 * i, np.array([float(i)]))
    assert recent.rows[:, 0].tolist() == [6.0, 7.0, 8.0, 9.0]
    recent.drop_oldest(1)
    assert recent.rows[:, 0].tolist() == [7.0, 8.0, 9.0] and len(recent.stamps) == 3
    recent.add(9.0, np.array([10.0]))
    assert recent.stamps.tolist() == [9.0]
