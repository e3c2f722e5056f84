"""Photometric features on an analytic texture, compared with finite differences."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from feature_scenes import moved
from free_camera import pose
from loop_rig import an_image
from scipy.fft import dctn
from scipy.spatial.transform import Rotation

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import FEATURES, CameraModel, FeatureObserver, Goal, Need
from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError
from aras_visual_servo_controller.features.luminance import BORDER, get_grey_image, square_root
from aras_visual_servo_controller.schemes import FeatureScheme

PINHOLE = CameraModel(160, 120, (180.0, 0, 79.5, 0, 180.0, 59.5, 0, 0, 1))
WIDE = CameraModel(160, 120, (180.0, 0, 79.5, 0, 165.0, 59.5, 0, 0, 1), (-0.2, 0.05, 0, 0))
GOAL = pose((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))
VIEW = pose((0.04, -0.03, 0.9), (0.15, -0.1, 0.2))
# Every registered feature that needs a picture has to be here.
MAPS = ("luminance_dct", "luminance_pca", "photometric_moments")
ALL = ("luminance", "luminance_lm", *MAPS)


def texture(X, Y):
    return 128.0 + 36.0 * (
        np.sin(17.0 * X + 3.0 * Y) + np.cos(5.0 * X - 14.0 * Y + 1.0)
        + np.sin(9.0 * X * Y * 8 + 2))


def picture(camera, camera_T_object, texture=texture):
    """(rows, columns) float of the plane z = 0 of the object, by its rays."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y, _ = camera.normalise(u.ravel().astype(float), v.ravel().astype(float))
    object_T_camera = np.linalg.inv(camera_T_object)
    rays = np.column_stack([x, y, np.ones(len(x))]) @ object_T_camera[:3, :3].T
    origin = object_T_camera[:3, 3]
    P = origin - rays * (origin[2] / rays[:, 2])[:, None]
    return texture(P[:, 0], P[:, 1]).reshape(camera.height, camera.width)


def look(camera, place, needs, texture=texture):
    plane = Plane.from_pose(place[:3, :3], place[:3, 3])
    image = np.round(picture(camera, place, texture)).astype(np.uint8)
    return FeatureObserver(None, needs).observe_image(0.0, image, camera, plane=plane)


def at_goal(name, camera=PINHOLE):
    feature = FEATURES.create(name)
    goal = Goal.teach(FeatureScheme(feature), look(camera, GOAL, feature.needs))
    feature.check(goal)
    return feature, goal


def smooth(image):
    return cv2.GaussianBlur(image, (0, 0), 1.0)[BORDER:-BORDER, BORDER:-BORDER].ravel()


def rates(camera, place, step=1e-4):
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
        H / np.outer(scale, scale), abs=0.02)
    size = scale * np.linalg.norm(e)
    assert found.L.T @ found.error / size == pytest.approx(J.T @ e / size, abs=0.005)
    assert found.error_summary == pytest.approx(np.sqrt(np.mean(e**2)), rel=0.01)


@pytest.mark.parametrize("name", MAPS)
def test_maps_change_as_L_says(name):
    feature, goal = at_goal(name)
    step = 4e-3

    def measured(twist):
        return feature.measure(look(PINHOLE, moved(VIEW, twist), feature.needs), goal)

    rows = np.transpose([
        (measured(step * v).error - measured(-step * v).error) / (2 * step) for v in np.eye(6)])
    size = np.abs(rows).max(axis=0)
    assert measured(np.zeros(6)).L / size == pytest.approx(rows / size, abs=0.03)


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


@pytest.mark.parametrize("name", ALL)
def test_at_the_goal_nothing_is_left_and_nothing_of_the_camera_or_the_goal_before(name):
    """Where the goal does not say with which camera it was taught."""
    feature, goal = at_goal(name)
    found = feature.measure(look(PINHOLE, GOAL, feature.needs), goal)
    assert found.error == pytest.approx(0.0, abs=1e-9)
    assert found.error_summary == pytest.approx(0.0, abs=1e-6)
    anywhere, seen = replace(goal, camera=None), look(WIDE, VIEW, feature.needs)
    anew = FEATURES.create(name).measure(seen, anywhere)
    aside = look(WIDE, moved(VIEW, np.array([0.1, 0.05, 0, 0, 0, 0.3])), feature.needs)
    other = replace(Goal.teach(FeatureScheme(feature), aside), camera=None)
    for before, of in ((look(PINHOLE, VIEW, feature.needs), anywhere), (aside, other)):
        used = FEATURES.create(name)
        used.measure(before, of)
        found = used.measure(seen, anywhere)
        np.testing.assert_array_equal(found.L, anew.L)
        np.testing.assert_array_equal(found.error, anew.error)


def test_accuracy_is_that_of_grey_levels_and_of_neighbours_that_are_off_together():
    """Of a picture that is brighter all over, or on one side, which no motion explains."""
    feature, goal = at_goal("luminance")
    seen = look(PINHOLE, GOAL, feature.needs)
    before = cv2.GaussianBlur(seen.image.astype(np.float32), (0, 0), 1.0)
    aside = np.repeat(np.uint8([8, 0]), 80)
    for brighter in (np.uint8(0), np.uint8(4), np.uint8(8), aside):
        image = seen.image + brighter
        feature.measure(replace(seen, image=image), goal)
        now = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
        inside = (slice(BORDER, -BORDER),) * 2
        # what lies where the picture is steep counts as much more
        steep = np.sum(np.square(np.gradient(now)), axis=0)[inside]
        left = np.sqrt(np.average((now - before)[inside] ** 2, weights=steep))
        size = feature.accuracy(seen, goal)  # 0.2 of rounding and drawing
        assert size == pytest.approx(np.hypot(0.2, 3.5 * left) * np.eye(6), rel=1e-3)


@pytest.mark.parametrize(
    ("sides", "told"), [((0.11, 0.11), "90°"), ((0.14, 0.08), "180°"), (None, "")])
def test_a_picture_that_looks_the_same_when_turned_says_so(sides, told):
    """Of a rectangle beside the axis of a tilted camera; a photograph looks like nothing else."""

    def rectangle(X, Y):
        edge = 5e-3  # m over which it fades, about a pixel
        inside = [
            np.clip(0.5 + (half - np.abs(V - middle)) / edge, 0.0, 1.0)
            for V, half, middle in ((X, sides[0], 0.01), (Y, sides[1], -0.015))
        ]
        return 250.0 - 200.0 * inside[0] * inside[1]

    feature = FEATURES.create("luminance")
    seen = look(PINHOLE, VIEW, feature.needs, texture if sides is None else rectangle)
    goal = Goal.teach(FeatureScheme(feature), seen)
    assert feature.measure(seen, goal).ambiguity == told


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


def test_of_a_picture_in_colour_its_grey_levels_count():
    assert {n for n, feature in FEATURES.items() if Need.IMAGE in feature.needs} == {
        *ALL, "matches", "matches_orb", "matches_pose",  # tests/unit/bench/test_textures.py
    }
    colours = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    found = get_grey_image(an_image(0.0, 0.1, image=colours))
    assert found.shape == (60, 80) and found.dtype == np.uint8
    np.testing.assert_allclose(found, colours @ np.array([0.299, 0.587, 0.114]), atol=0.6)
    assert get_grey_image(an_image(0.0, 0.1, image=found)) is found


def test_bad_pictures_are_one_line():
    feature, goal = at_goal("luminance")
    lens = CameraModel(160, 120, PINHOLE.K, (-0.2, 0.05, 0.0, 0.0, 0.0))
    plain = CameraModel(160, 120, PINHOLE.K, (0.0,) * 5, "rational_polynomial")  # the same rays
    small = CameraModel(160, 39, (180.0, 0, 79.5, 0, 180.0, 19.5, 0, 0, 1))
    longer = CameraModel(160, 120, (200.0, 0, 79.5, 0, 200.0, 59.5, 0, 0, 1))
    other = CameraModel(80, 60, (90.0, 0, 39.5, 0, 90.0, 29.5, 0, 0, 1))
    for camera, taught, words in (
        (other, goal, "80 x 60 pixels, but the goal's image has 160 x"),
        (longer, goal, r"another camera \(160x120 px, fx 180.00; this camera has"),
        (lens, goal, r"camera \(lens plumb_bob \[\]; this camera's"),
        (plain, goal, ""), (lens, at_goal("luminance", lens)[1], ""),
        (small, at_goal("luminance", small)[1], "too small for photometric servoing"),
        (least := replace(small, height=40), at_goal("luminance", least)[1], ""),
    ):
        seen = look(camera, GOAL, feature.needs)
        if words:
            with pytest.raises(MeasurementError, match=words):
                feature.measure(seen, taught)
        else:
            new = FEATURES.create("luminance")
            assert new.measure(seen, taught).error == pytest.approx(0.0)
    observer = FeatureObserver(None, feature.needs)
    even = np.full((120, 160), 90, np.uint8)
    for seen, words in (
        (observer.observe_exact_features(0.0, PINHOLE), "this observation has no image"),
        (observer.observe_image(0.0, even, PINHOLE, plane=goal.plane), "too little texture"),
    ):
        with pytest.raises(MeasurementError, match=words):
            feature.measure(seen, goal)
    for features, words in (
        ({}, "teach it"), ({"luminance": {"png": "AAAA"}}, "cannot be decoded|no image"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            feature.check(Goal("mine", depth=1.0, features=features))
