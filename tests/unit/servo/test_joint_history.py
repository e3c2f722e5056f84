"""An image has to meet the joints of its own instant, whatever arrived first."""

import numpy as np
import pytest

from aras_visual_servo_controller.before.joint_history import JointHistory


@pytest.fixture
def history():
    """Samples at 1, 11, 21 and 31 ms, each filled with its number."""
    it = JointHistory()
    for k in range(4):
        it.add(0.001 + 0.01 * k, np.full(6, float(k)))
    return it


@pytest.mark.parametrize(("stamp", "sample"), [(0.0209, 1), (0.021, 2), (0.0333, 3), (0.5, 3)])
def test_last_sample_at_or_before_the_stamp(history, stamp, sample):
    assert history.at(stamp)[0] == sample


def test_nothing_before_the_first_sample(history):
    assert history.at(0.0009) is None


def test_waits_for_the_sample_that_must_be_on_its_way(history):
    assert history.complete_to(0.0333)
    assert not history.complete_to(0.0667)
    history.add(0.041, np.zeros(6))
    history.add(0.051, np.zeros(6))
    assert not history.complete_to(0.0667)
    history.add(0.061, np.zeros(6))
    assert history.complete_to(0.0667)


def test_one_sample_tells_no_period(history):
    history.clear()
    assert not history.complete_to(0.0333)
    history.add(0.001, np.zeros(6))
    assert not history.complete_to(0.0005)
