"""Keypoints matched with the goal's image: s, e and L, compared with the rendered plane."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from free_camera import pose

from aras_visual_servo_base.poses import inverse, rotation_vector
from aras_visual_servo_bench.targets.rendering import render_target
from aras_visual_servo_bench.targets.target_factory import make_target
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import FEATURES, CameraModel, FeatureObserver, Goal
from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError
from aras_visual_servo_controller.schemes import FeatureScheme

CAMERA = CameraModel(320, 240, (300.0, 0, 159.5, 0, 300.0, 119.5, 0, 0, 1))
FACING = np.diag([1.0, -1.0, -1.0, 1.0])  # a poster's z is towards the camera
GOAL = pose((0.02, -0.03, 0.7), (0.15, -0.2, 0.1))
NOW = pose((0.06, 0.02, 0.8), (0.05, 0.1, 0.4))


@pytest.fixture(scope="module")
def picture():
    return make_target("poster", (0.8, 0.6))


def look(feature, picture, place, known=True):
    image = render_target(picture, CAMERA, FACING @ np.linalg.inv(place))
    plane = Plane.from_pose(place[:3, :3], place[:3, 3]) if known else None
    return FeatureObserver(None, feature.needs).observe_image(0.0, image, CAMERA, plane=plane)


def measured(name, picture, known=True):
    feature = FEATURES.create(name)
    goal = Goal.teach(FeatureScheme(feature), look(feature, picture, GOAL))
    feature.check(goal)
    return feature.measure(look(feature, picture, NOW, known), goal)


def on_plane(points, place):
    """Places (n, 3) in the camera's frame of points (n, 2) of the plane z = 0 of the object."""
    rays = np.column_stack([points, np.ones(len(points))])
    normal, at = place[:3, 2], place[:3, 3]
    return rays * (normal @ at / (rays @ normal))[:, None]


@pytest.mark.parametrize(("name", "most"), [("matches", 0.3), ("matches_orb", 1.2)])
def test_points_their_error_and_their_rate_are_those_of_the_plane(name, most, picture):
    found = measured(name, picture)
    s, desired = found.s.reshape(-1, 2), found.desired.reshape(-1, 2)
    assert len(s) > 20
    then = on_plane(desired, GOAL) @ (NOW @ inverse(GOAL))[:3, :3].T + (NOW @ inverse(GOAL))[:3, 3]
    off = (s - then[:, :2] / then[:, 2:]) * CAMERA.K[0]  # px
    assert np.median(np.linalg.norm(off, axis=1)) < most
    # where a picture is read a pixel off, all are off by the same
    assert np.abs(np.median(off, axis=0)).max() < 0.6 * most
    assert found.error == pytest.approx(found.s - found.desired)
    for (x, y), Z, rows in zip(s, on_plane(s, NOW)[:, 2], found.L.reshape(-1, 2, 6), strict=True):
        assert rows[0] == pytest.approx([-1 / Z, 0, x / Z, x * y, -1 - x * x, y], abs=1e-6)
        assert rows[1] == pytest.approx([0, -1 / Z, y / Z, 1 + y * y, -x * y, -x], abs=1e-6)
    away = np.linalg.norm(s - desired, axis=1)
    assert found.error_summary == pytest.approx(np.sqrt(np.mean(away**2)))
    assert FEATURES.create(name).tolerances == FEATURES.create("points").tolerances[:1]
    with pytest.raises(MeasurementError, match="the target's plane is not known"):
        measured(name, picture, known=False)


def test_the_pose_of_matches_is_the_cameras(picture):
    found = measured("matches_pose", picture)
    g_T_c = GOAL @ inverse(NOW)
    assert found.s[:3] == pytest.approx(g_T_c[:3, 3], abs=5e-3)
    assert found.s[3:] == pytest.approx(rotation_vector(g_T_c[:3, :3]), abs=8e-3)
    assert found.error == pytest.approx(found.s)
    assert found.L[:3, :3] == pytest.approx(g_T_c[:3, :3], abs=8e-3)


@pytest.fixture(scope="module")
def narrow(picture):
    image = look(FEATURES.create("matches"), picture, GOAL).image[60:180, 80:240]
    return np.ascontiguousarray(image)


def test_keypoints_are_where_they_are_in_the_picture_that_is_turned_by_half(narrow):
    """Read a quarter of a pixel aside, as SIFT does by default, they are not."""
    feature = FEATURES.create("matches")
    upright, turned = (feature.detect_keypoints(np.ascontiguousarray(one))[0]
                       for one in (narrow, narrow[::-1, ::-1]))  # fmt: skip
    off = [159, 119] - upright[:, None] - turned
    nearest = off[np.arange(len(off)), np.linalg.norm(off, axis=2).argmin(axis=1)]
    same = nearest[np.linalg.norm(nearest, axis=1) < 2.0]
    assert len(same) > 50
    assert same.mean(axis=0) == pytest.approx(0.0, abs=0.05)
    # Of a picture that is too wide they are those of the smaller one.
    feature.max_width = 160
    small, wide = (feature.detect_keypoints(one)[0]
                   for one in (narrow, narrow.repeat(3, axis=0).repeat(3, axis=1)))  # fmt: skip
    np.testing.assert_allclose(wide, 3.0 * small + 1.0, atol=1e-4)


@pytest.mark.parametrize(("name", "detector", "aside"), [
    ("matches", cv2.SIFT_create(nfeatures=500), 0.25),
    ("matches_orb", cv2.ORB_create(nfeatures=500), 0.0),
])  # fmt: skip
def test_of_a_picture_that_is_narrow_enough_keypoints_are_its_own(name, detector, aside, narrow):
    places, descriptors = FEATURES.create(name).detect_keypoints(narrow)
    keypoints, expected = detector.detectAndCompute(narrow, None)
    np.testing.assert_allclose(places, np.array([k.pt for k in keypoints]) - aside, atol=1e-9)
    np.testing.assert_array_equal(descriptors, expected)


def detecting(name):
    """A feature with a detector of its own: each image has the keypoints `shown`."""
    class Shown(type(FEATURES.create(name))):
        def detect_keypoints(self, grey):
            return self.shown

    return Shown()


def test_eight_keypoints_that_agree_are_enough(picture):
    feature = detecting("matches")
    seen = look(feature, picture, GOAL)
    all_of = FEATURES.create("matches").detect_keypoints(seen.image)
    eight, seven = ([part[:end:40] for part in all_of] for end in (281, 280))
    feature.shown = eight
    goal = Goal.teach(FeatureScheme(feature), seen)
    assert feature.measure(seen, goal).error == pytest.approx(np.zeros(16))
    feature.check(goal)
    for shown, wrong, words in (
        (seven, goal, "has 7 keypoints, but 8 are needed"),
        (eight, replace(goal, camera=None), "the image of .* has .* keypoints"),  # no rays then
    ):
        feature.shown = shown
        with pytest.raises(ConfigurationError, match=words):
            feature.check(wrong)


GRID = np.array([[u, v] for u in (60.0, 110.0, 170.0, 230.0) for v in (40.0, 90.0, 150.0, 200.0)])


def matched(picture, at, distances, name="matches", plane=None):
    """What a feature measures of keypoints seen at (n, 2) px, of a goal's on GRID; distances
    (n, 2): of the descriptors of the best and the second best match of each."""
    feature, (best, second) = detecting(name), np.transpose(distances)
    seen, there = look(feature, picture, NOW), look(feature, picture, GOAL)
    own = np.column_stack([1e4 * np.eye(16), np.zeros(16)])
    along = np.eye(17)[16]
    feature.shown = np.vstack([GRID, GRID + 7.0]), np.vstack(
        [own, own + np.outer(best + second, along)]).astype(np.float32)
    goal = Goal.teach(FeatureScheme(feature), there)
    feature.check(goal)
    feature.shown = at, (own + np.outer(best, along)).astype(np.float32)
    return feature, goal, replace(seen, plane=plane or seen.plane)


def as_seen(turn, shift):
    """Pixels (n, 2) of GRID that is turned about the middle, rad, and shifted."""
    c, s = np.cos(turn), np.sin(turn)
    return (GRID - [159.5, 119.5]) @ np.array([[c, s], [-s, c]]) + [159.5, 119.5] + shift


def normalised(pixels):
    return (np.asarray(pixels) - [159.5, 119.5]) / 300.0


def test_matches_are_those_that_stand_out_and_that_agree(picture):
    """Nearer than 0.8 of the second best, and within some pixels of where the others have them."""
    at = as_seen(0.2, [3.0, -5.0])
    at[5] += [1.5, 0.0]
    at[6] += [0.0, 6.0]
    distances = np.tile([70.0, 100.0], (16, 1))
    distances[2], distances[3], distances[7] = [80.0, 100.0], [79.9, 100.0], [81.0, 100.0]
    distances[9] = [90.0, 100.0]
    feature, goal, seen = matched(picture, at, distances)
    found = feature.measure(seen, goal)
    kept = [i for i in range(16) if i not in (2, 6, 7, 9)]
    np.testing.assert_allclose(found.s, normalised(at[kept]).ravel(), atol=1e-9)
    np.testing.assert_allclose(found.desired, normalised(GRID[kept]).ravel(), atol=1e-9)
    for some, words in (
        ((0, 1, 4, 8, 10, 11, 12, 13), ""), ((0, 1, 4, 8, 10, 11, 12), "7 keypoints match the"),
        ((0, 1, 4, 8, 10, 11, 12, 6), "8 keypoints match the goal image, but 8 consistent matches "
                                      "are"),
    ):  # fmt: skip
        told = [[70.0 if i in some else 90.0, 100.0] for i in range(16)]
        feature, goal, seen = matched(picture, at, told)
        if words:
            with pytest.raises(MeasurementError, match=words):
                feature.measure(seen, goal)
        else:
            assert len(feature.measure(seen, goal).s) == 16
    one_place = matched(picture, np.full((16, 2), 90.0), np.tile([70.0, 100.0], (16, 1)))
    with pytest.raises(MeasurementError, match="16 keypoints match .*, but 8 consistent matches"):
        one_place[0].measure(one_place[2], one_place[1])


@pytest.mark.parametrize("name", ["matches", "matches_pose"])
def test_accuracy_is_by_how_far_matches_miss_the_plane_s_motion(name, picture):
    at = as_seen(0.0, [1.0, 2.0]) + np.random.default_rng(3).normal(0.0, 0.5, GRID.shape)
    told = np.tile([70.0, 100.0], (16, 1))
    plane = Plane(2.0, -0.4, 0.3)  # it lies behind the camera on the left: far away there
    feature, goal, seen = matched(picture, at, told, name, plane)
    found = feature.measure(seen, goal)
    points, desired = normalised(at), normalised(GRID)
    least = 1.0 / (500.0 * goal.distance)
    near = np.maximum(points @ (2.0, -0.4) + 0.3, least)
    assert (near == least).any() and (near > 0.01).any()
    rows = []
    for (x, y), w in zip(points, near, strict=True):
        rows += [[-w, 0, x * w, x * y, -1 - x * x, y], [0, -w, y * w, 1 + y * y, -x * y, -x]]
    L, e = np.array(rows), (points - desired).ravel()
    missed = np.std(e - L @ np.linalg.pinv(L) @ e)
    accuracy = feature.accuracy(seen, goal)
    if name == "matches":
        np.testing.assert_allclose(found.L, L, atol=1e-9)
        assert accuracy == pytest.approx(missed, rel=1e-6)
    else:
        np.testing.assert_allclose(accuracy, np.linalg.pinv(L) * missed, rtol=1e-6, atol=1e-9)
        np.testing.assert_array_equal(found.desired, np.zeros(6))
