"""Splines: linear, cubic, quintic; end conditions, degenerate durations, holding outside."""

from itertools import product

import pytest

from aras_sim_bridge.control.controllers import splines

S = 1_000_000_000


@pytest.mark.parametrize(("proves", "start", "end", "duration", "coefficients"), [
    ("positions only: a line", (1,), (5,), 2.0, (1, 2, 0, 0, 0, 0)),
    ("rest to rest cubic: 3t²-2t³", (0, 0), (1, 0), 1.0, (0, 0, 3, -2, 0, 0)),
    ("rest to rest quintic: 10t³-15t⁴+6t⁵", (0, 0, 0), (1, 0, 0), 1.0, (0, 0, 0, 10, -15, 6)),
    ("a quintic that is t⁵", (0, 0, 0), (32, 80, 160), 2.0, (0, 0, 0, 0, 0, 1)),
    ("the lower specification counts: line", (0, 7, 7), (1,), 1.0, (0, 1, 0, 0, 0, 0)),
    ("the lower specification counts: cubic", (0, 0, 9), (1, 0), 1.0, (0, 0, 3, -2, 0, 0)),
    ("one end's velocity does not count: line", (0,), (1, 7), 1.0, (0, 1, 0, 0, 0, 0)),
    ("accelerations without velocities: line", (0, None, 3), (1, None, 3), 1.0, (0, 1, 0, 0, 0, 0)),
    ("no time: the end state", (0, 1, 2), (3, 4, 6), 0.0, (3, 4, 3, 0, 0, 0)),
    ("no time, positions only: at rest there", (0,), (3,), 0.0, (3, 0, 0, 0, 0, 0))])
def test_coefficients(proves, start, end, duration, coefficients):
    found = splines.fit_spline(splines.Waypoint(*start), splines.Waypoint(*end), duration)
    assert found == pytest.approx(coefficients, abs=1e-12), proves


@pytest.mark.parametrize("values", list(product([-1.0, 2.0], repeat=4)))
def test_splines_take_all_their_end_values(values):
    v0, v1, a0, a1 = values
    for count in (2, 3):  # a cubic, and a quintic
        first, last = (0.5, v0, a0)[:count], (-1.5, v1, a1)[:count]
        start, end = splines.Waypoint(*first), splines.Waypoint(*last)
        segment = splines.SplineSegment(3 * S, start, 3 * S + S // 4, end)
        assert segment.sample(3 * S)[:count] == pytest.approx(first)
        assert segment.sample(3 * S + S // 4)[:count] == pytest.approx(last)


def test_outside_its_time_it_rests_at_the_ends():
    segment = splines.SplineSegment(S, splines.Waypoint(1.0), 2 * S, splines.Waypoint(3.0))
    assert segment.sample(0) == (1.0, 0.0, 0.0)
    assert segment.sample(2 * S) == (3.0, 2.0, 0.0)
    assert segment.sample(2 * S + 1) == (3.0, 0.0, 0.0)


@pytest.mark.parametrize(("tolerance", "position", "velocity", "holds"), [
    ((0, 0, 0), 9, 9, True), ((1, 0, 0), 1, 9, True), ((1, 0, 0), -1.1, 0, False),
    ((0, 1, 0), 9, -1.1, False), ((0, 1, 0), 9, -1, True), ((0, 0, 0.001), 9, 9, True)])
def test_tolerances_of_zero_are_not_checked(tolerance, position, velocity, holds):
    assert splines.StateTolerances() == (0.0, 0.0, 0.0)
    assert splines.StateTolerances(*tolerance).is_met(position, velocity) is holds
