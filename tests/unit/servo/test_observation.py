"""Observations from images, messages and exact geometry are equal."""

import numpy as np
import pytest
from loop_rig import CAMERA, STARTS, picture, the_arm, the_goal

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.contour import CORNER_ACCURACY
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.intersection_accuracy import compute_rms_deviation
from aras_visual_servo_camera.segmentation_settings import SegmentationSettings
from aras_visual_servo_camera.trackers import TrackedPoints, Tracker
from aras_visual_servo_controller import CameraModel, JointSample, MeasurementError, Moments, Need
from aras_visual_servo_controller.observation.feature_observer import (
    FeatureObserver,
    explain_implausible,
)

ALL = frozenset(Need)


def joints(t, q=None):
    names = the_arm().names
    return JointSample.from_values(t, names, STARTS["2016"] if q is None else q, np.zeros(6))


def outline(q=None):
    pose = the_arm().pose(np.array(STARTS["2016"] if q is None else q, float))
    return the_goal("2016").target.compute_outline(pose)


def test_a_picture_and_exact_geometry_say_the_same():
    observer = FeatureObserver(the_arm(), ALL)
    seen = observer.observe_image(0.5, picture(outline()), CAMERA, joints(0.5))
    exact = observer.observe_exact_features(0.5, CAMERA, joints(0.5), contour=outline())
    assert seen.valid and exact.valid, seen.reason
    assert seen.moments.m00 == pytest.approx(exact.moments.m00, rel=0.01)
    assert seen.moments.xg == pytest.approx(exact.moments.xg, abs=1e-3)
    assert seen.moments.order == exact.moments.order == 6
    assert seen.cameras == {"camera": seen} and not seen.has_other_target
    pixel = 1.0 / CAMERA.K[0]
    deviation = compute_rms_deviation(seen.corner_spread)
    assert 0.001 * pixel < deviation < 0.05 * pixel
    accuracy = np.hypot(CORNER_ACCURACY * pixel, deviation)
    assert (seen.corner_accuracy, seen.corner_repeatability) == (accuracy, 0.0)
    assert (exact.corner_accuracy, exact.corner_repeatability) == (0.0, 0.0)
    assert seen.is_numbered is False and exact.is_numbered is exact.corner_spread is None
    assert (exact.pixel_count, exact.touched_borders, exact.is_plane_measured) == (0, (), False)
    assert len(seen.contour) > 50 and seen.kernel.shape == (20,) and seen.pixel_count > 100
    np.testing.assert_array_equal(seen.world_T_camera, the_arm().pose(seen.joints.positions))
    assert not any(array.flags.writeable for array in (
        seen.image, seen.contour, seen.corners, seen.corner_spread, seen.kernel,
        seen.world_T_camera, seen.joints.positions, seen.joints.velocities))  # fmt: skip


@pytest.mark.parametrize("need", Need)
def test_only_what_is_asked_for_is_worked_out(need):
    depth = np.full((240, 320), 0.2, np.float32)
    seen = FeatureObserver(the_arm(), frozenset((need,))).observe_image(
        0.0, picture(outline()), CAMERA, joints(0.0), depth=depth)
    given = {
        Need.IMAGE: seen.image, Need.DEPTH: seen.depth, Need.KERNEL: seen.kernel,
        Need.CONTOUR: seen.contour, Need.CORNERS: seen.corners,
    }  # fmt: skip
    for other, value in given.items():
        expected = other is need or (other is Need.CONTOUR and need is Need.CORNERS)
        assert (value is not None) is expected, other


def test_without_segmentation_asked_for_an_empty_picture_is_valid():
    white = np.full((240, 320), 250, np.uint8)
    for image, needs, valid in (
        (white, {Need.IMAGE}, True), (white, {Need.IMAGE, Need.MOMENTS}, False),
        (np.dstack([white, white // 2, white // 3]), {Need.IMAGE}, True),
    ):
        seen = FeatureObserver(None, frozenset(needs)).observe_image(0.0, image, CAMERA)
        assert (seen.valid, seen.reason) == (valid, "" if valid else "no target in view")
        np.testing.assert_array_equal(seen.image, image)


def test_pictures_that_cannot_be_measured_say_why():
    aside = picture(outline() - [outline()[:, 0].min() + 1.6, 0.0])  # the picture begins at -1.55
    by_colour = SegmentationSettings(method="nearest_colour", near_colour=(200, 30, 40))
    for image, segmentation, borders, words in (
        (aside, None, ("left",), "left"), (picture(outline())[:200], None, (), "320 x 200"),
        (picture(outline()), by_colour, (), "segmentation 'nearest_colour' needs a colour image, "
         "but the image is grey; use a colour camera or method 'otsu'"),
    ):  # fmt: skip
        given = {} if segmentation is None else {"segmentation": segmentation}
        seen = FeatureObserver(None, **given).observe_image(0.0, image, CAMERA)
        assert not seen.valid and seen.moments is None
        assert words in seen.reason and seen.touched_borders == borders


def test_a_tracker_that_uses_colour_gets_rgb():
    class Red(Tracker):
        has_colour = True

        def find(self, image):
            v, u = np.nonzero((image == (255, 0, 0)).all(axis=2))
            return np.array([[u.mean(), v.mean()]])

    image = np.full((CAMERA.height, CAMERA.width, 3), 76, np.uint8)  # the grey level of this red
    image[40:43, 60:63] = 255, 0, 0
    observer = FeatureObserver(None, frozenset((Need.CORNERS,)), tracker=Red())
    for encoding, pixels in (("rgb8", image), ("bgr8", image[..., ::-1].copy())):
        seen = observer.observe_image(0.0, Image(pixels, encoding), CAMERA)
        found = np.column_stack(CAMERA.project(*seen.corners.T)[:2])
        np.testing.assert_allclose(found, [(61.0, 41.0)], atol=1e-6)


def test_time_and_motion_since_the_last_one(begin=31.5):
    observer, q = FeatureObserver(the_arm()), np.array(STARTS["2016"])
    moved = q + [0.01, 0.02, -0.01, 0.0, 0.01, 0.1]

    def see(after, q):
        return observer.observe_exact_features(
            begin + after, CAMERA, joints(begin, q), contour=outline(q))

    first, second = see(0.0, q), see(0.04, moved)
    assert first.dt == 0.0 and first.previous_T_camera is None
    assert second.dt == pytest.approx(0.04)
    np.testing.assert_allclose(
        first.world_T_camera @ second.previous_T_camera, second.world_T_camera, atol=1e-12)
    assert not second.previous_T_camera.flags.writeable
    assert see(0.02, q).dt == 0.0
    third, twice = see(0.08, moved), see(0.08, q)
    assert third.dt == pytest.approx(0.04)  # since the newest, not since the late one
    np.testing.assert_allclose(third.previous_T_camera, np.eye(4), atol=1e-12)
    assert twice.dt == 0.0 and twice.previous_T_camera is None
    np.testing.assert_allclose(see(0.1, moved).previous_T_camera, np.eye(4), atol=1e-12)
    observer.reset()
    assert see(0.0, q).dt == 0.0


def test_of_messages():
    exact = Moments.from_polygon(outline(), 6)
    observer = FeatureObserver(the_arm(), frozenset((Need.MOMENTS, Need.KERNEL)))
    seen = observer.observe_moments(
        0.1, exact, True, "", CAMERA, joints(0.1), kernel=np.arange(20.0), pixel_count=7,
        touched_borders=("top",), commands=[joints(0.05)])  # fmt: skip
    assert seen.valid and seen.moments is exact and len(seen.commands) == 1
    assert (seen.pixel_count, seen.touched_borders) == (7, ("top",))
    np.testing.assert_array_equal(seen.kernel, np.arange(20.0))
    for moments, valid, reason in ((None, True, "the camera node sent no moments"),
                                   (exact, False, "cut by the border")):  # fmt: skip
        bad = observer.observe_moments(0.2, moments, valid, reason * (not valid), CAMERA)
        assert (bad.valid, bad.reason) == (False, reason)


@pytest.mark.parametrize("change", [
    {"xg": 1e308}, {"xg": -31.0}, {"yg": -31.0}, {"m00": 3601.0}, {"centred": 1e300},
    {"m00": 0.0, "centred": 0.0}, {"xg": np.nan},
])  # fmt: skip
def test_moments_that_no_camera_can_see(change):
    m = Moments.from_polygon(outline(), 4)
    values = {"m00": m.m00, "xg": m.xg, "yg": m.yg, "centred": 1.0, **change}
    bad = Moments(4, m.kind, values["m00"], values["xg"], values["yg"],
                  m.centred * values["centred"])  # fmt: skip
    seen = FeatureObserver(None).observe_moments(0.0, bad, True, "", CAMERA)
    assert not seen.valid and "implausible" in seen.reason and seen.moments is None
    wide = 28.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for good in (m, Moments.from_polygon(wide, 4)):  # 88 degrees off the axis, nearly
        assert explain_implausible(good) == ""


def test_exact_points_alone_and_nothing_in_view():
    observer = FeatureObserver(None, frozenset((Need.CORNERS,)))
    seen = observer.observe_exact_features(0.0, CAMERA, points=[[0.1, 0.2], [0.3, 0.4], [0.0, 0.5]])
    assert seen.valid and seen.moments is None and seen.corners.shape == (3, 2)
    finite = "a coordinate of the target's outline or corners is not finite"
    for given, reason in (
        ({}, ""), ({"points": [[np.nan, 0.0]]}, finite),
        ({"contour": [[0, 0], [0.1, 0.1], [0.1, 0], [0, 0.1]]}, "cross"),
        ({"contour": outline(), "points": [[0.1, np.nan], [0.2, 0.3]]}, finite),
        ({"contour": outline(), "points": [[0.1, 0.2], [np.inf, 0.3]]}, finite),
    ):
        seen = observer.observe_exact_features(0.1, CAMERA, **given)
        assert not seen.valid and reason in seen.reason


@pytest.mark.parametrize("kind", [list, np.float32, np.array])
def test_a_given_pose_is_copied_whatever_its_type(kind):
    pose = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]]
    found = FeatureObserver(None, frozenset()).observe_exact_features(
        0.0, CAMERA, world_T_camera=kind(pose), points=[[0.1, 0.2], [0.3, 0.4]]).world_T_camera
    assert found.dtype == float and not found.flags.writeable and found.tolist() == pose


def test_a_lens_is_undone():
    fisheye = CameraModel(320, 240, CAMERA.K, (), "equidistant")
    u, v = fisheye.project(*outline().T)
    bent = np.stack([(u - CAMERA.K[2]) / CAMERA.K[0], (v - CAMERA.K[5]) / CAMERA.K[4]], axis=1)
    seen = FeatureObserver(None).observe_image(0.0, picture(bent), fisheye)
    assert seen.moments.xg == pytest.approx(Moments.from_polygon(outline(), 2).xg, abs=5e-3)


def test_a_pose_that_is_known_better_comes_before_that_of_the_joints():
    pose = matrix_from_xyz_rpy((0.1, -0.2, 0.7), (3.0, 0.1, 0.2))
    by_joints = the_arm().pose(STARTS["2016"])
    planes = {"compute_plane": lambda world_T_camera: Plane(*world_T_camera[0, 1:4].tolist())}
    for told, known in (({"world_T_camera": pose}, pose), ({}, by_joints)):
        seen = FeatureObserver(the_arm(), frozenset(), **planes).observe_exact_features(
            0.5, CAMERA, joints(0.5), contour=outline(), **told)
        np.testing.assert_array_equal(seen.world_T_camera, known)
        assert seen.plane == Plane(*known[0, 1:4].tolist()) and not seen.is_plane_measured
    seen = FeatureObserver(None).observe_exact_features(0.5, CAMERA, joints(0.5), contour=outline())
    assert seen.plane is None
    told = FeatureObserver(the_arm(), frozenset(), **planes).observe_exact_features(
        0.5, CAMERA, joints(0.5), contour=outline(), plane=Plane(0.1, 0.2, 3.0))
    assert told.plane == Plane(0.1, 0.2, 3.0) and told.is_plane_measured


def test_no_motion_is_told_to_and_from_joints_that_are_guessed():
    """A pose that is known better is not theirs."""
    observer, q = FeatureObserver(the_arm()), np.array(STARTS["2016"])
    told, better = [], {"world_T_camera": the_arm().pose(q)}
    for k, (guessed, known) in enumerate((
        (False, {}), (True, {}), (False, {}), (False, {}), (True, better), (True, better),
    )):  # fmt: skip
        sample = JointSample.from_values(
            0.04 * k, the_arm().names, q + 0.01 * k, is_uncertain=guessed)
        seen = observer.observe_exact_features(0.04 * k, CAMERA, sample, contour=outline(), **known)
        assert seen.world_T_camera is not None
        told.append(seen.previous_T_camera is not None)
    assert told == [False, False, False, True, True, True]
    # Joints whose speed is not known rest, and each needs a number.
    sample = JointSample.from_values(0.5, ("a", "b"), [0.1, -0.2])
    assert sample.velocities.tolist() == [0.0, 0.0] and not sample.positions.flags.writeable
    for positions, velocities in (([0.1, 0.2], [0.3]), ([0.1], [0.2, 0.3])):
        with pytest.raises(MeasurementError, match="2 joint names, but positions of shape"):
            JointSample.from_values(0.5, ("a", "b"), positions, velocities)


@pytest.mark.parametrize("told", [None, Plane(0.3, 0.1, 2.0)])
def test_points_are_a_tracker_s_as_it_answers_them(told):
    heard, found = [], Plane(0.1, 0.2, 4.0)

    class Fixed(Tracker):
        def find(self, grey):
            raise AssertionError(grey)

        def track(self, *given, **more):
            heard.append((given, more))
            return TrackedPoints(
                np.array([[0.1, 0.2], [0.3, -0.4]]), found, 0.01, 0.002, "DICT_5X5_100:7",
                np.eye(4))

        def reset(self):
            heard.append("reset")

    observer = FeatureObserver(the_arm(), frozenset((Need.CORNERS,)), tracker=Fixed())
    white, depth = np.full((240, 320), 250, np.uint8), np.full((240, 320), 0.3, np.float32)
    seen = observer.observe_image(0.5, white, CAMERA, joints(0.5), depth=depth, plane=told)
    reset, ((grey, camera, pose, given), _) = heard
    assert seen.valid and reset == "reset"
    assert grey.shape == (240, 320) and camera is CAMERA and given is depth
    np.testing.assert_array_equal(pose, the_arm().pose(joints(0.5).positions))
    assert seen.corners.tolist() == [[0.1, 0.2], [0.3, -0.4]] and not seen.corners.flags.writeable
    assert (seen.corner_accuracy, seen.corner_repeatability) == (0.01, 0.002)
    assert seen.is_numbered is True and seen.marker == "DICT_5X5_100:7"
    np.testing.assert_array_equal(seen.corner_spread, np.eye(4))
    assert seen.plane == (told or found) and seen.depth is None
