"""Window of the latest errors: order, and restart when their number changes."""

import numpy as np
import pytest

from aras_visual_servo_controller.observation.recent_errors import RecentErrors


@pytest.mark.parametrize("kept", [1, 40, 63, 64, 65, 200])
def test_the_window_holds_the_newest_in_order(kept):
    recent = RecentErrors()
    for i in range(700):
        recent.add(0.1 * i, np.array([i, -2.0 * i, 0.5]))
        recent.drop_oldest(max(len(recent) - kept, 0))
        first = max(i + 1 - kept, 0)
        expected = np.arange(first, i + 1)
        assert len(recent) == len(expected)
        np.testing.assert_array_equal(recent.stamps, 0.1 * expected)
        np.testing.assert_array_equal(recent.errors[:, 1], -2.0 * expected)
        assert (recent.errors[:, 2] == 0.5).all()
    assert len(recent.stamps.base) <= max(4 * kept, 64)  # it does not grow for ever


def test_errors_of_another_length_begin_anew():
    recent = RecentErrors()
    recent.add(0.0, np.zeros(4))
    recent.add(0.1, np.ones(2))
    assert recent.stamps.tolist() == [0.1] and recent.errors.tolist() == [[1.0, 1.0]]
    recent.clear()
    assert len(recent) == 0


def test_rows_are_found_and_dropped_by_their_stamps():
    recent = RecentErrors()
    for i in range(10):
        recent.add(0.1 * i, np.array([float(i)]))
    stamps, rows = recent.since(0.55)
    assert rows[:, 0].tolist() == [6.0, 7.0, 8.0, 9.0] and len(stamps) == 4
    recent.drop_before(0.4)
    assert recent.errors[0, 0] == 4.0 and len(recent) == 6 and recent.width == 1
    assert len(recent.since(9.0)[0]) == 0
