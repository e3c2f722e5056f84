"""Pacing of steps on a wall clock that the test sets."""

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
    assert pacer.find_due_time(0) == 2 * BATCH_NS
    assert pacer.compute_wait(2 * BATCH_NS) == pytest.approx(0.0021)


def test_an_event_does_not_wait_for_its_group(wall):
    pacer = Pacer(1.0, wall)
    assert pacer.compute_wait(0, 3 * MS) == pytest.approx(0.003)
    wall.now += 0.0031
    assert pacer.find_due_time(0) == 0
    assert pacer.find_due_time(0, 3 * MS) == 3 * MS
    # Done with: the next to wait for is the group's end.
    assert pacer.compute_wait(3 * MS, 3 * MS) == pytest.approx(0.0009)
    assert pacer.find_due_time(3 * MS, 3 * MS) <= 3 * MS


def test_at_full_speed_events_need_no_care(wall):
    pacer = Pacer(0.0, wall)
    assert pacer.find_due_time(0, 3 * MS) == BATCH_NS
    assert pacer.compute_wait(0, 3 * MS) == 0.0


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 3.0])
def test_simulated_time_follows_wall_time_times_the_factor(wall, factor):
    pacer = Pacer(factor, wall)
    begin, time_ns = wall.now, 0
    for group in range(1, 200):
        assert pacer.find_due_time(time_ns) == time_ns  # not a moment too early
        wall.now += pacer.compute_wait(time_ns) + 1e-6
        time_ns = pacer.find_due_time(time_ns)
        assert time_ns == group * BATCH_NS
        assert (wall.now - begin) * factor * 1e9 == pytest.approx(time_ns, abs=1e4)


def test_groups_may_be_single_steps(wall):
    pacer = Pacer(1.0, wall)
    wall.now += 0.0032
    assert pacer.find_due_time(0, group_ns=1 * MS) == 3 * MS
    assert pacer.compute_wait(3 * MS, group_ns=1 * MS) == pytest.approx(0.0008)
    assert pacer.find_due_time(0, group_ns=2 * MS) == 2 * MS  # steps of 2 ms
    assert pacer.compute_wait(2 * MS, group_ns=2 * MS) == pytest.approx(0.0008)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_lag_is_made_good_up_to_a_limit_and_given_up_beyond(wall, factor):
    pacer = Pacer(factor, wall)
    wall.now += 0.150 / factor
    assert pacer.find_due_time(0) == 148 * MS
    wall.now += 0.300 / factor
    assert pacer.find_due_time(148 * MS) == 152 * MS
    assert pacer.compute_wait(152 * MS) == pytest.approx(0.004 / factor, rel=1e-6)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_a_new_factor_counts_from_now_on(wall, factor):
    pacer = Pacer(1.0, wall)
    wall.now += 1.0
    pacer.set_factor(factor, 40 * MS)
    assert pacer.find_due_time(40 * MS) == 40 * MS
    wall.now += 0.1 / factor
    assert pacer.find_due_time(40 * MS) == 140 * MS


def test_the_factor_that_came_out_is_measured_in_windows(wall):
    pacer = Pacer(0.5, wall)
    wall.now += 2.5
    pacer.find_due_time(1000 * MS)
    assert pacer.real_time_factor == pytest.approx(0.4)


@pytest.mark.parametrize(("factor", "reached_ms", "warned"), [
    (0.5, 990, False), (0.5, 950, False), (0.5, 900, True), (2.0, 3900, False), (2.0, 2000, True),
    (0.0, 1, False),
])  # fmt: skip
def test_who_falls_short_of_the_wanted_factor_is_warned(wall, caplog, factor, reached_ms, warned):
    pacer = Pacer(factor, wall)
    wall.now += 2.0
    pacer.find_due_time(reached_ms * MS)
    assert ("the simulation is too slow" in caplog.text) == warned


def test_who_falls_short_for_long_is_warned_every_ten_seconds(caplog):
    """By a clock that begins at zero."""
    wall = Wall()
    wall.now = 0.0
    pacer = Pacer(1.0, wall)
    assert pacer.real_time_factor == 0.0
    told = []
    for k in range(1, 13):
        wall.now = 2.0 * k
        pacer.find_due_time(1000 * MS * k)
        told.append(len(caplog.records))
    assert told == [1] * 5 + [2] * 5 + [3] * 2
    assert caplog.records[0].getMessage().startswith(
        "the simulation is too slow: its real-time factor is 0.50 instead of 1;")


def test_the_very_instants_of_what_is_due(wall):
    assert Pacer(1.0, wall).find_due_time(0, 1) == 0 and Pacer().factor == 1.0
    pacer = Pacer(1.0, wall)
    wall.now = 100.003
    assert pacer.find_due_time(0, 3 * MS) == 3 * MS
    for lag, due in ((200 * MS, 200 * MS), (200 * MS + 1, 4 * MS)):
        wall.now = 100.0
        pacer = Pacer(1.0, wall)
        wall.now += lag / 1e9
        assert pacer.find_due_time(0) == due
