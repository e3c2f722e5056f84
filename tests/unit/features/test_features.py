"""Features, compared with a moved camera: invariances, degenerate shapes, and invalid calls."""

from __future__ import annotations

import hashlib
import json
import re
from math import atan2, pi, remainder
from pathlib import Path

import numpy as np
import pytest
from feature_cases import (
    L_SHAPE,
    RECTANGLE,
    SQUARE,
    TARGET,
    View,
    finite_differences,
    pixels_inside,
    point_moments,
    polygon_moments,
    random_view,
    rotation,
)

from aras_visual_servo_camera import moment_feature_values as features
from aras_visual_servo_camera.errors import DegenerateFeatureError, UnavailableFeatureError
from aras_visual_servo_camera.feature_plan import compute_required_order
from aras_visual_servo_camera.interaction import Plane, compute_raw_interaction, point_interaction
from aras_visual_servo_camera.moment_feature_values import PAPER_FEATURES, Reference
from aras_visual_servo_camera.moment_feature_values import compute_moment_features as compute
from aras_visual_servo_camera.moments import DENSE, Moments, Pinhole, exponents
from aras_visual_servo_camera.target_orientation import TargetOrientation, compute_upright_moments

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
        assert not result.degenerate, (seed, result.degenerate)

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
    names = (*(f"C{k}" for k in range(1, 11)), "C9", "C10", *(f"c{k}" for k in range(1, 11)), "r1",
             "r2", "Px", "Pyn")
    before, after = (compute(make(shape), names, FRONT).values for shape in (outline, moved))
    scale = np.maximum(np.abs(before), 1.0)
    np.testing.assert_array_less(np.abs(after - before), 1e-10 * scale)
    np.testing.assert_allclose(before[:12], before[12:24])  # other names of the same features
    before, after = (compute(make(one), ("Sxn", "Syn"), FRONT).values for one in (outline, moved))
    np.testing.assert_allclose(after, turn.T @ before, atol=1e-10)


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


def test_symmetry_and_orientation_of_a_target():
    """Small or far makes no shape symmetric, large makes no rectangle asymmetric."""
    for scale in (1e-4, 1.0, 1e3):
        for shape, is_symmetric in ((TARGET, False), (RECTANGLE, True)):
            moments = Moments.from_polygon(shape * scale)
            found = features.TargetOrientation.from_moments(moments, FRONT)
            assert found.is_symmetric is is_symmetric
    half_turned = Moments.from_polygon(-RECTANGLE)
    reference = Reference.from_moments(Moments.from_polygon(RECTANGLE), 1.0)
    assert compute(half_turned, ("alpha_full",), FRONT, reference)["alpha_full"] == pytest.approx(0)
    view = tilted(0, TARGET)
    assert TargetOrientation.from_moments(Moments.from_polygon(view.image, 2), view.plane) is None
    square = Moments.from_points([[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]])
    assert TargetOrientation.from_moments(square, Plane.fronto_parallel(0.5)) is None


@pytest.mark.parametrize(("shape", "names"), [
    (SQUARE, ("alpha", "C1", "C2", "C3", "C6", "C9", "C10", "Sx", "Sy", "r1", "C2 + C7")),
    (RECTANGLE, ("C2", "C3", "C4", "C5", "C6", "C9", "C10", "c4")),
])
def test_undefined_features_say_so_and_are_never_nan(shape, names) -> None:
    result = compute(Moments.from_polygon(shape + 0.2), (*names, "xn"), FRONT, REFERENCE)
    assert set(result.degenerate) == set(names)
    assert np.isfinite(result.values).all() and np.isfinite(result.L).all()
    assert not result.values[:-1].any() and not result.L[:-1].any()
    assert result.values[-1] != 0.0
    with pytest.raises(DegenerateFeatureError, match="is undefined for this image") as caught:
        result[names[0]]
    assert caught.value.name == names[0]
    nearly = Moments.from_polygon(SQUARE * [1.001, 1.0])
    for tolerance, is_square in (({}, False), ({"tolerance": 0.01}, True)):
        assert bool(compute(nearly, ("alpha",), FRONT, **tolerance).degenerate) is is_square


def test_values_alone_are_those_beside_their_interaction_matrix() -> None:
    moments, plane = Moments.from_polygon(TARGET), Plane(0.2, -0.1, 2.0)
    names = ("xn", "alpha_full", "1 / (m00 - a)", "an", "Sx")
    found, again = (compute(moments, names, plane, REFERENCE) for _ in range(2))
    assert found != again and len({found, again}) == 2, "arrays cannot be compared"
    assert found.degenerate.keys() == {"1 / (m00 - a)"} and found.values.all() == 0.0
    assert "divides by zero" in found.degenerate["1 / (m00 - a)"] and found["an"] > 0.0
    assert (features.compute_feature_values(moments, names, plane, REFERENCE) == found.values).all()
    with pytest.raises(UnavailableFeatureError, match="up to order 4"):
        features.compute_feature_values(Moments.from_polygon(TARGET, 3), names, plane, REFERENCE)


@pytest.mark.parametrize(("names", "order"), [
    (("area",), 2), (PAPER_FEATURES, 3), (("alpha_full",), 4), (("C7",), 5), (("C9",), 6),
    (("m31",), 5)])
def test_only_the_needed_order_is_asked_for(names, order: int) -> None:
    assert compute_required_order(names) == order
    assert compute_required_order(("area",), "points") == 3
    view = random_view(1)
    low = compute(polygon_moments(view, order), names, view.plane, REFERENCE)
    full = compute(polygon_moments(view, 6), names, view.plane, REFERENCE)
    np.testing.assert_allclose(low.values, full.values, rtol=1e-12)
    np.testing.assert_allclose(low.L, full.L, rtol=1e-9, atol=1e-12)
    if order > 2:
        with pytest.raises(UnavailableFeatureError, match=f"up to order {order}"):
            compute(polygon_moments(view, order - 1), names, view.plane, REFERENCE)


def test_points_that_coincide_or_stand_in_line() -> None:
    names = (*PAPER_FEATURES, *INVARIANTS)
    point = Moments.from_points([[0.1, 0.2]] * 4)
    result = compute(point, names, FRONT, REFERENCE)
    assert np.isfinite(result.values).all() and np.isfinite(result.L).all()
    assert {"an", "alpha", "Px", "Py", "C1"} <= set(result.degenerate)
    with pytest.raises(UnavailableFeatureError, match="coincide"):
        compute(point, names, reference=REFERENCE)
    # Without a plane the depth comes from the area.
    far = compute(Moments.from_polygon(L_SHAPE / 0.8), names, reference=REFERENCE)
    assert far.plane == pytest.approx((0.0, 0.0, 1 / 0.8)) and far["an"] == pytest.approx(0.8)
    line = compute(Moments.from_points([[0, 0], [1, 1], [3, 3]]), names, FRONT, REFERENCE)
    assert np.isfinite(line.values).all() and np.isfinite(line.L).all()
    assert line["alpha"] == pytest.approx(pi / 4)


@pytest.mark.parametrize(("make", "text"), [
    (lambda shape: compute(shape, ("xq",), FRONT), "no feature 'xq'"),
    (lambda shape: compute(shape, ("C1 +",), FRONT), "neither a feature nor a formula"),
    (lambda shape: compute(shape, ("exp(C1)",), FRONT), "no rule to differentiate"),
    (lambda shape: compute(shape, ("xn",), FRONT), "needs a reference"),
    (lambda shape: compute(shape, ("alpha",)), "give a plane, or a reference"),
    *((lambda _, points=points: point_interaction(points, 1.0), r"shape .*, must have .* \(n, 2\)")
      for points in (np.ones((4, 3)), np.ones(2), [])),
    (lambda shape: Reference(0.0, 1.0), "positive area and depth"),
    (lambda shape: compute_raw_interaction(shape, FRONT, 6), "need moments up to order 7"),
    (lambda shape: Plane.fronto_parallel(0.0), "must be positive, got 0 m"),
    (lambda shape: Plane.fronto_parallel(float("nan")), "must be positive, got nan m"),
    (lambda shape: Plane.from_pose(np.eye(3), [1.0, 0.0, 0.0]), "move the camera out of this p")])
def test_wrong_requests_are_refused(make, text: str) -> None:
    with pytest.raises(UnavailableFeatureError, match=text):
        make(Moments.from_polygon(L_SHAPE))


# -- rectified view of a tilted target, compared with a camera that faces it --------------------


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
        found = TargetOrientation.from_moments(moments, seen.plane)
        assert found.alpha == pytest.approx(axis(moments.centred), abs=1e-12)
        assert abs(remainder(found.upright_alpha - axis(exact.centred), pi)) < TOLERANCE
        np.testing.assert_allclose(found.third, third(exact.centred), atol=TOLERANCE)


# -- reference values from another library and from 50-digit arithmetic -------------------------


GOLDEN = Path(__file__).parent / "golden.json"


CASES = [pytest.param(case, kind, id=f"{case['name']}-{kind}")
         for case in json.loads(GOLDEN.read_text())["cases"]
         for kind in case["variants"]]


def _moments(case: dict, kind: str) -> tuple[Moments, Moments]:
    if kind == "discrete":
        return (Moments.from_points(case["vertices"]),
                Moments.from_points(case["desired_vertices"]))
    desired = Moments.from_polygon(case["desired_vertices"])
    if kind == "polygon":
        return Moments.from_polygon(case["vertices"]), desired
    camera = case["camera"]
    pinhole = Pinhole(camera["px"], camera["py"], camera["u0"], camera["v0"])
    mask = pixels_inside(np.array(case["vertices"]), pinhole, (camera["height"], camera["width"]))
    spec = case["image_spec"]
    assert int(mask.sum()) == spec["pixels_on"]
    assert hashlib.sha256(mask * np.uint8(255)).hexdigest() == spec["sha256_of_raw_bytes"]
    return Moments.from_image(mask, pinhole), desired


@pytest.mark.parametrize(("case", "kind"), CASES)
def test_values_and_rows_are_those_of_another_library(case: dict, kind: str) -> None:
    variant = case["variants"][kind]
    moments, desired = _moments(case, kind)
    reference = Reference.from_moments(desired, variant["desired"]["Zstar"])
    names = tuple(variant["L"])
    result = compute(moments, names, Plane(*case["plane_ABC"]), reference)
    rg2 = (variant["mu"]["mu20"] + variant["mu"]["mu02"]) / variant["m"]["m00"]
    R = (rg2 + variant["xg"] ** 2 + variant["yg"] ** 2) ** 0.5

    def scale(name: str) -> float:
        if match := re.match(r"(m|mu)(\d)(\d)$", name):
            radius = R if match[1] == "m" else rg2**0.5
            return variant["m"]["m00"] * radius ** (int(match[2]) + int(match[3]))
        return {"xg": R, "yg": R}.get(name, variant["an"] if name in ("an", "xn", "yn") else 1.0)

    def agrees(key: str, ours, expected, size: float) -> None:
        flag = variant["flags"].get(key)
        expected = expected if flag is None else flag["independent"]
        if expected is None:
            return
        error = np.abs(np.subtract(ours(), expected)).max()
        assert error <= 1e-7 * max(np.abs(expected).max(), size), (key, ours(), expected)

    for name in names:
        key = "alpha_sym" if name == "alpha" else name
        value = {**variant["m"], **variant["mu"]}.get(key, variant.get(key))
        agrees(key, lambda n=name: result[n], value, scale(name))
        agrees("L." + name, lambda n=name: result.L[names.index(n)], variant["L"][name], 1e-3)
    for table, read in (("m", moments.m), ("mu", moments.mu)):
        for name, value in variant[table].items():
            agrees(name, lambda n=name, r=read: r(int(n[-2]), int(n[-1])), value, scale(name))

    truth = variant["alpha_full_independent"]
    if truth is None or reference.orientation is None:
        return
    full = compute(moments, ("alpha_full",), Plane(*case["plane_ABC"]), reference)["alpha_full"]
    turns = 1.0 if reference.orientation.is_symmetric else 2.0  # half turns show no difference
    assert abs((full - truth + turns * pi / 2) % (turns * pi) - turns * pi / 2) < 1e-7
