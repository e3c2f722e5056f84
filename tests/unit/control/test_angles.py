"""Angle distances: hand-made cases of ROS's rules, and comparison with ROS's package."""

import itertools
import os
import random
import subprocess
import sys
from math import pi
from pathlib import Path

import pytest

import aras_visual_servo_base
from aras_sim_bridge import angles


@pytest.mark.parametrize(("proves", "start", "goal", "lower", "upper", "distance"), [
    ("inside, as with large limits", 2, -2, -2.0943, 2.0943, -4),
    ("inside, the short way round", 0, 3.5, -3000, 3000, 3.5 - 2 * pi),
    ("at the limit", 2.0943, -2, -2.0943, 2.0943, -4.0943),
    ("beyond it: back in, however far", 10.5, -2, -2.0943, 2.0943, -12.5),
    ("below it", -4.0, 1.0, -2.0943, 2.0943, 5.0)])
def test_towards(proves, start, goal, lower, upper, distance):
    assert angles.angular_distance_within_limits(start, goal, lower, upper) == pytest.approx(
        distance
    ), proves


def grid_and_noise():
    """(start, goal, lower, upper): a grid of eighths of a turn, then anything."""
    corners = [k * pi / 4 for k in range(-8, 9)]
    limits = corners[4:13]
    yield from itertools.product(corners, corners, limits[::2], limits[1::2])
    yield from itertools.product(corners[::3], corners[::3], limits, limits)
    rng = random.Random(7)
    for _ in range(5000):
        yield rng.uniform(-10, 10), rng.uniform(-10, 10), rng.uniform(-pi, pi), rng.uniform(-pi, pi)


def test_all_agree_with_the_ros_package_everywhere():
    ros = pytest.importorskip("angles")
    for start, goal, lower, upper in grid_and_noise():
        where = (start, goal, lower, upper)
        assert angles.shortest_angular_distance(start, goal) == pytest.approx(
            ros.shortest_angular_distance(start, goal), abs=1e-12), where
        for scale in (1.0, 4.0):
            low, high = scale * lower, scale * upper
            assert angles.shortest_angular_distance_with_large_limits(
                start, goal, low, high
            ) == pytest.approx(
                ros.shortest_angular_distance_with_large_limits(start, goal, low, high)[1],
                abs=1e-12,
            ), where


def test_nothing_of_ros_is_needed():
    code = ("import sys; sys.modules['angles'] = sys.modules['rospy'] = None; "
            "import aras_sim_bridge.simulation, aras_sim_bridge.control.controllers")
    libraries = (Path(module.__file__).parents[1] for module in (angles, aras_visual_servo_base))
    subprocess.run([sys.executable, "-c", code], check=True, env={
        "PYTHONPATH": ":".join(map(str, libraries)), "PATH": os.environ["PATH"]})
