"""Whether the camera's motion explains how the features moved: verdicts against least squares
written row by row, and bounds from both sides."""

import numpy as np
import pytest
from loop_rig import an_image

from aras_visual_servo_controller.diagnosis.camera_model_check import DIRECTIONS, CameraModelCheck
from aras_visual_servo_controller.diagnosis.feature_rows import FeatureHistory
from aras_visual_servo_controller.kinematics.joint_sample import JointSample


def test_only_an_image_that_follows_another_counts():
    """Of a pair one of which has no L, no motion or other features, nothing can be said."""
    given = {"error": np.zeros(2), "L": np.ones((2, 6)), "motion": 0.01 * np.ones(6)}

    def said(**other):
        evidence, history = CameraModelCheck(), FeatureHistory()
        for k in range(8):  # against the motion: found at once
            now = {**given, "error": -0.2 * k * np.ones(2)}
            now |= other if k % 2 or "motion" in other else {}
            shown(evidence, history, now["error"], now["L"], now["motion"], 1e-3)
        return evidence.find_fault()

    assert said() and CameraModelCheck().find_fault() == ""
    for other in ({"L": None}, {"L": np.ones((3, 6))}, {"motion": None},
                  {"L": np.ones((3, 6)), "error": np.ones(3)}):  # fmt: skip
        assert not said(**other)


def shown(evidence, history, error, L, motion, tolerances, error_drift=0.0, joints=None, stamp=0.0):
    """Add one image to a CameraModelCheck, after a motion (6,) of the camera."""
    image = an_image(stamp, 1 / 30, motion, joints=joints)
    history.add(image, error, L, error_drift, tolerances, True)
    evidence.add(history, image)


def seen_by(
    scale, images=12, noise=0.0, seed=0, count=4, tolerance=1e-3, drift=0.0, error_drift=0.0
):
    """Evidence of features that move `scale` (6,) times as far as L says, by direction, and by
    `drift` tolerances an image besides; the scheme says that they do so by `error_drift`, 1/s."""
    random = np.random.default_rng(seed)
    evidence, history = CameraModelCheck(), FeatureHistory()
    tolerances = np.full(count, tolerance)
    L = random.normal(size=(count, 6))
    error, twist = random.normal(size=count), np.zeros(6)
    for _ in range(images):
        measured = error + noise * tolerance * random.normal(size=count)
        shown(evidence, history, measured, L, twist, tolerances, error_drift)
        twist = 2e-2 * random.normal(size=6)
        error = error + (L * scale) @ twist + drift * tolerance
    return evidence


ONE = np.ones(6)


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize("depth", [0.5, 1.0, 2.0])
def test_one_depth_for_all_translations_is_no_fault(noise, depth):
    for seed in range(8):
        scale = np.array([depth] * 3 + [1.0] * 3)
        assert seen_by(scale, 30, noise, seed).find_fault() == ""
    # Nor is what is a little off within what can be measured, or what noise hides.
    assert seen_by(np.array([1.0, 1.0, 0.96, 1.0, 1.0, 1.04]), 30, 0.5).find_fault() == ""
    scale = np.array([1.0, 1.0, 1.0, 1.0, 0.8, 1.0])
    assert seen_by(scale, 30, noise=0.2).find_fault()
    assert not seen_by(scale, 6, noise=4.0).find_fault()


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
    evidence, history = CameraModelCheck(), FeatureHistory()
    way = 1e-3 * np.array([8.0, 5.0, 1.0, 0.0, 0.0, 0.0])
    for k in range(30):
        shown(evidence, history, k * way[:3] * [1.0, 1.0, factor], np.eye(6)[:3], way, 1e-3)
    assert evidence.find_fault().startswith(f"along vz the features move {factor:.2f} times")
    assert evidence.find_fault().endswith("along vx 1.00 times as far")


@pytest.mark.parametrize(("step", "images", "found"), [
    (4.0, 60, True), (0.8, 320, True), (0.7, 320, False),
])  # fmt: skip
def test_slow_motion_is_added_up_over_four_images_and_no_more(step, images, found):
    """A camera that goes by `step` tolerances an image, along x and z in turn."""
    evidence, history = CameraModelCheck(), FeatureHistory()
    position, way = np.zeros(3), np.zeros(6)
    for k in range(images):
        position = position + way[:3]
        shown(evidence, history, position * [1.0, 1.0, 0.8], np.eye(6)[:3], way, 1e-3)
        way = 1e-3 * step * np.eye(6)[2 * (k // 8 % 2)]
    assert bool(evidence.find_fault()) is found


def test_motion_the_other_way_and_motion_of_its_own_are_faults():
    against = seen_by(np.array([-1.0] * 3 + [1.0] * 3)).find_fault()
    assert "when the camera translates, they move in the opposite direction" in against
    for drift in (20.0, 8.0):
        assert "% of the motion is not explained" in seen_by(ONE, 40, drift=drift).find_fault()
    assert not seen_by(ONE, 40, drift=7.0).find_fault()
    assert not seen_by(ONE, 40, noise=20.0).find_fault()  # which is as loud, and goes on in no row
    for known in (60.0, np.array([60.0, -40.0, 20.0, 80.0])):  # as the scheme knows
        assert not seen_by(ONE, 40, drift=known, error_drift=known * 30.0 * 1e-3).find_fault()
    assert seen_by(ONE, 40, error_drift=20.0 * 30.0 * 1e-3).find_fault()


@pytest.mark.parametrize(("step", "scale", "accused"), [
    (1.0, 1.0, False), (0.1, 1.0, False), (0.1, 0.8, True),
])  # fmt: skip
def test_steps_in_which_L_changes_much_accuse_no_camera(step, scale, accused):
    """s = 0.3 sin x: over a step of 1 rad the mean L says 0.92 of the way."""
    random, evidence, history = np.random.default_rng(2), CameraModelCheck(), FeatureHistory()
    x, motion = np.zeros((2, 6))
    for _ in range(40):
        L = 0.3 * np.diag(np.cos(x))
        shown(evidence, history, 0.3 * np.sin(x), L, motion / scale, 1e-3)
        motion = step * random.choice([-1.0, 1.0], 6) * random.uniform(0.8, 1.0, 6)
        x = x + motion
    assert bool(evidence.find_fault()) == accused, evidence.find_fault()


def test_little_motion_and_broken_sequences_are_no_evidence():
    wrong = np.array([0.5, 1.0, 0.5, 1.0, 0.5, 1.0])
    assert seen_by(wrong, 30).find_fault()
    assert not seen_by(wrong, 30, tolerance=0.5).find_fault()  # slower than 3 tolerances an image
    assert not seen_by(wrong, 1).find_fault()
    evidence, history = CameraModelCheck(), FeatureHistory()
    for k in range(40):
        shown(
            evidence, history, np.full(2, 0.01 * k), np.ones((2, 6)), 0.01 * ONE, 1e-3,
            stamp=0.1 * k,
        )  # fmt: skip
    assert not evidence.find_fault()


def believed_by_shaken_joints(shake, scale, jacobian, images=40, seed=0):
    """Evidence by joints, here the camera's own directions, that go on at their last speeds from
    the last sample to the exposure: speeds that shake put them beside where they truly are."""
    random, names = np.random.default_rng(seed), tuple("xyzabc")
    evidence, history, gap = CameraModelCheck(jacobian), FeatureHistory(), 0.008
    L, true, before = random.normal(size=(4, 6)), np.zeros(6), None
    steady = np.zeros(6)
    for k in range(images):
        wanted = 0.5 * random.normal(size=6)
        true, steady = true + 0.5 * (steady + wanted) / 30.0, wanted
        off = shake * random.normal(size=6)
        believed = true + off * gap
        joints = JointSample.from_values(k / 30.0, names, believed, steady + off)
        moved = np.zeros(6) if before is None else believed - before
        shown(evidence, history, (L * scale) @ true, L, moved, 1e-3, joints=joints)
        before = believed
    return evidence


@pytest.mark.parametrize("seed", range(1, 4))
def test_a_shaken_arm_is_no_evidence_against_its_camera(seed):
    """A loaded machine's demo was told to calibrate its camera: late commands shook J5, and between
    two joint states nobody knew where it was. One that moves steadily is evidence."""
    def found(shake, scale=ONE, jacobian=lambda q: np.eye(6)):
        return bool(believed_by_shaken_joints(shake, scale, jacobian, seed=seed).find_fault())

    assert not found(2.1) and found(2.1, jacobian=None)
    wrong = np.array([1.0, 1.0, 1.0, 0.6, 0.6, 0.6])
    assert found(0.0, wrong) and found(0.01, wrong) and not found(0.01)
