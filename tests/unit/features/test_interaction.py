"""Rows of L, compared with a camera that moves in exact rational arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from feature_cases import exact_moment, random_view

from aras_visual_servo_camera.errors import FeatureError
from aras_visual_servo_camera.interaction import (
    Plane,
    compute_centred_interaction,
    compute_raw_interaction,
    point_interaction,
)
from aras_visual_servo_camera.moments import Moments, exponents

STEP = Fraction(1, 10**9)


def moved_exactly(points: np.ndarray, axis: int, step: Fraction) -> list[tuple[Fraction, Fraction]]:
    """Image of points (n, 3) after one component of the twist, no rounding anywhere.

    The rotation is Cayley's, (I - S/2)(I + S/2)^-1: rational, and equal to the true one up to
    the third power of the step.
    """
    result = []
    for X, Y, Z in points.tolist():
        p = [Fraction(X), Fraction(Y), Fraction(Z)]
        if axis < 3:
            p[axis] -= step
        else:
            a, b = (axis - 2) % 3, (axis - 1) % 3
            half = step / 2
            c, s = (1 - half**2) / (1 + half**2), 2 * half / (1 + half**2)
            p[a], p[b] = c * p[a] + s * p[b], c * p[b] - s * p[a]
        result.append((p[0] / p[2], p[1] / p[2]))
    return result


def exact_rows(points: np.ndarray, dense: bool, order: int) -> tuple[np.ndarray, np.ndarray]:
    """(moments, 6) derivatives of m and mu by central differences of exact moments."""

    def both(image: list) -> list[Fraction]:
        def moment(shape, i, j):
            return exact_moment(shape, i, j) if dense else sum(x**i * y**j for x, y in shape)

        m00 = moment(image, 0, 0)
        xg, yg = moment(image, 1, 0) / m00, moment(image, 0, 1) / m00
        centred = [(x - xg, y - yg) for x, y in image]
        pairs = exponents(order)
        return [moment(image, i, j) for i, j in pairs] + [moment(centred, i, j) for i, j in pairs]

    columns = []
    for axis in range(6):
        ahead = both(moved_exactly(points, axis, STEP))
        behind = both(moved_exactly(points, axis, -STEP))
        columns.append([float((p - q) / (2 * STEP)) for p, q in zip(ahead, behind, strict=True)])
    rows = np.array(columns).T
    return rows[: len(rows) // 2], rows[len(rows) // 2 :]


@pytest.mark.parametrize("dense", [True, False], ids=["region", "points"])
def test_rows_equal_a_camera_moved_exactly(dense: bool) -> None:
    view = random_view(2)
    # one set of numbers for both: the points' doubles; their plane is the view's to 1e-16
    points = view.points
    make = Moments.from_polygon if dense else Moments.from_points
    moments = make(points[:, :2] / points[:, 2:])
    raw, centred = exact_rows(points, dense, 4)
    ours_raw = compute_raw_interaction(moments, view.plane, 4)
    ours_centred = compute_centred_interaction(moments, view.plane, 4)[2:]
    sign = 1.0 if raw[0, 2] > 0 or not dense else -1.0  # exact_moment keeps the outline's turn
    for ours, exact in ((ours_raw, raw), (ours_centred, centred)):
        for row, expected in zip(ours, sign * exact, strict=True):
            scale = max(np.abs(expected).max(), 1e-6)
            np.testing.assert_allclose(row, expected, rtol=0, atol=2e-10 * scale)


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
