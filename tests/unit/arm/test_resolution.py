"""Properties of IK solutions that the arm computes or that are read from messages."""

import numpy as np
import pytest

from aras_visual_servo_controller.kinematics.ik_solution import IKSolution, rank


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_a_rank_counts_what_is_more_than_rounding(size):
    assert rank(size * np.array([3.0, 3.3e-12, 2.7e-12])) == 2
    assert rank(size * np.array([3.0, 0.0])) == 1


@pytest.mark.parametrize("none", [[], [0.0], [0.0, 0.0]])
def test_nothing_has_no_rank(none):
    assert rank(np.array(none)) == 0


def test_what_a_message_does_not_tell_is_not_a_number():
    asked, twist, velocities = np.arange(6.0), np.arange(1.0, 7.0), np.array([0.1, -0.2, 0.3])
    told = np.array([4.0, 2.0]), np.array([2.0, 1e-5, 1e-12])
    found = IKSolution.from_record(velocities, asked, twist, told, scale=0.5)
    assert (
        found.velocities is velocities
        and found.desired_twist is asked
        and found.achieved_twist is twist
    )
    assert (found.scale, found.rank) == (0.5, 2)
    assert found.manipulability == pytest.approx(2e-17, rel=1e-9, abs=0.0)
    np.testing.assert_array_equal(found.singular_values_L, told[0])
    for unknown, count in ((found.infeasible_twist, 6), (found.primary, 3), (found.margins, 3)):
        np.testing.assert_array_equal(unknown, np.full(count, np.nan))
    assert found.L.shape == (0, 6) and found.jacobian.shape == (6, 3)
