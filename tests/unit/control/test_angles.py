"""Angle distances: the contract's rules on hand-made cases, and against ROS's own package."""

import random
from math import pi

import angles as ros_angles
import pytest

from aras_sim_bridge import angles


@pytest.mark.parametrize(
    ("start", "goal", "distance"),
    [(0, 1, 1), (0, pi, pi), (0, -pi, pi), (3, -3, 2 * pi - 6), (-3, 3, 6 - 2 * pi), (7, 7, 0),
     (0, 10.5 * pi, 0.5 * pi), (1, 1 + 40 * pi, 0)],
)
def test_shortest_is_in_half_open_half_turns(start, goal, distance):
    assert angles.shortest(start, goal) == pytest.approx(distance, abs=1e-12)


@pytest.mark.parametrize(
    ("proves", "start", "goal", "lower", "upper", "distance"),
    [
        ("short way inside", 0, 1, -2, 2, 1),
        ("goal beyond a turn comes back", 0, 10.5 * pi, -2 * pi, 2 * pi, 0.5 * pi),
        ("long way when the short one leaves", 0, 10.5 * pi, -2 * pi, 0.1 * pi, -1.5 * pi),
        ("neither inside: the short one", 10.5 * pi, 0, -2 * pi, 2 * pi, -0.5 * pi),
        ("limits crossed: the short one", 0, 3, 1, -1, 3),
        ("no step over the gap", 2, -2, -2.0943, 2.0943, -4),
        ("several turns allowed", 100, 103, -3000, 3000, 3),
        ("no step over the gap at +-3", 3, -3, -3, 3, -6),
    ],
)
def test_with_large_limits(proves, start, goal, lower, upper, distance):
    assert angles.with_large_limits(start, goal, lower, upper) == pytest.approx(distance), proves


@pytest.mark.parametrize(
    ("proves", "start", "goal", "lower", "upper", "distance"),
    [
        ("short way inside", -0.2, 0.2, -0.25, 0.25, 0.4),
        ("long way round an interval with pi", -0.5, 0.5, 0.25, -0.25, 1 - 2 * pi),
        ("start outside, nearer to the upper end", -0.5, 0.5, -0.25, 0.25, 1.0),
        ("goal outside, on the lower side", 0.0, -1.0, -0.25, 0.5, -1.0),
        ("whole circle", 3.0, -3.0, -pi, pi, -6.0),
    ],
)
def test_with_limits(proves, start, goal, lower, upper, distance):
    assert angles.with_limits(start, goal, lower, upper) == pytest.approx(distance), proves


def test_short_cuts_agree_with_the_ros_package_everywhere():
    rng = random.Random(7)
    for _ in range(3000):
        start, goal = rng.uniform(-10, 10), rng.uniform(-10, 10)
        lower, upper = sorted((rng.uniform(-8, 8), rng.uniform(-8, 8)))
        assert angles.shortest(start, goal) == pytest.approx(
            ros_angles.shortest_angular_distance(start, goal), abs=1e-12
        )
        _, expected = ros_angles.shortest_angular_distance_with_large_limits(
            start, goal, lower, upper
        )
        assert angles.with_large_limits(start, goal, lower, upper) == pytest.approx(
            expected, abs=1e-12
        )
