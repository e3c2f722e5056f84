"""Moments, compared with exact arithmetic, with each other and with known shapes."""

from fractions import Fraction

import numpy as np
import pytest
from feature_cases import L_SHAPE, SQUARE, coverage_image, exact_moment, random_view

from aras_visual_servo_camera.degeneracy import (
    CHECKS,
    anisotropy,
    asymmetry,
    gyration_radius,
    moment_norm,
)
from aras_visual_servo_camera.errors import DegenerateFeatureError, MomentsError
from aras_visual_servo_camera.kernel import compute_kernel_features, compute_original_moments
from aras_visual_servo_camera.moments import Moments, Pinhole, exponents

CAMERA = Pinhole(205.3, 204.1, 161.2, 118.7)


def scales(moments: Moments) -> tuple[float, float]:
    """Radius of gyration about the centre and about the optical axis."""
    rg2 = (moments.mu(2, 0) + moments.mu(0, 2)) / moments.m00
    return rg2**0.5, (rg2 + moments.xg**2 + moments.yg**2) ** 0.5


def assert_same(a: Moments, b: Moments, tolerance: float) -> None:
    rg, R = scales(b)
    for i, j in exponents(b.order):
        assert abs(a.m(i, j) - b.m(i, j)) <= tolerance * b.m00 * R ** (i + j), (i, j)
        assert abs(a.mu(i, j) - b.mu(i, j)) <= tolerance * b.m00 * rg ** (i + j), (i, j)


@pytest.mark.parametrize("seed", range(4))
def test_polygon_equals_exact_arithmetic(seed: int) -> None:
    """Far off the axis too, and whichever way its corners go round."""
    outline = random_view(seed).image + [30.0 * (seed == 3), -20.0 * (seed == 3)]
    moments = Moments.from_polygon(outline[::-1] if seed == 2 else outline)
    exact = [(Fraction(x), Fraction(y)) for x, y in outline.tolist()]
    m00 = exact_moment(exact, 0, 0)
    xg, yg = exact_moment(exact, 1, 0) / m00, exact_moment(exact, 0, 1) / m00
    centred = [(x - xg, y - yg) for x, y in exact]
    rg, R = scales(moments)
    assert abs(moments.xg - float(xg)) < 1e-15 and abs(moments.yg - float(yg)) < 1e-15
    for i, j in exponents(6):
        size = moments.m00 * R ** (i + j)
        assert abs(moments.m(i, j) - float(exact_moment(exact, i, j))) < 1e-14 * size
        size = moments.m00 * rg ** (i + j)
        assert abs(moments.mu(i, j) - float(exact_moment(centred, i, j))) < 1e-13 * size


def test_hole_is_taken_away() -> None:
    frame = Moments.from_polygon(SQUARE, holes=[SQUARE[::-1] * 0.5])
    outer, inner = Moments.from_polygon(SQUARE), Moments.from_polygon(SQUARE * 0.5)
    assert frame.m00 == pytest.approx(outer.m00 - inner.m00, rel=1e-14)
    assert frame.mu(4, 2) == pytest.approx(outer.mu(4, 2) - inner.mu(4, 2), rel=1e-12)


def test_image_equals_sums_over_its_pixels() -> None:
    random = np.random.default_rng(3)
    weights = random.uniform(0, 1, (24, 31))
    v, u = np.mgrid[:24, :31]
    x, y = (u + 5 - CAMERA.cx) / CAMERA.fx, (v + 7 - CAMERA.cy) / CAMERA.fy
    moments = Moments.from_image(weights, CAMERA, offset=(5, 7))
    for i, j in exponents(6):
        expected = (weights * x**i * y**j).sum() / (CAMERA.fx * CAMERA.fy)
        assert moments.m(i, j) == pytest.approx(expected, rel=1e-12)
    x, y, weights = (a.ravel() for a in (x, y, weights / (CAMERA.fx * CAMERA.fy)))
    assert_same(Moments.from_samples(x, y, weights), moments, 1e-13)
    for i, j in exponents(6):
        expected = (weights * (x - moments.xg)**i * (y - moments.yg)**j).sum()
        assert moments.mu(i, j) == pytest.approx(expected, rel=1e-9, abs=1e-18)
    assert moments.mu(1, 0) == moments.mu(0, 1) == 0.0
    points = Moments.from_points(L_SHAPE)
    assert points.m00 == len(L_SHAPE)
    assert points.area == pytest.approx(points.mu(2, 0) + points.mu(0, 2))


@pytest.mark.parametrize("seed", range(2))
def test_coverage_image_gives_the_polygon(seed: int) -> None:
    """Knowing which side of a pixel is covered leaves an error far below the pixel's variance."""
    outline = random_view(seed).image
    exact = Moments.from_polygon(outline)
    weights = coverage_image(outline, CAMERA, (240, 320))
    moments = Moments.from_image(weights, CAMERA, coverage=True)
    plain = Moments.from_image(weights, CAMERA)
    rg, _ = scales(exact)
    for i, j in exponents(6):
        size = exact.m00 * rg ** (i + j)
        assert abs(moments.mu(i, j) - exact.mu(i, j)) < 2e-3 * size, (i, j)
    pixel = exact.m00 / 12 / CAMERA.fx**2
    assert plain.mu(2, 0) - exact.mu(2, 0) == pytest.approx(pixel, rel=0.2)
    assert abs(moments.mu(2, 0) - exact.mu(2, 0)) < 0.2 * pixel


@pytest.mark.parametrize(("make", "text"), [
    (lambda: Moments.from_polygon([[0, 0], [1, 1]]), "at least three"),
    (lambda: Moments.from_points([[0, 0]]), "at least three"),
    (lambda: Moments.from_polygon([[0, 0], [1, 1], [1, 0], [0, 1]]), "edges 0 and 2.*cross"),
    (lambda: Moments.from_polygon([[0, 0], [1, 1], [2, 2]]), "no area"),
    (lambda: Moments.from_polygon([[0, 0], [1, np.nan], [2, 2]]), "not finite"),
    (lambda: Moments.from_image(np.zeros((4, 4)), CAMERA), "empty"),
    (lambda: Moments.from_image(np.ones((4, 4)), Pinhole(0.0, 1.0, 0.0, 0.0)), "focal"),
    (lambda: Moments.from_samples(np.ones(3), np.ones(3), np.zeros(3)), "weights is 0"),
    (lambda: Moments.from_samples(np.ones(5), np.ones(5), np.ones(3)), "one weight for each"),
    (lambda: Moments.from_samples(*np.ones((3, 2, 2))), "one weight for each"),
    (lambda: Moments.from_samples(*np.ones((3, 5)), order=7), "order is 7, must be 1 to 6"),
    (lambda: Moments.from_image(np.ones((4, 4)), CAMERA, 0), "order is 0, must be 1 to 6"),
    (lambda: Moments.from_arrays([1, 0], [1, 0], 1), "order 1 needs 3"),
    (lambda: Moments.from_arrays([np.nan, 0, 0], [1, 0, 0], 1), "finite"),
    (lambda: Moments.from_arrays([0, 0, 0], [0, 0, 0], 1), "positive"),
    (lambda: Moments.from_polygon(SQUARE, 2).m(2, 1), "i \\+ j must be at most 2")])
def test_bad_shapes_are_refused(make, text: str) -> None:
    with pytest.raises(MomentsError, match=text):
        make()


@pytest.mark.parametrize("phase", [0.0, 0.15, 0.5, 0.8])
def test_edges_along_rows_of_pixels_lie_where_they_are(phase: float) -> None:
    """All pixels of such an edge are covered alike: nothing averages out, to any order."""
    low, high = np.array([20.0 + phase, 30.0 - 0.7 * phase]), np.array([44.6, 61.25 + phase])
    exact = Moments.from_polygon([low, (high[0], low[1]), high, (low[0], high[1])])
    cover = [np.clip(np.minimum(b, n + 0.5) - np.maximum(a, n - 0.5), 0.0, 1.0)
             for a, b, n in zip(low, high, (np.arange(80.0), np.arange(90.0)), strict=True)]
    for full_scale in (1.0, 255.0):
        weights = full_scale * np.outer(cover[1], cover[0])
        pixels = Pinhole(1.0, 1.0, 0.0, 0.0)
        seen = Moments.from_image(weights, pixels, 6, full_scale, coverage=True)
        assert (seen.xg, seen.yg) == pytest.approx((exact.xg, exact.yg), abs=4e-4)
        rg, _ = scales(exact)
        for i, j in exponents(6):
            off = seen.mu(i, j) - exact.mu(i, j)
            assert abs(off) < 5e-4 * exact.m00 * rg ** (i + j), (i, j)


def test_measures_of_degeneracy_of_a_rectangle() -> None:
    """Length a along x, width b: rg^2 = (a^2 + b^2) / 12, anisotropy (a^2 - b^2) / (a^2 + b^2)."""
    a, b = 0.5, 0.2
    corners = 0.5 * np.array([[-a, -b], [a, -b], [a, b], [-a, b]])
    for angle in (0.0, 0.7, -1.2):
        c, s = np.cos(angle), np.sin(angle)
        moments = Moments.from_polygon(corners @ [[c, s], [-s, c]] + [0.3, -0.1])
        assert gyration_radius(moments) == pytest.approx(((a**2 + b**2) / 12) ** 0.5, rel=1e-12)
        expected = (a**2 - b**2) / (a**2 + b**2)
        assert anisotropy(moments) == pytest.approx(expected, rel=1e-12)
        assert asymmetry(moments) < 1e-12
        mu20, mu02, mu22 = a**3 * b / 12, a * b**3 / 12, a**3 * b**3 / 144
        assert moment_norm(moments, 2) == pytest.approx((mu20**2 + mu02**2) ** 0.5, rel=1e-12)
        mu40, mu04 = a**5 * b / 80, a * b**5 / 80
        fourth = (mu40**2 + 6 * mu22**2 + mu04**2) ** 0.5
        assert moment_norm(moments, 4) == pytest.approx(fourth, rel=1e-12)


@pytest.mark.parametrize(("name", "order", "degree"), [
    ("I4", 3, 2), ("I6", 3, 4), ("I10", 4, 2), ("I15", 5, 2)])
def test_a_denominator_vanishes_beside_its_own_moments(name, order, degree) -> None:
    """It is of a degree in moments of one order; those of an odd one vanish by symmetry."""
    check, size = CHECKS[name], moment_norm(Moments.from_polygon(L_SHAPE), order) ** degree
    for share, vanishes in ((0.99e-6, True), (-0.99e-6, True), (1.01e-6, False)):
        reason = check(Moments.from_polygon(L_SHAPE), share * size, 1e-6)
        text = f"the feature's denominator {name} vanishes for this shape; use another target or "
        assert reason == (f"{text}another feature" if vanishes else None)
    rectangle = Moments.from_polygon([[0, 0], [3, 0], [3, 1], [0, 1]])
    reason = check(rectangle, 1.0, 1e-6)
    assert (reason is None) if order % 2 == 0 else f"its moments of order {order} vanish" in reason
    sizes = [asymmetry(Moments.from_polygon(k * L_SHAPE + [k, 0.2])) for k in (0.01, 1.0, 50.0)]
    assert sizes == pytest.approx([sizes[1]] * 3, rel=1e-9) and sizes[1] > 0.01


def mask() -> np.ndarray:
    image = np.zeros((24, 32), np.uint8)
    image[6:14, 9:22] = 255
    image[10:18, 18:26] = 255
    return image


def test_kernel_features_pixel_by_pixel_and_the_original_layout():
    dx, dy, p, q = 0.017, 0.0185, -2, -2
    k, J = np.zeros(4), np.zeros((4, 4))
    for i, j in np.argwhere(mask()) + 1:
        x, y = i * dx, j * dy
        k[:3] += np.array([x**p, y**q, 1.0]) * dx * dy
        J[0, 0] -= p * x ** (p - 1)
        J[0, 3] += p * x ** (p - 1) * y
        J[1, 1] -= q * y ** (q - 1)
        J[1, 3] -= q * y ** (q - 1) * x
        J[2, 2] += 2
    J[3, 3] = -1
    v, u = np.argwhere(mask()).T.astype(float)
    u, v = u - u.mean(), v - v.mean()
    k[3] = 0.5 * np.arctan2(2 * (u * v).sum(), (u * u).sum() - (v * v).sum())
    result = compute_kernel_features(mask())
    np.testing.assert_allclose(result.values, k, rtol=1e-12)
    np.testing.assert_allclose(result.inverse, np.linalg.inv(J), rtol=1e-9, atol=1e-12)
    layout = result.to_message_data()
    assert len(layout) == 20
    np.testing.assert_array_equal(layout[:16], result.inverse.ravel())
    np.testing.assert_array_equal(layout[16:], result.values)
    camera = Pinhole(200.0, 210.0, 15.0, 11.0)
    rows, columns = np.argwhere(mask()).T.astype(float)
    row, column, m00, alpha = compute_original_moments(mask(), camera)
    assert row == pytest.approx((rows.mean() - 11.0) / 210.0)
    assert column == pytest.approx((columns.mean() - 15.0) / 200.0)
    assert m00 == len(rows)
    assert alpha == pytest.approx(0.1 * compute_kernel_features(mask()).values[3])
    empty = np.zeros((24, 32), np.uint8)
    with pytest.raises(DegenerateFeatureError, match="no target"):
        compute_kernel_features(empty)
    with pytest.raises(DegenerateFeatureError, match="no target"):
        compute_original_moments(empty, Pinhole(1.0, 1.0, 0.0, 0.0))
