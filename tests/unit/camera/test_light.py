"""How light becomes grey levels."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import BRIGHT, looking

from aras_sim_bridge.rendering import Sun, View, create_renderer

K = np.array([[300.0, 0, 159.5], [0, 310.0, 119.5], [0, 0, 1.0]])
DOWN = (0.0, 0.0, -1.0)


def level(bench, light, colour="Gazebo/White") -> int:
    """Of a plate that faces up."""
    bench.box([1.0, 1.0, 0.05], [0, 0, -0.05], colour)
    view = View(320, 240, looking([0.1, 0, 1.0], [0, 0, 0], (0, 1, 0)), K)
    picture = create_renderer("exact", bench.world, light).render(view)
    assert np.ptp(picture) == 0
    return int(picture[0, 0, 0])


def test_a_white_plate_square_to_the_sun_is_just_white(bench):
    assert level(bench, Sun(DOWN)) == 255


@pytest.mark.parametrize(("ambient", "diffuse"), [(0.4, 0.8), (0.9, 0.8), (2.0, 0.0)])
def test_light_that_is_too_much_is_scaled_all_over(bench, ambient, diffuse):
    sun = Sun((1.0, 0.0, -1.0), ambient, diffuse)
    lit = (ambient + diffuse * np.sqrt(0.5)) / (ambient + diffuse)
    assert level(bench, sun, "Gazebo/Grey") == pytest.approx(0.7 * 255 * lit, abs=0.51)


def test_dim_light_stays_dim(bench):
    assert level(bench, Sun(DOWN, 0.1, 0.2)) == pytest.approx(255 * 0.3, abs=0.51)


def test_gazebo_cuts_what_is_brighter_than_white(bench):
    assert level(bench, BRIGHT) == 255
    assert level(bench, Sun(DOWN, 0.4, 0.8, exposure="gazebo"), "Gazebo/Grey") == pytest.approx(
        255 * 0.7 * 1.2, abs=0.51)
