"""Joints that do not follow their commands or oscillate are reported."""

import numpy as np
import pytest

from aras_visual_servo_controller.diagnosis.joint_check import JointCheck


def watched(images, commanded, measured, late=lambda k: (False, False), begin=7.0):
    """A JointCheck of J1 and J2 that was shown velocities (2,) by image, 30 a second."""
    check = JointCheck(("J1", "J2"))
    for k in range(images):
        check.add(begin + k / 30.0, np.array(late(k)), np.array(commanded(k), float),
                  np.array(measured(k), float))  # fmt: skip
    return check


def test_a_joint_that_swings_by_itself_is_told_at_once_and_before_what_it_does_to_the_picture():
    def swing(k):
        return 0.3, 0.3 + 16.0 * np.cos(40.0 * k / 30.0)

    assert not watched(10, lambda k: (0.3, 0.3), swing).reason  # 0.3 s have not passed
    assert not watched(14, lambda k: (0.3, 0.3), swing).reason  # every fifth image is looked at
    for check in (
        watched(15, lambda k: (0.3, 0.3), swing, lambda k: (True, False)),
        watched(15, lambda k: (-0.3, -0.3), lambda k: -np.array(swing(k))),
    ):
        assert check.joints == "J2"
        assert check.reason == (
            "the motion of J2 oscillates without a command, at up to 16.3 rad/s or m/s"
        )
    late = watched(60, lambda k: [np.cos(0.3 * k)] * 2, lambda k: [np.cos(0.3 * k - 1.0)] * 2)
    assert not late.reason  # one that follows a swinging command, late


@pytest.mark.parametrize(("size", "asked", "told"), [
    (0.49, 0.0, False), (0.51, 0.0, True), (-0.51, 0.0, True),
    (0.59, 0.2, False), (0.61, 0.2, True),
])  # fmt: skip
def test_how_fast_a_joint_has_to_be_on_its_own(size, asked, told):
    """By half a rad/s or m/s, rms, and by three times what was commanded."""
    check = watched(15, lambda k: (asked, 0.0), lambda k: (asked + size * (-1) ** k, 0.0))
    assert check.joints == ("J1" if told else "")
    assert (f"at up to {asked + abs(size):.1f} rad/s" in check.reason) is told


@pytest.mark.parametrize(("of_ten", "gone", "told"), [
    (6, 1.0, False), (7, 1.0, True), (2, 0.09, True), (2, 0.11, False), (1, 0.0, False),
])  # fmt: skip
def test_a_joint_stays_behind_where_the_loop_waits_for_it(of_ten, gone, told):
    """In more than six images of ten; or in more than one, where it goes less than a tenth of its
    way: as with velocities, of which a joint is sent new ones once the others stand."""
    check = watched(60, lambda k: (0.3, -0.2), lambda k: (0.3, -0.2 * gone),
                    lambda k: (False, k % 10 < of_ten))  # fmt: skip
    assert check.joints == ("J2" if told else "")
    assert check.reason == ("the motion of J2 does not follow the command" if told else "")


def test_joints_are_named_together_once_the_loop_has_waited_for_a_second_and_a_half():
    for images, named in ((40, ""), (60, "J1 and J2")):
        waiting = watched(images, lambda k: (0.3, -0.2), lambda k: (0, 0), lambda k: (True, True))
        assert waiting.joints == named
    for late, named in (
        (np.arange(60) >= 33, ""), (np.arange(60) >= 32, "J2"),  # of 46 images
        (np.arange(45) >= 18, ""), (np.arange(45) >= 17, "J2"),  # six of ten are not more
    ):  # fmt: skip
        check = watched(len(late), lambda k: (0.3, -0.2), lambda k: (0.3, -0.2),
                        lambda k, late=late: (False, late[k]))  # fmt: skip
        assert check.joints == named
    # and only of the last 1.5 s
    over = watched(90, lambda k: (0.3, 0.3), lambda k: (0.3, 0.3), lambda k: (k < 45, False))
    assert not over.joints


def judged(stamps, late, commanded, measured):
    """(joints, reason) by the images of the last 1.5 s, joints (m, 3)."""
    lately = stamps >= stamps[-1] - 1.5
    span = stamps[-1] - stamps[lately][0]
    late, asked, went = late[lately], commanded[lately], measured[lately]
    own = np.sqrt(np.mean((went - asked) ** 2, axis=0))
    swing = (own > 0.5) & (own > 3.0 * np.sqrt(np.mean(asked**2, axis=0)))
    behind = late.any(axis=0)
    if late.any(axis=1).mean() <= 0.6:
        gone = (asked * went).sum(axis=0) / (asked * asked).sum(axis=0)
        behind = (gone < 0.1) & (late.mean(axis=0) > 0.1)
    found = behind & (span >= 0.9 * 1.5)
    reason = "the motion of {} does not follow the command"
    if span > 0.3 and swing.any():
        found = swing
        fastest = np.abs(went[:, swing]).max()
        reason = (
            f"the motion of {{}} oscillates without a command, at up to {fastest:.1f} rad/s or m/s"
        )
    names = [f"J{i + 1}" for i in np.flatnonzero(found)]
    joints = " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
    return joints, reason.format(joints) if names else ""


@pytest.mark.parametrize("seed", range(8))
def test_every_fifth_image_the_joints_of_a_second_and_a_half_are_judged(seed):
    random, check = np.random.default_rng(seed), JointCheck(("J1", "J2", "J3"))
    stamps = 5.0 + np.cumsum(random.uniform(0.02, 0.05, 100))
    late = random.random((100, 3)) < random.choice([0.0, 0.07, 0.2, 0.5], 3)
    commanded = random.normal(size=3) * np.cos(0.3 * np.arange(100))[:, None]
    measured = commanded * random.choice([0.0, 0.05, 0.2, 1.0], 3)
    measured += random.choice([0.0, 0.4, 2.0], 3) * random.normal(size=(100, 3))
    measured[50:] = commanded[50:]
    said = "", ""
    for k in range(100):
        check.add(stamps[k], late[k], commanded[k], measured[k])
        if k % 5 == 4:
            upto = slice(k + 1)
            said = judged(stamps[upto], late[upto], commanded[upto], measured[upto])
        assert (check.joints, check.reason) == said, k
