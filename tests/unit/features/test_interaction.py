"""Planes and the orders of moments; test_features.py compares the rows of L."""

from __future__ import annotations

import numpy as np
import pytest
from feature_cases import random_view

from aras_visual_servo_camera.errors import FeatureError
from aras_visual_servo_camera.interaction import Plane, compute_raw_interaction, point_interaction
from aras_visual_servo_camera.moments import Moments


def test_plane_from_pose_holds_its_points() -> None:
    view = random_view(5)
    for X, Y, Z in view.points:
        assert view.plane.inverse_depth(X / Z, Y / Z) == pytest.approx(1 / Z, rel=1e-12)
    assert Plane.fronto_parallel(0.5) == (0.0, 0.0, 2.0)


def test_order_beyond_the_moments_is_refused() -> None:
    moments = Moments.from_polygon(random_view(0).image, order=3)
    assert len(compute_raw_interaction(moments, Plane(0, 0, 1))) == 6  # up to the second order
    with pytest.raises(FeatureError, match="need moments up to order 4"):
        compute_raw_interaction(moments, Plane(0, 0, 1), 3)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Plane.fronto_parallel(0.0),
        lambda: Plane.fronto_parallel(float("nan")),
        lambda: Plane.from_pose(np.eye(3), [1.0, 0.0, 0.0]),
    ],
)
def test_impossible_planes_are_refused(make) -> None:
    with pytest.raises(FeatureError):
        make()


@pytest.mark.parametrize("points", [np.ones((4, 3)), np.ones((4, 1)), np.ones(2), []])
def test_points_have_two_coordinates(points) -> None:
    with pytest.raises(FeatureError, match="shape .*, must have the shape \\(n, 2\\)"):
        point_interaction(points, 1.0)
