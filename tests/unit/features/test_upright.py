"""Rectified view of a tilted target, compared with a camera that faces it."""

from __future__ import annotations

from math import atan2, pi, remainder

import numpy as np
import pytest
from feature_cases import L_SHAPE, TARGET, View, rotation

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import DENSE, Moments
from aras_visual_servo_camera.orientation import (
    Orientation,
    compute_third_product,
    compute_upright_moments,
    rotate_third,
)

# What the expansion in powers of size over distance leaves, of third moments that reach 0.05.
TOLERANCE = 1e-4


def square_on(view: View) -> np.ndarray:
    """(n, 2) image of the camera turned the shortest way until it looks along the normal."""
    normal = view.R[:, 2] * np.sign(view.R[2, 2])
    axis = np.cross(normal, [0.0, 0.0, 1.0])
    size = np.linalg.norm(axis)
    turn = rotation(axis / size * np.arcsin(size))
    points = view.points @ turn.T
    return points[:, :2] / points[:, 2:]


def tilted(seed: int, shape: np.ndarray) -> View:
    """Return a small view away from the image centre, inclined by up to 40 degrees."""
    random = np.random.default_rng(seed)
    angle, about = np.deg2rad(random.uniform(15, 40)), random.uniform(-pi, pi)
    askew = rotation(angle * np.array([np.cos(about), np.sin(about), 0.0]))
    R = askew @ rotation([0, 0, random.uniform(-pi, pi)])
    return View(shape, R, np.array([*random.uniform(-0.3, 0.3, 2), 0.6]))


def flipped(view: View) -> View:
    """Return the same plane with reversed normal, as an object frame may have it."""
    return View(view.shape, view.R @ np.diag([1.0, -1.0, -1.0]), view.t)


def third(mu: np.ndarray) -> np.ndarray:
    """mu30, mu21, mu12, mu03 over m00 rg^3."""
    rg = ((mu[2, 0] + mu[0, 2]) / mu[0, 0]) ** 0.5
    return np.array([mu[3, 0], mu[2, 1], mu[1, 2], mu[0, 3]]) / (mu[0, 0] * rg**3)


def axis(mu: np.ndarray) -> float:
    return 0.5 * atan2(2 * mu[1, 1], mu[2, 0] - mu[0, 2])


@pytest.mark.parametrize("shape", [TARGET, L_SHAPE / 5], ids=["target", "L"])
@pytest.mark.parametrize("make", [Moments.from_polygon, Moments.from_points])
@pytest.mark.parametrize("turned", [False, True], ids=["away", "towards"])
def test_a_tilted_view_is_turned_square_on(shape, make, turned: bool) -> None:
    for seed in range(12):
        view = tilted(seed, shape)
        seen = flipped(view) if turned else view
        exact, moments = make(square_on(seen)), make(seen.image)
        shrinking = 3.0 if moments.kind == DENSE else 0.0
        mu = compute_upright_moments(
            moments.centred, *seen.plane, moments.xg, moments.yg, shrinking
        )
        np.testing.assert_allclose(third(mu), third(exact.centred), atol=TOLERANCE)
        assert abs(remainder(axis(mu) - axis(exact.centred), pi)) < TOLERANCE
        found = Orientation.from_moments(moments, seen.plane)
        assert found.alpha == pytest.approx(axis(moments.centred), abs=1e-12)
        assert abs(remainder(found.upright_alpha - axis(exact.centred), pi)) < TOLERANCE
        np.testing.assert_allclose(found.third, third(exact.centred), atol=TOLERANCE)


def test_third_order_moments_turn_with_the_shape() -> None:
    for angle in (-2.0, 0.3, 1.1):
        turn = rotation([0, 0, angle])[:2, :2]
        before = third(Moments.from_polygon(L_SHAPE).centred)
        after = third(Moments.from_polygon(L_SHAPE @ turn.T).centred)
        np.testing.assert_allclose(rotate_third(tuple(before), angle), after, atol=1e-12)
        size = compute_third_product(tuple(before), tuple(before))
        assert compute_third_product(tuple(after), tuple(after)) == pytest.approx(size, rel=1e-12)


def test_no_orientation_without_third_order_or_main_axis() -> None:
    view = tilted(0, TARGET)
    assert Orientation.from_moments(Moments.from_polygon(view.image, 2), view.plane) is None
    square = Moments.from_points([[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]])
    assert Orientation.from_moments(square, Plane.fronto_parallel(0.5)) is None
