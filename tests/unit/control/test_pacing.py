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


@pytest.mark.parametrize(("now", "group", "due_ms", "wait"), [
    (0.0099, {}, 8, 0.0021), (0.0032, {"group_ns": 1 * MS}, 3, 0.0008),
    (0.0032, {"group_ns": 2 * MS}, 2, 0.0008)])
def test_steps_come_in_groups(wall, now, group, due_ms, wait):
    assert BATCH_NS == 4 * MS
    pacer = Pacer(1.0, wall)
    wall.now += now
    assert pacer.find_due_time(0, **group) == due_ms * MS
    assert pacer.compute_wait(due_ms * MS, **group) == pytest.approx(wait)


def test_an_event_does_not_wait_for_its_group(wall):
    pacer = Pacer(1.0, wall)
    assert pacer.find_due_time(0, 1) == 0 and Pacer().factor == 1.0
    assert pacer.compute_wait(0, 3 * MS) == pytest.approx(0.003)
    wall.now = 100.003
    assert pacer.find_due_time(0) == 0
    assert pacer.find_due_time(0, 3 * MS) == 3 * MS
    # Done with: the next to wait for is the group's end.
    assert pacer.compute_wait(3 * MS, 3 * MS) == pytest.approx(0.001)
    assert pacer.find_due_time(3 * MS, 3 * MS) <= 3 * MS
    pacer = Pacer(0.0, wall)  # at full speed
    assert pacer.find_due_time(0, 3 * MS) == BATCH_NS and pacer.compute_wait(0, 3 * MS) == 0.0


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 3.0])
def test_simulated_time_follows_wall_time_times_the_factor(wall, factor):
    pacer, start = Pacer(1.0, wall), 40 * MS
    wall.now += 1.0
    pacer.set_factor(factor, start)
    begin, time_ns = wall.now, start
    for group in range(1, 200):
        assert pacer.find_due_time(time_ns) == time_ns  # not a moment too early
        wall.now += pacer.compute_wait(time_ns) + 1e-6
        time_ns = pacer.find_due_time(time_ns)
        assert time_ns == start + group * BATCH_NS
        assert (wall.now - begin) * factor * 1e9 == pytest.approx(time_ns - start, abs=1e4)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_lag_is_made_good_up_to_a_limit_and_given_up_beyond(wall, factor):
    pacer = Pacer(factor, wall)
    wall.now += 0.150 / factor
    assert pacer.find_due_time(0) == 148 * MS
    wall.now += 0.300 / factor
    assert pacer.find_due_time(148 * MS) == 152 * MS
    assert pacer.compute_wait(152 * MS) == pytest.approx(0.004 / factor, rel=1e-6)
    for lag, due in ((200 * MS, 200 * MS), (200 * MS + 1, 4 * MS)):
        wall.now = 100.0
        pacer = Pacer(1.0, wall)
        wall.now += lag / 1e9
        assert pacer.find_due_time(0) == due


@pytest.mark.parametrize(("factor", "reached_ms", "warned"), [
    (0.5, 950, False), (0.5, 900, True), (2.0, 3900, False), (2.0, 2000, True), (0.0, 1, False)])
def test_who_falls_short_of_the_wanted_factor_is_warned(wall, caplog, factor, reached_ms, warned):
    pacer = Pacer(factor, wall)
    wall.now += 2.0
    pacer.find_due_time(reached_ms * MS)
    assert pacer.real_time_factor == pytest.approx(reached_ms / 2000.0)
    assert ("the simulation is too slow" in caplog.text) == warned


def test_who_falls_short_for_long_is_warned_every_ten_seconds(caplog):
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
