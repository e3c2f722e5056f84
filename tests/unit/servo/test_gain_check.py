"""A gain that is too high for the delay is reported before the error has oscillated twice."""

import numpy as np
import pytest

from aras_visual_servo_controller.diagnosis.gain_check import GainCheck
from aras_visual_servo_controller.laws import Proportional
from aras_visual_servo_controller.schemes import create_scheme

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


def test_one_that_suits_the_delay_loses_no_target():
    check, _ = delayed(0.3 / 0.25, 0.25)
    assert check.delay_outcome is None and check.explain_loss("lost") is None
    before_any_overshoot, _ = delayed(6.0, 0.25, until=0.3)
    assert (
        before_any_overshoot.delay_outcome is not None
        and before_any_overshoot.explain_loss("lost") is None
    )


def test_the_remedy_leaves_the_lower_gain_its_time():
    remedy = delayed(6.0, 0.25, duration=3.0)[0].delay_outcome.remedy
    changes = {change.key: change.value for change in remedy.changes}
    assert 3.0 * changes["duration"] > 8.0 / (6.0 * changes["gain"])


@pytest.mark.parametrize(("growth", "found"), [(1.5, True), (0.8, False), (0.0, False)])
def test_a_target_that_a_growing_swing_has_lost_before_its_frequency_is_known(growth, found):
    check = GainCheck()
    for k in range(30):
        error = 20.0 * growth ** (k / 6.0) * np.cos(np.pi * k / 6.0)
        check.add(k * PERIOD, np.array([error, 1.0]), SCHEME, 0.0)
    lost = check.explain_loss("the target was lost")
    assert (lost is not None) == found and (not found or "growing amplitude" in lost.reason)
