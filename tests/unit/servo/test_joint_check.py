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


