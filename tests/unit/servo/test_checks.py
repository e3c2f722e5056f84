"""What the images say beyond the error: verdicts against least squares written row by row, and
bounds from both sides."""

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from loop_rig import scaled

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.judging.camera_check import DIRECTIONS, CameraCheck
from aras_visual_servo_controller.judging.oscillation import Oscillation
from aras_visual_servo_controller.judging.shape_check import ShapeCheck
from aras_visual_servo_controller.judging.target_check import TargetCheck
from aras_visual_servo_controller.seeing.joint_sample import JointSample

# -- is the camera as believed? ------------------------------------------------------------------


class Rows:
    """The same judgement from the rows themselves instead of sums of their products."""

    def __init__(self):
        self.rows, self.values, self.path = [np.empty((0, 6))], [np.empty(0)], 0.0
        self.begin()

    def begin(self):
        """A row is what happened from here on."""
        self.parts, self.moved, self.shaken, self.images = 0.0, 0.0, 0.0, 0

    def smooth(self, off):
        """Whether what is off in each row goes on in the next."""
        off = np.split(off, np.cumsum([len(value) for value in self.values[1:]])[:-1])
        together = sum(one @ other for one, other in zip(off, off[1:], strict=False))
        return together > CameraCheck.SMOOTH * sum(each @ each for each in off)

    def add(self, before, now, twist, tolerances, shaken):
        (error_before, L_before), (error, L) = before, now
        moved = (error - error_before) / tolerances
        if np.abs(moved).max() > 1.0 / tolerances.max():
            self.begin()
            return
        self.parts = self.parts + 0.5 * (L_before + L) * twist / tolerances[:, None]
        self.moved, self.shaken = self.moved + moved, max(self.shaken, shaken)
        self.images += 1
        predicted = np.abs(self.parts.sum(axis=1)).max()
        if predicted >= CameraCheck.LEAST:
            weight = 1.0 / (1.0 + CameraCheck.TYPICAL * self.shaken)
            self.rows.append(weight * self.parts)
            self.values.append(weight * self.moved)
            self.path += weight * predicted
            self.begin()
        elif self.images == CameraCheck.TOGETHER:
            self.begin()

    def fault(self):
        A, b = np.vstack(self.rows), np.concatenate(self.values)
        if self.path <= CameraCheck.PATH:
            return ""
        along, turning = A[:, :3].sum(axis=1), A[:, 3:].sum(axis=1)
        depth = 1.0
        if along @ along > CameraCheck.KNOWN**2:
            depth = along @ (b - turning) / (along @ along)
        if depth <= 0.0:
            return ("the features move otherwise than L and the arm's motion say: against the "
                    "camera's translation")
        expected = np.array([depth] * 3 + [1.0] * 3)
        off = b - A @ expected
        misfit = off @ off / (b @ b)
        loud = np.sqrt(off @ off / len(b)) > CameraCheck.LOUD
        if misfit > CameraCheck.MISFIT and loud and self.smooth(off):
            return ("the features move otherwise than L and the arm's motion say: "
                    f"{100.0 * misfit:.0f} % of the motion is not explained")
        # One row more a direction, of little weight: where nothing was seen, it is as expected.
        weak = np.sqrt(0.1) * np.eye(6)
        known = np.vstack([A, weak])
        scale = np.linalg.lstsq(known, np.concatenate([b, weak @ expected]), rcond=None)[0]
        left = b - A @ scale
        noise = max(np.sqrt(left @ left / max(len(b) - 6, 1)), CameraCheck.QUIET)
        spread = np.linalg.inv(known.T @ known)
        found = []
        for one, other in [(1, 0), (2, 0), (2, 1), (3, 3), (4, 4), (5, 5)]:
            compared = np.zeros(6)
            compared[one], unit, least = 1.0, 1.0, CameraCheck.TURNED
            away = scale[one] - 1.0
            if one != other:
                compared[other], unit, least = -1.0, depth, CameraCheck.KNOWN
                away = scale[one] - scale[other]
            unknown = np.sqrt(compared @ spread @ compared)
            doubt = CameraCheck.DEVIATIONS * noise * unknown / unit
            if unknown <= 1.0 / least:
                lowered = left @ left * unknown**2
                found.append((abs(away) / unit - CameraCheck.OFF - lowered - doubt, one, other))
        over, one, other = max(found, default=(0.0, 0, 0))
        if over <= 0.0:
            return ""
        if one != other and abs(scale[one] - 1.0) < abs(scale[other] - 1.0):
            one, other = other, one
        beside = f"along {DIRECTIONS[other]} {scale[other]:.2f}"
        if one == other:
            beside = "elsewhere 1.00"
        return (f"along {DIRECTIONS[one]} the features move {scale[one]:.2f} times as far as L "
                f"and the arm's motion say, {beside} times")


def judged(seed, jacobian=None):
    """(what the evidence says, what the rows say) of a run drawn by the seed."""
    random = np.random.default_rng(seed)
    evidence, rows = CameraCheck(None if jacobian is None else lambda q: jacobian), Rows()
    tolerances = 1e-3 * random.uniform(0.5, 2.0, 4)
    scale = np.ones(6)
    scale[:3] *= random.choice([-0.3, 0.6, 1.0, 1.5], p=[0.1, 0.3, 0.3, 0.3])
    scale[random.integers(6)] *= random.choice([1.0, 0.93, 1.1, 1.4])
    noise = random.choice([0.0, 0.3, 1.0, 4.0, 20.0], p=[0.1, 0.3, 0.3, 0.2, 0.1])
    size = random.choice([1e-3, 1e-2, 3e-2])
    drift = random.choice([0.0, 40.0], p=[0.7, 0.3]) * tolerances * random.normal(size=4)
    error, before, joints = random.normal(size=4), None, None
    for k in range(int(random.integers(2, 30))):
        L = random.normal(size=(4, 6))
        twist = size * random.normal(size=6) * (random.random(6) < 0.8)
        if before is not None:
            error = before[0] + 0.5 * (before[1] + L) * scale @ twist
            error = error + noise * tolerances * random.normal(size=4) + drift
            if random.random() < 0.1:
                error = error + 2.0  # an angle that wrapped round
        last, shaken = joints, 0.0
        joints = JointSample.of(k / 30.0, "xyz", 1e-3 * random.normal(size=3),
                                0.03 * random.normal(size=3))  # fmt: skip
        if before is not None and jacobian is not None:
            dt, change = joints.stamp - last.stamp, joints.velocities - last.velocities
            told = 0.5 * (last.velocities + joints.velocities) * dt
            doubt = np.abs(joints.positions - last.positions - told)
            doubt = doubt + CameraCheck.LATE * dt * np.abs(change)
            ways = np.abs(L @ jacobian * doubt) / tolerances[:, None]
            shaken = ways.max()
        evidence.add(
            SimpleNamespace(rate=0.0, L=L, error=error),
            SimpleNamespace(motion=twist, dt=1 / 30, joints=joints), tolerances,
        )  # fmt: skip
        if before is not None:
            rows.add(before, (error, L), twist, tolerances, shaken)
        before = error, L
    return evidence.fault(), rows.fault()


@pytest.mark.parametrize("shaken", [False, True])
def test_the_camera_is_judged_as_least_squares_over_all_rows_say(shaken):
    jacobian = np.random.default_rng(5).normal(size=(6, 3)) if shaken else None
    kinds = Counter()
    for seed in range(150):
        said, wanted = judged(seed, jacobian)
        assert said == wanted, seed
        kinds[wanted.partition(" ")[0] + ("%" if "%" in wanted else "")] += 1
    # or this shows nothing: innocent, one direction, against the translation, unexplained
    assert set(kinds) == {"", "along", "the", "the%"} and min(kinds.values()) >= 4, kinds


def test_only_an_image_that_follows_another_counts():
    """Of a pair one of which has no L, no motion or other features, nothing can be said."""
    L, twist = np.ones((2, 6)), 0.01 * np.ones(6)
    tolerances = np.full(2, 1e-3)
    wrong = [-0.2 * k * np.ones(2) for k in range(8)]  # against the motion: found at once

    def said(change):
        evidence = CameraCheck()
        for k, error in enumerate(wrong):
            decision = {"L": L, "error": error, "rate": 0.0}
            seen = {"motion": twist, "dt": 1 / 30, "joints": None}
            if k % 2:
                change(decision, seen)
            evidence.add(SimpleNamespace(**decision), SimpleNamespace(**seen),
                         np.full(len(decision["error"]), 1e-3))
        return evidence.fault()

    assert said(lambda decision, seen: None)
    assert not said(lambda decision, seen: decision.update(L=None))
    assert not said(lambda decision, seen: decision.update(L=np.ones((3, 6))))
    assert not said(lambda decision, seen: decision.update(L=np.ones((3, 6)), error=np.ones(3)))
    evidence = CameraCheck()
    for error in wrong:
        evidence.add(SimpleNamespace(rate=0.0, L=L, error=error),
                     SimpleNamespace(motion=None, dt=1 / 30, joints=None), tolerances)
    assert not evidence.fault()


@pytest.mark.parametrize("known, said", [(1.0, False), (0.0, True), (-1.0, True)])
def test_a_target_s_motion_that_the_scheme_knows_is_taken_off(known, said):
    """Before a camera that goes to and fro, by kinematics and by L."""
    draw, dt = np.random.default_rng(4), 1 / 30
    L, tolerances = draw.normal(size=(6, 6)), np.array([1e-3, 2e-3, 1e-3, 3e-3, 1e-3, 2e-3])
    drift, check, error = -L[:, :3] @ [0.02, -0.01, 0.005], TargetCheck(), np.zeros(6)
    for k in range(120):
        motion = 2e-3 * np.sin([0.3 * k, 0.2 * k, 0.1 * k, 0.0, 0.0, 0.0])
        error = error + L @ motion + drift * dt
        moves = check.add(
            SimpleNamespace(error=error, L=L, rate=known * drift),
            SimpleNamespace(stamp=k * dt, dt=dt, motion=motion, world_T_camera=np.eye(4)),
            None, tolerances, True,
        )  # fmt: skip
    assert bool(moves) is said


# -- does it ring? -------------------------------------------------------------------------------


def zigzag(*extremes, half=0.3, rate=100.0):
    """[(stamp, error)] of straight lines from one extreme to the next, `half` seconds each."""
    stamps = np.arange(0.0, half * (len(extremes) - 1) + 1e-9, 1.0 / rate)
    return list(zip(stamps, np.interp(stamps, half * np.arange(len(extremes)), extremes),
                    strict=True))  # fmt: skip


def rings(samples, beside=lambda t: 0.0):
    """What is said at the end; another error is beside it, before and behind."""
    answers = []
    for place in (0, 1):
        oscillation = Oscillation()
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


@pytest.mark.parametrize("frequency", [2.0, 3.7, 6.3])
def test_the_frequency_of_a_lasting_wave_is_told_to_a_hundredth(frequency):
    times = np.arange(0.0, 3.0, 1.0 / 30.0)
    wave = list(zip(times, 9.0 * np.sin(2.0 * np.pi * frequency * times), strict=True))
    assert rings(wave) == pytest.approx(frequency, rel=0.01)


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


def test_the_loudest_of_the_later_half_is_looked_at():
    ringing = zigzag(0, 9, 0, 9, 0, 9)
    assert rings(ringing, lambda t: 50.0 * (t < 0.5)) is not None
    assert rings(ringing, lambda t: 50.0 * (t > 1.2)) is None  # that one makes a single step
    assert rings(ringing, lambda t: 8.0 * (t > 1.2)) is not None


def test_only_the_last_two_seconds_count():
    oscillation = Oscillation()
    for t, e in zigzag(0, 9, 0, 9, 0, 9):
        last, answer = t, oscillation.add(t, np.array([e]))
    assert answer is not None
    for k in range(200):
        answer = oscillation.add(last + 0.01 * (k + 1), np.array([9.0]))
    assert answer is None


# -- is it the target? -----------------------------------------------------------

CORNERS = np.array([[-0.10, -0.05], [0.12, -0.04], [0.08, 0.06], [-0.03, 0.09]])


def of(corners):
    return Moments.from_polygon(np.asarray(corners), 4)


def said_of(evidence, seen, wanted, count=3):
    """What is said after each of `count` images."""
    see = SimpleNamespace(moments=seen)
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
            assert f"{by:.2f} times as spread out" in words and "differs by 0.00" in words


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
        assert f"its length differs by {longer:.2f}" in words
