"""Photometric features on an analytic texture, compared with finite differences."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from feature_scenes import moved
from free_camera import pose
from scipy.fft import dctn
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError
from aras_visual_servo_controller.features import FEATURES
from aras_visual_servo_controller.features.luminance import (
    BORDER,
    LuminancePCA,
    _PixelRays,
    get_grey_image,
    square_root,
)
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.schemes import FeatureScheme

PINHOLE = CameraModel(160, 120, (180.0, 0, 79.5, 0, 180.0, 59.5, 0, 0, 1))
WIDE = CameraModel(160, 120, (180.0, 0, 79.5, 0, 165.0, 59.5, 0, 0, 1), (-0.2, 0.05, 0, 0))
GOAL = pose((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))
VIEW = pose((0.04, -0.03, 0.9), (0.15, -0.1, 0.2))
# Every registered feature that needs a picture has to be here.
MAPS = ("luminance_dct", "luminance_pca", "photometric_moments")
ALL = ("luminance", "luminance_lm", *MAPS)


def texture(X, Y):
    """Grey levels of the plane, smooth: 20 to 236."""
    return 128.0 + 36.0 * (
        np.sin(17.0 * X + 3.0 * Y) + np.cos(5.0 * X - 14.0 * Y + 1.0) + np.sin(9.0 * X * Y * 8 + 2)
    )  # fmt: skip


def picture(camera, camera_T_object):
    """(rows, columns) float of the plane z = 0 of the object, by its rays."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y, _ = camera.normalise(u.ravel().astype(float), v.ravel().astype(float))
    object_T_camera = np.linalg.inv(camera_T_object)
    rays = np.column_stack([x, y, np.ones(len(x))]) @ object_T_camera[:3, :3].T
    origin = object_T_camera[:3, 3]
    P = origin - rays * (origin[2] / rays[:, 2])[:, None]
    return texture(P[:, 0], P[:, 1]).reshape(camera.height, camera.width)


def look(camera, place, needs):
    plane = Plane.from_pose(place[:3, :3], place[:3, 3])
    image = np.round(picture(camera, place)).astype(np.uint8)
    return FeatureObserver(None, needs).observe_image(0.0, image, camera, plane=plane)


def at_goal(name, camera=PINHOLE):
    feature = FEATURES.create(name)
    goal = Goal.teach(FeatureScheme(feature), look(camera, GOAL, feature.needs))
    feature.check(goal)
    return feature, goal


def smooth(image):
    return cv2.GaussianBlur(image, (0, 0), 1.0)[BORDER:-BORDER, BORDER:-BORDER].ravel()


def rates(camera, place, step=1e-4):
    """Return dI/dv (pixels, 6) by finite differences of exact images."""
    return np.array([
        (smooth(picture(camera, moved(place, step * v)))
         - smooth(picture(camera, moved(place, -step * v)))) / (2 * step)
        for v in np.eye(6)
    ]).T  # fmt: skip


@pytest.mark.parametrize("camera", [PINHOLE, WIDE], ids=["pinhole", "lens"])
@pytest.mark.parametrize(("name", "damping"), [("luminance", 0.0), ("luminance_lm", 0.01)])
def test_the_normal_equations_are_those_of_every_pixel(name, damping, camera):
    feature, goal = at_goal(name, camera)
    found = feature.measure(look(camera, VIEW, feature.needs), goal)
    J = rates(camera, VIEW)
    e = smooth(picture(camera, VIEW)) - smooth(picture(camera, GOAL))
    H = J.T @ J
    H += damping * np.diag(np.diag(H))
    scale = np.sqrt(np.diag(H))
    assert found.L.T @ found.L / np.outer(scale, scale) == pytest.approx(
        H / np.outer(scale, scale), abs=0.02
    )
    size = scale * np.linalg.norm(e)
    assert found.L.T @ found.error / size == pytest.approx(J.T @ e / size, abs=0.005)
    assert found.error_summary == pytest.approx(np.sqrt(np.mean(e**2)), rel=0.01)


def test_pixels_move_with_rays_as_the_lens_projects_them():
    """Of one that leans: a pixel's column depends on y, its row on x."""
    K = (180.0, 0, 70.5, 0, 165.0, 66.5, 0, 0, 1)
    lens = CameraModel(160, 120, K, (-0.3, 0.1, 0.02, -0.03))
    rays, step = _PixelRays(lens), 1e-6
    v, u = (grid[BORDER:-BORDER, BORDER:-BORDER] for grid in np.indices((120, 160)))
    x, y, _ = lens.normalise(u.ravel().astype(float), v.ravel().astype(float))
    np.testing.assert_allclose(rays.x.ravel(), x, atol=1e-6)
    np.testing.assert_allclose(rays.y.ravel(), y, atol=1e-6)
    for by, ways in ((("ux", "vx"), (step, 0.0)), (("uy", "vy"), (0.0, step))):
        sides = [lens.project(x + sign * ways[0], y + sign * ways[1]) for sign in (1.0, -1.0)]
        for name, one, other in zip(by, *sides, strict=True):
            found = getattr(rays, name).ravel()
            np.testing.assert_allclose(found, (one - other) / (2.0 * step), atol=0.2)


@pytest.mark.parametrize("name", MAPS)
def test_maps_are_linear_in_the_picture(name):
    feature, goal = at_goal(name)
    found = feature.measure(look(PINHOLE, VIEW, feature.needs), goal)
    B, J = feature._basis.astype(float), rates(PINHOLE, VIEW)
    e = smooth(picture(PINHOLE, VIEW)) - smooth(picture(PINHOLE, GOAL))
    assert np.linalg.norm(B, axis=1) == pytest.approx(1.0, abs=1e-3)
    assert found.error == pytest.approx(B @ e, abs=0.01 * np.abs(B @ e).max())
    rows = B @ J
    size = np.abs(rows).max(axis=0)
    assert found.L / size == pytest.approx(rows / size, abs=0.03)


def test_moments_are_moments():
    feature, goal = at_goal("photometric_moments")
    feature.measure(look(PINHOLE, VIEW, feature.needs), goal)
    B = feature._basis
    shape = (PINHOLE.height - 2 * BORDER, PINHOLE.width - 2 * BORDER)
    even = B[0].reshape(shape)
    assert even == pytest.approx(even[::-1, ::-1], abs=1e-6)
    assert even[shape[0] // 2, shape[1] // 2] == even.max()
    row, column = shape[0] // 2, shape[1] // 2
    along, down = even[row, column : column + 40], even[row : row + 40, column]
    assert along == pytest.approx(down, abs=1e-6)  # as far to the right as below
    # exp(-4 (r / reach)^4), of which the reach is to the nearer rim: 49.5 pixels
    r2 = (np.arange(40) + 0.5) ** 2 + 0.25
    expected = np.exp(-4.0 * (r2 / 49.5**2) ** 2)
    assert along / along[0] == pytest.approx(expected / expected[0], abs=1e-5)
    # Beside the weight alone each is a monomial, y first: y, x, y^2, x y, x^2 ...
    places = slice(row - 25, row + 26), slice(column - 25, column + 26)
    down, right = (np.mgrid[-25:26, -25:26] + 0.5) / 25.5  # from between the middle pixels
    powers = [(n - p, p) for n in range(4) for p in range(n + 1)]
    for moment, (q, p) in zip(B, powers, strict=True):
        ratio = moment.reshape(shape)[places] / even[places]
        assert ratio == pytest.approx(ratio[-1, -1] * down**q * right**p, abs=1e-4)


def test_principal_components_hold_what_a_motion_changes():
    """They are of differences to the goal's picture: of turns, shifts and scales."""
    turns = [moved(GOAL, np.array([0, 0, 0, 0, 0, turn])) for turn in (-0.15, -0.05, 0.1)]
    changes = [smooth(picture(PINHOLE, t)) - smooth(picture(PINHOLE, GOAL)) for t in turns]
    for spread, least in ((LuminancePCA.spread, 0.99), ((0.0, 0.2, 0.0), 0.999)):
        feature, goal = at_goal("luminance_pca")
        feature.spread = spread  # turns alone, about the middle, are held nearly whole
        feature.measure(look(PINHOLE, VIEW, feature.needs), goal)
        B = feature._basis.astype(float)
        for change in changes:
            held = np.linalg.lstsq(B.T, change, rcond=None)[0] @ B
            assert np.linalg.norm(held) > least * np.linalg.norm(change)


def test_principal_components_are_those_of_pictures_drawn_by_a_fixed_seed():
    """A turn and a scale about the middle, then a shift, in this order; by SciPy."""
    feature, goal = at_goal("luminance_pca")
    feature.views, feature.count = 7, 4
    feature.measure(look(PINHOLE, VIEW, feature.needs), goal)
    random, wanted = np.random.default_rng(0), feature._desired
    places, middle = np.indices(wanted.shape)[::-1].reshape(2, -1), np.array([[80.0], [60.0]])
    changes = []
    for _ in range(7):
        turn = random.uniform(-0.2, 0.2)
        c, s = (1.0 + random.uniform(-0.1, 0.1)) * np.array([np.cos(turn), np.sin(turn)])
        shift = 160.0 * random.uniform(-0.1, 0.1, (2, 1))
        at = np.linalg.solve([[c, s], [-s, c]], places - shift - middle) + middle
        moved = map_coordinates(wanted, at[::-1], order=1, mode="reflect").reshape(wanted.shape)
        changes.append((moved - wanted)[BORDER:-BORDER, BORDER:-BORDER].ravel())
    expected = np.linalg.svd(changes, full_matrices=False)[2][:4]
    assert np.abs(np.sum(feature._basis * expected, axis=1)) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("count", [20, 45])
def test_coefficients_of_the_cosine_transform_are_the_lowest_in_order_but_the_mean(count):
    """Of orders up to seven each way."""
    feature, goal = at_goal("luminance_dct")
    feature.count = count
    found = feature.measure(look(PINHOLE, VIEW, feature.needs), goal)
    e = smooth(picture(PINHOLE, VIEW)) - smooth(picture(PINHOLE, GOAL))
    coefficients = dctn(e.reshape(120 - 2 * BORDER, 160 - 2 * BORDER), norm="ortho")
    orders = [(down, total - down) for total in range(1, 15) for down in range(total + 1)]
    orders = [order for order in orders if max(order) < 8][:count]
    expected = np.array([coefficients[order] for order in orders])
    assert found.error == pytest.approx(expected, abs=0.005 * np.abs(expected).max())


def test_cosines_are_orthogonal():
    feature, goal = at_goal("luminance_dct")
    feature.measure(look(PINHOLE, VIEW, feature.needs), goal)
    B = feature._basis.astype(float)
    assert pytest.approx(np.eye(len(B)), abs=1e-4) == B @ B.T
    assert B.sum(axis=1) == pytest.approx(0.0, abs=1e-3)
    down, across = (np.cos(np.pi * (np.arange(n - 2 * BORDER) + 0.5) / (n - 2 * BORDER))
                    for n in (PINHOLE.height, PINHOLE.width))  # fmt: skip
    both = np.outer(down, across).ravel()  # one of the lowest orders
    assert np.linalg.norm(B @ both) == pytest.approx(np.linalg.norm(both), rel=1e-4)


@pytest.mark.parametrize("name", ALL)
def test_at_the_goal_nothing_is_left(name):
    feature, goal = at_goal(name)
    found = feature.measure(look(PINHOLE, GOAL, feature.needs), goal)
    assert found.error == pytest.approx(0.0, abs=1e-9)
    assert found.error_summary == pytest.approx(0.0, abs=1e-6)


def test_accuracy_is_that_of_grey_levels_and_of_neighbours_that_are_off_together():
    """Of a picture that is brighter all over, which no motion explains."""
    feature, goal = at_goal("luminance")
    seen = look(PINHOLE, GOAL, feature.needs)
    found = []
    for brighter in (0, 4, 8):
        feature.measure(replace(seen, image=seen.image + np.uint8(brighter)), goal)
        found.append(feature.accuracy(seen, goal))
    grey = found[0][0, 0]
    assert grey == pytest.approx(0.2)  # rounding and drawing alone
    for brighter, size in zip((0, 4, 8), found, strict=True):
        assert size == pytest.approx(np.hypot(grey, 3.5 * brighter) * np.eye(6), rel=1e-3)
    brighter = seen.image.copy()  # what lies where the picture is steep counts as much more
    brighter[:, :80] += 8
    feature.measure(replace(seen, image=brighter), goal)
    before, now = (cv2.GaussianBlur(one.astype(np.float32), (0, 0), 1.0)
                   for one in (seen.image, brighter))  # fmt: skip
    inside = (slice(BORDER, -BORDER),) * 2
    steep = np.sum(np.square(np.gradient(now)), axis=0)[inside]
    left = np.sqrt(np.average((now - before)[inside] ** 2, weights=steep))
    size = feature.accuracy(seen, goal)
    assert size == pytest.approx(np.hypot(grey, 3.5 * left) * np.eye(6), rel=1e-3)


@pytest.mark.parametrize("name", ALL)
def test_the_camera_flies_to_where_the_picture_was_taken(name):
    feature, goal = at_goal(name)
    scheme = FeatureScheme(feature)
    place = pose((0.01, -0.012, 0.82), (0.02, -0.015, 0.04))
    first = np.linalg.norm(place @ np.linalg.inv(GOAL) - np.eye(4))
    for k in range(30):
        decision = scheme.compute(look(PINHOLE, place, feature.needs), goal, 0.1 * k)
        place = moved(place, 0.1 * decision.task.twist)
    assert np.linalg.norm(place @ np.linalg.inv(GOAL) - np.eye(4)) < 0.1 * first


@pytest.mark.parametrize(
    ("sides", "told"), [((0.11, 0.11), "90°"), ((0.14, 0.08), "180°"), (None, "")]
)
def test_a_picture_that_looks_the_same_when_turned_says_so(sides, told, monkeypatch):
    """Of a rectangle beside the axis of a tilted camera; a photograph looks like nothing else."""
    if sides is not None:

        def rectangle(X, Y):
            edge = 5e-3  # m over which it fades, about a pixel
            inside = [
                np.clip(0.5 + (half - np.abs(V - middle)) / edge, 0.0, 1.0)
                for V, half, middle in ((X, sides[0], 0.01), (Y, sides[1], -0.015))
            ]
            return 250.0 - 200.0 * inside[0] * inside[1]

        monkeypatch.setitem(globals(), "texture", rectangle)
    feature = FEATURES.create("luminance")
    seen = look(PINHOLE, VIEW, feature.needs)
    goal = Goal.teach(FeatureScheme(feature), seen)
    assert feature.measure(seen, goal).ambiguity == told


@pytest.mark.parametrize(("folds", "told"), [
    (2, "180°"), (3, "120°"), (4, "90°"), (5, "72°"), (6, "60°"), (7, "51°"), (8, "45°"),
    (9, "120°"), (10, "72°"), (11, ""),
])  # fmt: skip
def test_the_smallest_turn_of_an_eighth_or_more_is_told(folds, told):
    """Of a star of so many rays about the middle, which fades before the picture ends."""
    u, v = np.meshgrid(np.arange(160) - 79.5, np.arange(120) - 59.5)
    away = np.hypot(u, v)
    star = np.clip((away - 6.0) / 6.0, 0.0, 1.0) * np.clip((44.0 - away) / 6.0, 0.0, 1.0)
    star = np.round(128.0 + 60.0 * star * np.cos(folds * np.arctan2(v, u))).astype(np.uint8)
    feature = FEATURES.create("luminance")
    seen = FeatureObserver(None, feature.needs).observe_image(
        0.0, star, PINHOLE, plane=Plane(0, 0, 1.25)
    )
    assert feature.measure(seen, Goal.teach(FeatureScheme(feature), seen)).ambiguity == told


@pytest.mark.parametrize(("column", "told"), [(27, "180°"), (25, "")])
def test_a_turn_is_judged_by_three_tenths_of_the_picture_at_least(column, told):
    """Of a rectangle near the left side: half a turn about it leaves 45 or 41 of 140 columns."""
    image = np.full((120, 160), 250, np.uint8)
    image[45:75, column - 12 : column + 13] = 20
    feature = FEATURES.create("luminance")
    seen = FeatureObserver(None, feature.needs).observe_image(
        0.0, image, PINHOLE, plane=Plane(0, 0, 1.25)
    )
    assert feature.measure(seen, Goal.teach(FeatureScheme(feature), seen)).ambiguity == told


@pytest.mark.parametrize(("wide", "told"), [(9, "180°"), (13, "")])
def test_a_picture_looks_the_same_when_turned_to_its_tolerance_rms(wide, told):
    """But for two stripes that half a turn about its middle makes 4 brighter or darker."""
    u, v = np.meshgrid(np.arange(160) - 79.5, np.arange(120) - 59.5)
    image = np.round(128.0 + 60.0 * np.cos(u / 40.0) * np.cos(v / 20.0)).astype(np.uint8)
    image[:, 30 : 30 + wide] += 2
    image[:, 130 - wide : 130] -= 2
    off = smooth(image.astype(np.float32)) - smooth(image[::-1, ::-1].astype(np.float32))
    assert (np.sqrt(np.mean(off**2)) < 1.5 < np.mean(off**2)) == bool(told)
    feature = FEATURES.create("luminance")
    seen = FeatureObserver(None, feature.needs).observe_image(
        0.0, image, PINHOLE, plane=Plane(0.0, 0.0, 1.25)
    )  # fmt: skip
    goal = Goal.teach(FeatureScheme(feature), seen)
    assert feature.measure(seen, goal).ambiguity == told


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("before", ["lens", "goal"])
def test_nothing_stays_of_the_camera_or_the_goal_before(name, before):
    """Where the goal does not say with which camera it was taught."""
    feature, goal = at_goal(name)
    anywhere = replace(goal, camera=None)
    if before == "lens":
        feature.measure(look(PINHOLE, VIEW, feature.needs), anywhere)
    else:
        seen = look(WIDE, moved(VIEW, np.array([0.1, 0.05, 0, 0, 0, 0.3])), feature.needs)
        feature.measure(seen, replace(Goal.teach(FeatureScheme(feature), seen), camera=None))
    found = feature.measure(look(WIDE, VIEW, feature.needs), anywhere)
    anew = FEATURES.create(name).measure(look(WIDE, VIEW, feature.needs), anywhere)
    np.testing.assert_array_equal(found.L, anew.L)
    np.testing.assert_array_equal(found.error, anew.error)


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_too_little_texture_is_a_matter_of_its_share_and_not_of_its_size(size):
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix()
    mixed = np.kron(np.eye(2), turn)
    H, g = (size * mixed @ np.diag([least, 1.0, 2.0, 3.0, 4.0, 100.0]) @ mixed.T
            for least in (1.5e-10, 0.7e-10)), np.arange(6.0)  # fmt: skip
    s, R = square_root(enough := next(H), g)
    np.testing.assert_allclose(R.T @ R, enough, atol=1e-11 * size)
    np.testing.assert_allclose(R.T @ s, g, atol=1e-3)
    with pytest.raises(MeasurementError, match="too little texture"):
        square_root(next(H), g)


def test_each_that_needs_pictures_is_here():
    assert {n for n, feature in FEATURES.items() if Need.IMAGE in feature.needs} == {
        *ALL, "matches", "matches_orb", "matches_pose",  # tests/unit/bench/test_textures.py
    }


def test_of_a_picture_in_colour_its_grey_levels_count():
    """As an eye weighs red, green and blue."""
    colours = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    found = get_grey_image(SimpleNamespace(image=colours))
    assert found.shape == (60, 80) and found.dtype == np.uint8
    np.testing.assert_allclose(found, colours @ np.array([0.299, 0.587, 0.114]), atol=0.6)
    assert get_grey_image(SimpleNamespace(image=found)) is found
    with pytest.raises(MeasurementError, match="this observation has no image"):
        get_grey_image(SimpleNamespace(image=None))


def test_bad_pictures_are_one_line():
    feature, goal = at_goal("luminance")
    other = CameraModel(80, 60, (90.0, 0, 39.5, 0, 90.0, 29.5, 0, 0, 1))
    with pytest.raises(MeasurementError, match="80 x 60 pixels, but the goal's image has 160 x"):
        feature.measure(look(other, GOAL, feature.needs), goal)
    longer = CameraModel(160, 120, (200.0, 0, 79.5, 0, 200.0, 59.5, 0, 0, 1))
    with pytest.raises(MeasurementError, match=r"another camera \(160x120 px, fx 180.00; this "
                                               r"camera has"):
        feature.measure(look(longer, GOAL, feature.needs), goal)
    lens = CameraModel(160, 120, PINHOLE.K, (-0.2, 0.05, 0.0, 0.0, 0.0))
    with pytest.raises(MeasurementError, match=r"another camera \(lens plumb_bob \[\]; this one's"):
        feature.measure(look(lens, GOAL, feature.needs), goal)
    plain = CameraModel(160, 120, PINHOLE.K, (0.0,) * 5, "rational_polynomial")  # the same rays
    assert feature.measure(look(plain, GOAL, feature.needs), goal).error == pytest.approx(0.0)
    through, there = at_goal("luminance", lens)
    assert through.measure(look(lens, GOAL, through.needs), there).error == pytest.approx(0.0)
    through.check(replace(goal, camera=longer))  # another goal, and the camera is looked at anew
    with pytest.raises(MeasurementError, match="another camera"):
        through.measure(look(lens, GOAL, through.needs), through._goal)
    small = CameraModel(160, 39, (180.0, 0, 79.5, 0, 180.0, 19.5, 0, 0, 1))
    few, shown = at_goal("luminance", small)
    with pytest.raises(MeasurementError, match="too small for photometric servoing"):
        few.measure(look(small, GOAL, few.needs), shown)
    least = replace(small, height=40)
    few, shown = at_goal("luminance", least)
    assert few.measure(look(least, GOAL, few.needs), shown).error == pytest.approx(0.0)
    exact = FeatureObserver(None, feature.needs).observe_exact_features(0.0, PINHOLE)
    with pytest.raises(MeasurementError, match="no image"):
        feature.measure(exact, goal)
    plain = FeatureObserver(None, feature.needs).observe_image(
        0.0, np.full((120, 160), 90, np.uint8), PINHOLE, plane=goal.plane
    )
    with pytest.raises(MeasurementError, match="too little texture"):
        feature.measure(plain, goal)
    with pytest.raises(ConfigurationError, match="teach it"):
        feature.check(Goal("mine", depth=1.0))
    with pytest.raises(ConfigurationError, match="cannot be decoded|no image"):
        feature.check(Goal("mine", depth=1.0, features={"luminance": {"png": "AAAA"}}))
