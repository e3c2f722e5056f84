"""When steps are due, on a wall clock that the test turns."""

import pytest

from aras_sim_bridge.ros.runtime.pacing import BATCH_NS, Pacer

MS = 1_000_000


class Wall:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def wall():
    return Wall()


def test_steps_come_in_groups(wall):
    pacer = Pacer(1.0, wall)
    wall.now += 0.0099
    assert pacer.due_until(0) == 2 * BATCH_NS
    assert pacer.wait(2 * BATCH_NS) == pytest.approx(0.0021)


def test_an_event_does_not_wait_for_its_group(wall):
    pacer = Pacer(1.0, wall)
    assert pacer.wait(0, 3 * MS) == pytest.approx(0.003)
    wall.now += 0.0031
    assert pacer.due_until(0) == 0
    assert pacer.due_until(0, 3 * MS) == 3 * MS
    # Done with: the next to wait for is the group's end.
    assert pacer.wait(3 * MS, 3 * MS) == pytest.approx(0.0009)
    assert pacer.due_until(3 * MS, 3 * MS) <= 3 * MS


def test_an_event_ahead_changes_nothing(wall):
    pacer = Pacer(1.0, wall)
    wall.now += 0.005
    assert pacer.due_until(0, 50 * MS) == BATCH_NS
    assert pacer.wait(BATCH_NS, 50 * MS) == pytest.approx(0.003)


def test_a_late_event_costs_no_step(wall):
    pacer = Pacer(1.0, wall)
    wall.now += 0.009
    assert pacer.due_until(0, 3 * MS) == 2 * BATCH_NS


def test_at_full_speed_events_need_no_care(wall):
    pacer = Pacer(0.0, wall)
    assert pacer.due_until(0, 3 * MS) == BATCH_NS
    assert pacer.wait(0, 3 * MS) == 0.0
