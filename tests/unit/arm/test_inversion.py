"""Parts of the inverse kinematics, compared with NumPy and closed forms."""

import numpy as np
import pytest

from aras_visual_servo_controller.kinematics import (
    limits,
)

# ------------------------------------------------------------------------------- limits


@pytest.mark.parametrize("room", [1e-12, 1e-3, 0.2, 50.0])
@pytest.mark.parametrize("acceleration", [0.3, 8.0, 1e9])
@pytest.mark.parametrize("dt", [1e-3, 0.05, 2.0])
def test_the_greatest_speed_that_still_stops(room, acceleration, dt):
    """Kept for dt, then braked as hard as can be in many short steps."""
    speed = limits.compute_stopping_speed(room, acceleration, dt)
    steps = np.linspace(speed, 0.0, 1001)
    braking = 0.5 * (steps[1:] + steps[:-1]).sum() * (speed / 1000) / acceleration
    assert speed * dt + braking == pytest.approx(room, rel=1e-9, abs=0.0)


def test_speeds_that_no_braking_bounds():
    assert limits.compute_stopping_speed(0.2, np.inf, 0.05) == pytest.approx(4.0)
    assert limits.compute_stopping_speed(0.0, 2.0, 0.05) == 0.0
    for room, acceleration, dt in [(np.inf, 2.0, 0.05), (np.inf, np.inf, 0.05), (0.2, 2.0, 0.0)]:
        assert limits.compute_stopping_speed(room, acceleration, dt) == np.inf


def test_ranges_leave_room_to_stop_on_either_side():
    q = np.array([0.5, 0.9, -1.2, 1.3, 4.0])  # the third and fourth outside
    lower, upper = np.array([-1.0, -2.0, -1.0, -1.0, -np.inf]), np.array([1.0, 1.0, 1.0, 1.0, 5.0])
    acceleration, dt = np.array([2.0, 3.0, 4.0, 5.0, np.inf]), 0.1
    low, high = limits.compute_velocity_ranges(
        q, np.array([lower, upper, np.ones(5), acceleration]), dt
    )
    assert low[3] < 0.0 == high[3] and low[2] == 0.0 < high[2]
    for speeds, rooms in ((-low, q - lower), (high, upper - q)):
        stopped = speeds[:4] * dt + speeds[:4] ** 2 / (2.0 * acceleration[:4])
        np.testing.assert_allclose(stopped, np.maximum(rooms[:4], 0.0), rtol=1e-12)
    assert low[4] == -np.inf and high[4] == pytest.approx(10.0)
