"""Features, compared with a moved camera: invariances, degenerate shapes, and invalid calls."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from feature_cases import (
    L_SHAPE,
    RECTANGLE,
    SQUARE,
    TARGET,
    View,
    finite_differences,
    point_moments,
    polygon_moments,
    random_view,
    rotation,
)

from aras_visual_servo_camera import features
from aras_visual_servo_camera.errors import DegenerateFeatureError, FeatureError
from aras_visual_servo_camera.features import PAPER_FEATURES, Reference, compute_required_order
from aras_visual_servo_camera.features import compute_moment_features as compute
from aras_visual_servo_camera.formula import Formula
from aras_visual_servo_camera.interaction import Plane, compute_raw_interaction, point_interaction
from aras_visual_servo_camera.moments import Moments, exponents

MOMENTS = tuple(f"m{i}{j}" for i, j in exponents(5)) + tuple(f"mu{i}{j}" for i, j in exponents(5))
COMBINATIONS = ("Sxn", "Syn", "Pyn", "r1", "r2", "c3", "C3 - 0.5 * C4", "sqrt(Px) / an")
INVARIANTS = tuple(f"C{k}" for k in range(1, 11)) + ("Sx", "Sy", "Px", "Py")
ALL = ("xg", "yg", "area", *PAPER_FEATURES, *INVARIANTS, *MOMENTS, *COMBINATIONS)
REFERENCE = Reference.from_moments(Moments.from_polygon(L_SHAPE / 0.5), 0.5)
FRONT = Plane.fronto_parallel(0.5)


def gap(L: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Worst difference of each row, relative to the row's largest entry."""
    size = np.abs(expected).max(axis=1)
    return np.abs(L - expected).max(axis=1) / np.maximum(size, 1e-9)


@pytest.mark.parametrize("make", [polygon_moments, point_moments], ids=["region", "points"])
def test_every_row_equals_a_really_moved_camera(make) -> None:
    """Random shapes, poses and tilts; every feature there is."""
    worst = dict.fromkeys(ALL, 0.0)
    for seed in range(20 if make is polygon_moments else 8):
        view = random_view(seed)
        result = compute(make(view), ALL, view.plane, REFERENCE)
        assert result.is_defined, (seed, result.degenerate)

        def values(moved: View, at=result) -> np.ndarray:
            s = compute(make(moved), ALL, at.plane, REFERENCE).values
            k = ALL.index("alpha")
            s = s.copy()
            s[k] = at["alpha"] + (s[k] - at["alpha"] + pi / 2) % pi - pi / 2
            return s

        numeric = finite_differences(values, view)
        for name, error in zip(ALL, gap(result.L, numeric), strict=True):
            worst[name] = max(worst[name], error)
    assert max(worst.values()) <= 1e-5, sorted(worst.items(), key=lambda item: -item[1])[:5]


@pytest.mark.parametrize("make", [Moments.from_polygon, Moments.from_points])
def test_invariants_do_not_feel_translation_rotation_and_scale(make) -> None:
    """Of points m00 is in the place of a; Sxn, Syn turn as a vector."""
    outline, turn = random_view(3).image, rotation([0, 0, -2.1])[:2, :2]
    moved = 2.5 * outline @ turn.T + [0.7, -0.4]
    names = tuple(n for n in INVARIANTS if n not in ("Sx", "Sy", "Py")) + ("r1", "r2", "Pyn")
    before, after = (compute(make(shape), names, FRONT).values for shape in (outline, moved))
    scale = np.maximum(np.abs(before), 1.0)
    np.testing.assert_array_less(np.abs(after - before), 1e-10 * scale)
    before, after = (
        compute(make(shape), ("Sxn", "Syn"), FRONT).values for shape in (outline, moved)
    )
    np.testing.assert_allclose(after, turn.T @ before, atol=1e-10)


def test_other_names_are_the_same_features() -> None:
    moments = Moments.from_polygon(L_SHAPE)
    pairs = [("r1", "C9"), ("r2", "C10"), *((f"c{k}", f"C{k}") for k in range(1, 11))]
    found = compute(moments, tuple(name for pair in pairs for name in pair), FRONT)
    for one, other in pairs:
        assert found[one] == pytest.approx(found[other], rel=1e-12), one
        np.testing.assert_allclose(
            found.get_interaction_row(one), found.get_interaction_row(other), rtol=1e-12
        )


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("make", [polygon_moments, point_moments], ids=["region", "points"])
def test_full_turn_orientation_under_tilt(seed: int, make) -> None:
    """The branch is the one nearest to the true turn, whatever the tilt (ViSP: 20 of 96 wrong)."""
    random = np.random.default_rng(1000 + seed)
    shape = (L_SHAPE, TARGET * 4)[seed % 2]
    desired = View(shape - shape.mean(axis=0), np.eye(3), np.array([0, 0, 0.5]))
    tilt = random.uniform(-1, 1, 2) * np.deg2rad(30)
    turn = random.uniform(-pi, pi)
    R = rotation([tilt[0], 0, 0]) @ rotation([0, tilt[1], 0]) @ rotation([0, 0, turn])
    t = np.array([*random.uniform(-0.1, 0.1, 2), random.uniform(0.4, 0.8)])
    view = View(desired.shape, R, t)
    reference = Reference.from_moments(make(desired), 0.5)
    result = compute(make(view), ("alpha", "alpha_full"), view.plane, reference)
    truth = reference.orientation.alpha + turn
    assert abs((result["alpha_full"] - truth + pi) % (2 * pi) - pi) < 1.2
    assert -pi < result["alpha_full"] <= pi
    assert abs(np.sin(result["alpha_full"] - result["alpha"])) < 1e-12
    np.testing.assert_array_equal(result.L[0], result.L[1])


def test_symmetry_is_judged_free_of_scale() -> None:
    """Small or far makes no shape symmetric, large makes no rectangle asymmetric."""
    for scale in (1e-4, 1.0, 1e3):
        for shape, is_symmetric in ((TARGET, False), (RECTANGLE, True)):
            moments = Moments.from_polygon(shape * scale)
            found = features.Orientation.from_moments(moments, FRONT)
            assert found.is_symmetric is is_symmetric
    half_turned = Moments.from_polygon(-RECTANGLE)
    reference = Reference.from_moments(Moments.from_polygon(RECTANGLE), 1.0)
    assert compute(half_turned, ("alpha_full",), FRONT, reference)["alpha_full"] == pytest.approx(0)


@pytest.mark.parametrize(
    ("shape", "names"),
    [
        (SQUARE, ("alpha", "C1", "C2", "C3", "C6", "C9", "C10", "Sx", "Sy", "r1", "C2 + C7")),
        (RECTANGLE, ("C2", "C3", "C4", "C5", "C6", "C9", "C10", "c4")),
    ],
    ids=["square", "rectangle"],
)
def test_undefined_features_say_so_and_are_never_nan(shape, names) -> None:
    result = compute(Moments.from_polygon(shape + 0.2), (*names, "xn"), FRONT, REFERENCE)
    assert set(result.degenerate) == set(names)
    assert np.isfinite(result.values).all() and np.isfinite(result.L).all()
    assert not result.values[:-1].any() and not result.L[:-1].any()
    assert result.values[-1] != 0.0
    with pytest.raises(DegenerateFeatureError, match="is undefined for this image") as caught:
        result[names[0]]
    assert caught.value.name == names[0]


def test_values_alone_are_those_beside_their_interaction_matrix() -> None:
    moments, plane = Moments.from_polygon(TARGET), Plane(0.2, -0.1, 2.0)
    names = ("xn", "alpha_full", "1 / (m00 - a)", "an", "Sx")
    found = compute(moments, names, plane, REFERENCE)
    assert found.degenerate.keys() == {"1 / (m00 - a)"} and found.values.all() == 0.0
    assert (features.compute_feature_values(moments, names, plane, REFERENCE) == found.values).all()
    with pytest.raises(FeatureError, match="up to order 4"):
        features.compute_feature_values(Moments.from_polygon(TARGET, 3), names, plane, REFERENCE)


def test_tolerance_decides_for_a_nearly_square_target() -> None:
    nearly = Moments.from_polygon(SQUARE * [1.001, 1.0])
    assert compute(nearly, ("alpha",), FRONT).is_defined
    assert not compute(nearly, ("alpha",), FRONT, tolerance=0.01).is_defined


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (("area",), 2),
        (PAPER_FEATURES, 3),
        (("alpha_full",), 4),
        (("C7",), 5),
        (("C9",), 6),
        (("m31",), 5),
    ],
)
def test_only_the_needed_order_is_asked_for(names, order: int) -> None:
    assert compute_required_order(names) == order
    assert compute_required_order(("area",), "points") == 3
    view = random_view(1)
    low = compute(polygon_moments(view, order), names, view.plane, REFERENCE)
    full = compute(polygon_moments(view, 6), names, view.plane, REFERENCE)
    np.testing.assert_allclose(low.values, full.values, rtol=1e-12)
    np.testing.assert_allclose(low.L, full.L, rtol=1e-9, atol=1e-12)
    if order > 2:
        with pytest.raises(FeatureError, match=f"up to order {order}"):
            compute(polygon_moments(view, order - 1), names, view.plane, REFERENCE)


def test_points_that_coincide_or_stand_in_line() -> None:
    names = (*PAPER_FEATURES, *INVARIANTS)
    point = Moments.from_points([[0.1, 0.2]] * 4)
    result = compute(point, names, FRONT, REFERENCE)
    assert np.isfinite(result.values).all() and np.isfinite(result.L).all()
    assert {"an", "alpha", "Px", "Py", "C1"} <= set(result.degenerate)
    with pytest.raises(FeatureError, match="coincide"):
        compute(point, names, reference=REFERENCE)
    line = compute(Moments.from_points([[0, 0], [1, 1], [3, 3]]), names, FRONT, REFERENCE)
    assert np.isfinite(line.values).all() and np.isfinite(line.L).all()
    assert line["alpha"] == pytest.approx(pi / 4)


def test_without_a_plane_the_depth_comes_from_the_area() -> None:
    moments = Moments.from_polygon(L_SHAPE / 0.8)
    result = compute(moments, PAPER_FEATURES, reference=REFERENCE)
    assert result.plane == pytest.approx((0.0, 0.0, 1 / 0.8))
    assert result["an"] == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("names", "arguments", "text"),
    [
        (("xq",), {"plane": FRONT}, "no feature 'xq'"),
        (("C1 +",), {"plane": FRONT}, "neither a feature nor a formula"),
        (("exp(C1)",), {"plane": FRONT}, "no rule to differentiate"),
        (("xn",), {"plane": FRONT}, "needs a reference"),
        (("alpha",), {}, "give a plane, or a reference"),
    ],
)
def test_wrong_requests_are_refused(names, arguments, text: str) -> None:
    with pytest.raises(FeatureError, match=text):
        compute(Moments.from_polygon(L_SHAPE), names, **arguments)
    with pytest.raises(FeatureError, match="positive area and depth"):
        Reference(0.0, 1.0)


def test_result_is_immutable_and_in_the_asked_order() -> None:
    result = compute(Moments.from_polygon(L_SHAPE), ("yg", "xg"), FRONT)
    assert result.names == ("yg", "xg")
    with pytest.raises(ValueError, match="read-only"):
        result.L[0, 0] = 1.0
    with pytest.raises(TypeError):
        result.degenerate["xg"] = "no"
    with pytest.raises(FeatureError, match="was not computed"):
        result["an"]


def test_formula_refuses_what_it_cannot_differentiate() -> None:
    with pytest.raises(ValueError, match="no rule"):
        Formula("a ** b")
    assert repr(Formula("a + b")) == "Formula('a + b')"


def test_a_program_is_its_formulas_one_by_one() -> None:
    """Values and derivatives by the leaves, of names that rest on each other, and of a leaf."""
    names = ("an", "xn", "C3 - 0.5 * C4", "xg", "Sx")
    moments = Moments.from_polygon(L_SHAPE)
    together = compute(moments, names, FRONT, REFERENCE)
    for name in names:
        alone = compute(moments, (name,), FRONT, REFERENCE)
        assert together[name] == alone[name]
        off = together.get_interaction_row(name) - alone.get_interaction_row(name)
        assert np.abs(off).max() <= 1e-12 * np.abs(alone.L).max()


def test_one_feature_that_divides_by_zero_leaves_the_others() -> None:
    moments = Moments.from_polygon(L_SHAPE)
    names = ("xg", "1 / (xg - xg)", "an")
    result = compute(moments, names, FRONT, REFERENCE)
    assert set(result.degenerate) == {"1 / (xg - xg)"}
    assert "divides by zero" in result.degenerate["1 / (xg - xg)"]
    assert result["xg"] == moments.xg and result["an"] > 0.0
    assert result.values[1] == 0.0 and not result.L[1].any()


# -- planes and the orders of moments -----------------------------------------------------------


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
