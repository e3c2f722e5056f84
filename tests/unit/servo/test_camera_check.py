"""Whether the camera's motion explains how the features moved: verdicts against least squares
written row by row, and bounds from both sides."""

from types import SimpleNamespace

import numpy as np
import pytest

from aras_visual_servo_controller.diagnosis.camera_check import (
    DIRECTIONS,
    CameraCheck,
    _predict_motion,
)
from aras_visual_servo_controller.kinematics.joint_sample import JointSample


class Rows:
    """The same check from the rows themselves instead of sums of their products."""

    def __init__(self):
        self.rows, self.values, self.path = [np.empty((0, 6))], [np.empty(0)], 0.0
        self.begin()

    def begin(self):
        """A row is what happened from here on."""
        self.parts, self.moved, self.shaken, self.images = 0.0, 0.0, 0.0, 0

    def smooth(self, off):
        """Return whether the residuals of successive images are correlated."""
        off = np.split(off, np.cumsum([len(value) for value in self.values[1:]])[:-1])
        together = sum(one @ other for one, other in zip(off, off[1:], strict=False))
        return together > 0.2 * sum(each @ each for each in off)

    def add(self, before, now, twist, tolerances, shaken, dt):
        (error_before, L_before, rate_before), (error, L, rate) = before, now
        moved = (error - error_before) / tolerances
        parts = self.parts + 0.5 * (L_before + L) * twist / tolerances[:, None]
        bent = np.abs((L - L_before) @ twist / tolerances).max()
        far = np.abs(parts.sum(axis=1)).max()
        if np.abs(moved).max() > 1.0 / tolerances.max() or bent > max(0.3 * far, 3.0):
            self.begin()
            return
        moved = moved - 0.5 * (rate_before + rate) * dt / tolerances
        self.parts = parts
        self.moved, self.shaken = self.moved + moved, max(self.shaken, shaken)
        self.images += 1
        predicted = np.abs(self.parts.sum(axis=1)).max()
        if predicted >= 3.0:
            weight = 1.0 / (1.0 + 0.3 * self.shaken)
            self.rows.append(weight * self.parts)
            self.values.append(weight * self.moved)
            self.path += weight * predicted
            self.begin()
        elif self.images == 4:
            self.begin()

    def fault(self):
        A, b = np.vstack(self.rows), np.concatenate(self.values)
        if self.path <= 40.0:
            return ""
        along, turning = A[:, :3].sum(axis=1), A[:, 3:].sum(axis=1)
        depth = 1.0
        if along @ along > 3.0**2:
            depth = along @ (b - turning) / (along @ along)
        if depth <= 0.0:
            return ("the features do not move as L and the arm's motion predict: "
                    "when the camera translates, they move in the opposite direction")
        expected = np.array([depth] * 3 + [1.0] * 3)
        off = b - A @ expected
        misfit = off @ off / (b @ b)
        loud = np.sqrt(off @ off / len(b)) > 1.5
        if misfit > 0.04 and loud and self.smooth(off):
            return ("the features do not move as L and the arm's motion predict: "
                    f"{100.0 * misfit:.0f} % of the motion is not explained")
        # One row more a direction, of little weight: where nothing was seen, it is as expected.
        weak = np.sqrt(0.1) * np.eye(6)
        known = np.vstack([A, weak])
        scale = np.linalg.lstsq(known, np.concatenate([b, weak @ expected]), rcond=None)[0]
        left = b - A @ scale
        noise = max(np.sqrt(left @ left / max(len(b) - 6, 1)), 0.05)
        spread = np.linalg.inv(known.T @ known)
        found = []
        for one, other in [(1, 0), (2, 0), (2, 1), (3, 3), (4, 4), (5, 5)]:
            compared = np.zeros(6)
            compared[one], unit, least = 1.0, 1.0, 8.0
            away = scale[one] - 1.0
            if one != other:
                compared[other], unit, least = -1.0, depth, 3.0
                away = scale[one] - scale[other]
            unknown = np.sqrt(compared @ spread @ compared)
            doubt = 4.0 * noise * unknown / unit
            if unknown <= 1.0 / least:
                lowered = left @ left * unknown**2
                found.append((abs(away) / unit - 0.04 - lowered - doubt, one, other))
        over, one, other = max(found, default=(0.0, 0, 0))
        if over <= 0.0:
            return ""
        if one != other and abs(scale[one] - 1.0) < abs(scale[other] - 1.0):
            one, other = other, one
        beside = f"{scale[other]:.2f} times as far along {DIRECTIONS[other]}"
        if one == other:
            beside = "1.00 times as far in other directions"
        return (f"the features move {scale[one]:.2f} times as far along {DIRECTIONS[one]} as L "
                f"and the arm's motion predict, but {beside}")


def judged(seed, jacobian=None):
    """(what the evidence says, what the rows say) of a run drawn by the seed."""
    random = np.random.default_rng(seed)
    evidence, rows = CameraCheck(None if jacobian is None else lambda q: jacobian), Rows()
    tolerances = 1e-3 * random.uniform(0.5, 2.0, 4)
    scale = np.ones(6)
    scale[:3] *= random.choice([-0.3, 0.25, 1.0, 2.5], p=[0.1, 0.3, 0.3, 0.3])
    scale[random.integers(6)] *= random.choice([1.0, 0.93, 1.1, 1.4])
    noise = random.choice([0.0, 0.3, 1.0, 4.0, 20.0], p=[0.1, 0.3, 0.3, 0.2, 0.1])
    size = random.choice([1e-3, 1e-2, 3e-2])
    drift = random.choice([0.0, 40.0], p=[0.7, 0.3]) * tolerances * random.normal(size=4)
    error, before, joints = random.normal(size=4), None, None
    L = random.normal(size=(4, 6))
    for k in range(int(random.integers(2, 30))):
        past = 0.04 + 0.02 * np.sin(k)
        # One number for all features, or one for each.
        rate = 0.2 * np.cos(k + np.arange(1 if seed % 2 else 4))
        # It changes a little from image to image, or too much to say anything of that step.
        L = 0.98 * L + 0.15 * random.normal(size=(4, 6))
        twist = size * random.normal(size=6) * (random.random(6) < 0.8)
        twist[:3] *= 1e-3 if seed % 6 == 5 else 1.0  # so little tells no depth
        if before is not None:
            error = before[0] + 0.5 * (before[1] + L) * scale @ twist
            error = error + 0.5 * (before[2] + rate) * past
            error = error + noise * tolerances * random.normal(size=4) + drift
            if random.random() < 0.1:
                error = error + 2.0  # an angle that wrapped round
        last, shaken = joints, 0.0
        joints = JointSample.from_values(k / 30.0, "xyz", 1e-3 * random.normal(size=3),
                                0.03 * random.normal(size=3))  # fmt: skip
        if before is not None and jacobian is not None:
            dt, change = joints.stamp - last.stamp, joints.velocities - last.velocities
            told = 0.5 * (last.velocities + joints.velocities) * dt
            doubt = np.abs(joints.positions - last.positions - told)
            doubt = doubt + 0.25 * dt * np.abs(change)
            ways = np.abs(L @ jacobian * doubt) / tolerances[:, None]
            shaken = ways.max()
        evidence.add(
            SimpleNamespace(error_drift=rate, L=L, error=error),
            SimpleNamespace(motion=twist, dt=past, joints=joints), tolerances,
        )  # fmt: skip
        if before is not None:
            rows.add(before, (error, L, rate), twist, tolerances, shaken, past)
        before = error, L, rate
    return evidence.find_fault(), rows.fault()


@pytest.mark.parametrize("first", range(0, 80, 20))
@pytest.mark.parametrize("shaken", [False, True])
def test_the_camera_is_judged_as_least_squares_over_all_rows_say(shaken, first):
    jacobian = np.random.default_rng(5).normal(size=(6, 3)) if shaken else None
    kinds = set()
    for seed in range(first, first + 20):
        said, wanted = judged(seed, jacobian)
        assert said == wanted, seed
        kinds.add(wanted.partition(" ")[0] + ("%" if "%" in wanted else ""))
    # or this shows little, of: innocent, one direction, against the translation, unexplained
    assert len(kinds) >= 3, kinds


@pytest.mark.parametrize("seed", range(6))
def test_what_each_direction_should_have_done_is_added_up_image_by_image(seed):
    """Errors jump by 0.9 to 1.2, some of them an angle's: of the widest tolerance, all by 1."""
    random = np.random.default_rng(seed)
    count, images = 3 + seed % 3, 5
    tolerances = 1e-3 * random.uniform(0.5, 2.0, count)
    errors = np.cumsum(random.choice([-1.0, 1.0], (images, count)) * random.uniform(
        0.0, 0.9, (images, count)) * tolerances / tolerances.max(), axis=0)
    jump = (0.95, 1.05, 1.2)[seed % 3] * tolerances[seed % count] / tolerances.max()
    errors[3:, seed % count] += errors[2, seed % count] - errors[3, seed % count] + jump
    Ls = random.normal(size=(images, count, 6))
    rates = random.normal(size=(images, 1 if seed % 2 else count))
    motions, spans = random.normal(size=(images, 6)), random.uniform(0.02, 0.06, images)
    parts, own, wanted, past = np.zeros((count, 6)), np.zeros(count), 0.0, 0.0
    for k in range(1, images):
        greatest, wrapped, bent = _predict_motion(
            errors[k - 1], Ls[k - 1], rates[k - 1], errors[k], Ls[k], rates[k], motions[k],
            spans[k], tolerances, parts, own, np.ones(count, bool),
        )  # fmt: skip
        wanted = wanted + (Ls[k - 1] + Ls[k]) / 2.0 * motions[k] / tolerances[:, None]
        past = past + (rates[k - 1] + rates[k]) / 2.0 * spans[k]
        np.testing.assert_allclose(parts, wanted)
        np.testing.assert_allclose(own, np.broadcast_to(past, count))
        assert greatest == pytest.approx(np.abs(wanted.sum(axis=1)).max())
        assert wrapped == (k == 3 and seed % 3 > 0)
        assert bent == pytest.approx(np.abs((Ls[k] - Ls[k - 1]) @ motions[k] / tolerances).max())


def test_only_an_image_that_follows_another_counts():
    """Of a pair one of which has no L, no motion or other features, nothing can be said."""
    L, twist = np.ones((2, 6)), 0.01 * np.ones(6)
    tolerances = np.full(2, 1e-3)
    wrong = [-0.2 * k * np.ones(2) for k in range(8)]  # against the motion: found at once

    def said(change):
        evidence = CameraCheck()
        for k, error in enumerate(wrong):
            decision = {"L": L, "error": error, "error_drift": 0.0}
            seen = {"motion": twist, "dt": 1 / 30, "joints": None}
            if k % 2:
                change(decision, seen)
            evidence.add(SimpleNamespace(**decision), SimpleNamespace(**seen),
                         np.full(len(decision["error"]), 1e-3))
        return evidence.find_fault()

    assert said(lambda decision, seen: None)
    assert not said(lambda decision, seen: decision.update(L=None))
    assert not said(lambda decision, seen: decision.update(L=np.ones((3, 6))))
    assert not said(lambda decision, seen: decision.update(L=np.ones((3, 6)), error=np.ones(3)))
    evidence = CameraCheck()
    for error in wrong:
        evidence.add(SimpleNamespace(error_drift=0.0, L=L, error=error),
                     SimpleNamespace(motion=None, dt=1 / 30, joints=None), tolerances)
    assert not evidence.find_fault()


def shown(evidence, error, L, motion, tolerances, error_drift=0.0, joints=None):
    """Add one image to a CameraCheck, after a motion (6,) of the camera."""
    evidence.add(SimpleNamespace(error_drift=error_drift, L=L, error=error),
                 SimpleNamespace(motion=motion, dt=1 / 30, joints=joints), tolerances)


def seen_by(
    scale, images=12, noise=0.0, seed=0, count=4, tolerance=1e-3, drift=0.0, error_drift=0.0
):
    """Evidence of features that move `scale` (6,) times as far as L says, by direction, and by
    `drift` tolerances an image besides; the scheme says that they do so by `error_drift`, 1/s."""
    random = np.random.default_rng(seed)
    evidence, tolerances = CameraCheck(), np.full(count, tolerance)
    L = random.normal(size=(count, 6))
    error, twist = random.normal(size=count), np.zeros(6)
    for _ in range(images):
        measured = error + noise * tolerance * random.normal(size=count)
        shown(evidence, measured, L, twist, tolerances, error_drift)
        twist = 2e-2 * random.normal(size=6)
        error = error + (L * scale) @ twist + drift * tolerance
    return evidence


ONE = np.ones(6)


def test_no_evidence_is_no_fault():
    assert CameraCheck().find_fault() == ""


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize("depth", [0.5, 1.0, 2.0])
def test_one_depth_for_all_translations_is_no_fault(noise, depth):
    for seed in range(8):
        scale = np.array([depth] * 3 + [1.0] * 3)
        assert seen_by(scale, 30, noise, seed).find_fault() == ""


@pytest.mark.parametrize("factor", [0.7, 1.3])
@pytest.mark.parametrize("direction", range(6))
def test_the_direction_that_is_off_is_named(direction, factor):
    scale = ONE.copy()
    scale[direction] = factor
    for seed in range(3):
        words = seen_by(scale, 30, 0.5, seed).find_fault()
        if direction < 3:  # which of the three is off can only be told from the other two
            assert words.split()[1] in DIRECTIONS[:3]
        else:
            assert words.startswith(f"along {DIRECTIONS[direction]} ")
            found = float(words.split(" move ")[1].split(" times")[0])
            assert found == pytest.approx(factor, abs=0.03)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_two_translations_are_compared_however_little_one_of_them_is(factor):
    """The camera came down by a centimetre and went far aside: one depth for all lay by the
    sideways way, and a focal length of 0.9 times the true one passed."""
    evidence, way = CameraCheck(), 1e-3 * np.array([8.0, 5.0, 1.0, 0.0, 0.0, 0.0])
    for k in range(30):
        shown(evidence, k * way[:3] * [1.0, 1.0, factor], np.eye(6)[:3], way, np.full(3, 1e-3))
    assert evidence.find_fault().startswith(f"along vz the features move {factor:.2f} times")
    assert evidence.find_fault().endswith("along vx 1.00 times as far")


@pytest.mark.parametrize(("off", "told"), [(0.048, True), (0.036, False)])
def test_translations_that_take_each_other_back_tell_no_depth_and_are_compared(off, told):
    """Along x and y at once, which move features the other way; a turn moves them besides."""
    evidence, way = CameraCheck(), 1e-3 * np.array([10.0, 10.0, 0.0, 5.0, 0.0, 0.0])
    L = np.array([[1.0, -1.0, 0.0, 1.0, 0.0, 0.0], [1.0, -1.0, 0.0, -1.0, 0.0, 0.0]])
    scale = np.array([1.0, 1.0 - off, 1.0, 1.0, 1.0, 1.0])
    for k in range(30):
        shown(evidence, k * (L * scale) @ way, L, way, np.full(2, 1e-3))
    assert bool(evidence.find_fault()) is told


def slowly(step, images, factor=0.8):
    """Evidence of a camera that goes by `step` tolerances an image, along x and z in turn."""
    evidence, position, way = CameraCheck(), np.zeros(3), np.zeros(6)
    for k in range(images):
        position = position + way[:3]
        shown(evidence, position * [1.0, 1.0, factor], np.eye(6)[:3], way, np.full(3, 1e-3))
        way = 1e-3 * step * np.eye(6)[2 * (k // 8 % 2)]
    return evidence.find_fault()


def test_slow_motion_is_added_up_over_four_images_and_no_more():
    assert slowly(4.0, 60) and slowly(1.6, 160) and slowly(0.8, 320)
    assert not slowly(0.7, 320)


def test_a_little_off_is_within_what_can_be_measured():
    assert seen_by(np.array([1.0, 1.0, 0.96, 1.0, 1.0, 1.04]), 30, 0.5).find_fault() == ""


def test_motion_the_other_way_and_motion_of_its_own_are_faults():
    against = seen_by(np.array([-1.0] * 3 + [1.0] * 3)).find_fault()
    assert "when the camera translates, they move in the opposite direction" in against
    evidence = seen_by(ONE, 40, drift=20.0)
    assert "of the motion is not explained" in evidence.find_fault()
    assert "4 % of the motion is not explained" in seen_by(ONE, 40, drift=8.0).find_fault()
    assert not seen_by(ONE, 40, drift=7.0).find_fault()
    assert not seen_by(ONE, 40, noise=20.0).find_fault()  # which is as loud, and goes on in no row
    for known in (60.0, np.array([60.0, -40.0, 20.0, 80.0])):  # as the scheme knows
        assert not seen_by(ONE, 40, drift=known, error_drift=known * 30.0 * 1e-3).find_fault()
    assert seen_by(ONE, 40, error_drift=20.0 * 30.0 * 1e-3).find_fault()


@pytest.mark.parametrize(("off", "goes_on"), [((3, 3, -3, -3), True), ((5, 1, -1, -5), False)])
def test_what_is_not_explained_has_to_go_on_from_one_row_to_the_next(off, goes_on):
    """By a fifth: here it does by a quarter, and by 0.17. Of four rows, each counts."""
    evidence, error, way = CameraCheck(), np.zeros(1), 0.012 * np.eye(6)[0]
    for tolerances in (0.0, *off):
        shown(evidence, error := error + 6e-3 + 1e-3 * tolerances, np.eye(6)[:1], way,
              np.full(1, 1e-3))  # fmt: skip
    assert bool(evidence.find_fault()) is goes_on


def test_noise_hides_what_it_hides_and_is_no_fault():
    """A scale is judged by how well it is known."""
    scale = np.array([1.0, 1.0, 1.0, 1.0, 0.8, 1.0])
    assert seen_by(scale, 30, noise=0.2).find_fault()
    assert not seen_by(scale, 6, noise=4.0).find_fault()


@pytest.mark.parametrize(("step", "scale", "accused"), [
    (1.0, 1.0, False), (0.1, 1.0, False), (0.1, 0.8, True),
])  # fmt: skip
def test_steps_in_which_L_changes_much_accuse_no_camera(step, scale, accused):
    """s = 0.3 sin x: over a step of 1 rad the mean L says 0.92 of the way."""
    random, evidence, x, motion = np.random.default_rng(2), CameraCheck(), np.zeros(6), np.zeros(6)
    for _ in range(40):
        L = 0.3 * np.diag(np.cos(x))
        shown(evidence, 0.3 * np.sin(x), L, motion / scale, np.full(6, 1e-3))
        motion = step * random.choice([-1.0, 1.0], 6) * random.uniform(0.8, 1.0, 6)
        x = x + motion
    assert bool(evidence.find_fault()) == accused, evidence.find_fault()


def test_little_motion_and_broken_sequences_are_no_evidence():
    wrong = np.array([0.5, 1.0, 0.5, 1.0, 0.5, 1.0])
    assert seen_by(wrong, 30).find_fault()
    assert not seen_by(wrong, 30, tolerance=0.5).find_fault()  # slower than 3 tolerances an image
    assert not seen_by(wrong, 1).find_fault()
    evidence = CameraCheck()
    for k in range(40):
        evidence.interrupt()
        shown(evidence, np.full(2, 0.01 * k), np.ones((2, 6)), 0.01 * ONE, np.full(2, 1e-3))
    assert not evidence.find_fault()


def believed_by_shaken_joints(shake, scale, jacobian, images=40, seed=0):
    """Evidence by joints, here the camera's own directions, that go on at their last speeds from
    the last sample to the exposure: speeds that shake put them beside where they truly are."""
    random, names = np.random.default_rng(seed), tuple("xyzabc")
    evidence, tolerances, gap = CameraCheck(jacobian), np.full(4, 1e-3), 0.008
    L, true, before = random.normal(size=(4, 6)), np.zeros(6), None
    steady = np.zeros(6)
    for k in range(images):
        wanted = 0.5 * random.normal(size=6)
        true, steady = true + 0.5 * (steady + wanted) / 30.0, wanted
        off = shake * random.normal(size=6)
        believed = true + off * gap
        joints = JointSample.from_values(k / 30.0, names, believed, steady + off)
        moved = np.zeros(6) if before is None else believed - before
        shown(evidence, (L * scale) @ true, L, moved, tolerances, joints=joints)
        before = believed
    return evidence


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_shaken_arm_is_no_evidence_against_its_camera(seed):
    """A loaded machine's demo was told to calibrate its camera: late commands shook J5, and between
    two joint states nobody knew where it was."""
    assert not believed_by_shaken_joints(2.1, ONE, lambda q: np.eye(6), seed=seed).find_fault()
    assert believed_by_shaken_joints(2.1, ONE, None, seed=seed).find_fault()


@pytest.mark.parametrize("seed", range(3))
def test_an_arm_that_moves_steadily_is_evidence(seed):
    wrong = np.array([1.0, 1.0, 1.0, 0.6, 0.6, 0.6])
    for shake in (0.0, 0.01):
        assert believed_by_shaken_joints(shake, wrong, lambda q: np.eye(6), seed=seed).find_fault()
    assert not believed_by_shaken_joints(0.01, ONE, lambda q: np.eye(6), seed=seed).find_fault()
