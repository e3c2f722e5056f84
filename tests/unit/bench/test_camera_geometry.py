"""Cameras of experiments: images, visibility, poses and error messages."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment import cameras
from aras_visual_servo_bench.experiment.camera_specs import CalibrationOffset, CameraSpec
from aras_visual_servo_bench.experiment.cameras import (
    CameraSetup,
    check_simultaneous_images,
    read_preset,
)
from aras_visual_servo_bench.experiment.packages import PackagePath
from aras_visual_servo_camera.camera_model import CameraModel, normalise_pixels
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver, observe
from aras_visual_servo_controller.observation.frame import Frame, MeasuredTarget
from aras_visual_servo_controller.observation.observation import Need

K = (16.0, 0.0, 3.0, 0.0, 32.0, -2.0, 0.0, 0.0, 1.0)
SMALL = CameraModel(20, 14, K)
BENT = (-0.2, 0.05, 0.001, -0.002, 0.0)
ROBOT = "aras_visual_servo_gazebo"


def normalised(pixels):
    return (np.array(pixels) - [3.0, -2.0]) / [16.0, 32.0]


def cut(corners, axis, at, keep):
    """The part of a convex polygon on one side of a line along an axis."""
    found = []
    for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        p_in, q_in = keep * (p[axis] - at) >= 0, keep * (q[axis] - at) >= 0
        if p_in:
            found.append(p)
        if p_in != q_in:
            found.append(p + (at - p[axis]) / (q[axis] - p[axis]) * (q - p))
    return np.array(found).reshape(-1, 2)


def covered(corners):
    """Part of each pixel that a convex polygon covers, by cutting it to the pixel."""
    found = np.zeros((14, 20))
    for row in range(14):
        for column in range(20):
            part = np.array(corners, float)
            for axis, at, keep in ((0, column - 0.5, 1), (0, column + 0.5, -1), (1, row - 0.5, 1),
                                   (1, row + 0.5, -1)):
                part = cut(part, axis, at, keep) if len(part) else part
            if len(part) >= 3:
                x, y = part.T
                found[row, column] = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    return found


@pytest.mark.parametrize("corners", [
    [(3.25, 2.5), (12.75, 2.5), (12.75, 7.25), (3.25, 7.25)],
    [(1.3, 2.2), (15.1, 4.7), (6.4, 11.9)], [(6.4, 11.9), (15.1, 4.7), (1.3, 2.2)],
    [(-7.0, 3.3), (8.2, 1.1), (26.0, 9.0), (4.0, 21.0)], [(2.1, -5.0), (4.7, -5.0), (4.9, 30.0)],
    [(-9.0, -9.0), (40.0, -9.0), (40.0, 40.0), (-9.0, 40.0)],
    [(0.0, 0.0), (0.6, 0.1), (0.3, 0.4)], [(18.6, 12.7), (19.4, 12.9), (19.0, 13.4)],
    [(5.0, 5.0), (5.0000001, 9.0), (8.0, 9.0)],
])  # fmt: skip
def test_a_pixel_is_as_dark_as_the_outline_covers_it(corners):
    picture = cameras.draw_outline(normalised(corners), SMALL)
    assert picture.shape == (14, 20) and picture.dtype == np.uint8
    wanted = 255 * (1.0 - covered(corners))
    assert np.abs(picture - wanted).max() <= 0.5 + 1e-6


def test_an_outline_with_a_notch_is_drawn_with_it():
    bend = [(2.0, 2.0), (12.0, 2.0), (12.0, 5.5), (6.5, 5.5), (6.5, 11.0), (2.0, 11.0)]
    parts = ([(2.0, 2.0), (12.0, 2.0), (12.0, 5.5), (2.0, 5.5)],
             [(2.0, 5.5), (6.5, 5.5), (6.5, 11.0), (2.0, 11.0)])
    wanted = 255 * (1.0 - sum(map(covered, parts)))
    assert np.abs(cameras.draw_outline(normalised(bend), SMALL) - wanted).max() <= 0.5 + 1e-6


@pytest.mark.parametrize("corners", [
    None, *([(x, y), (x + 2, y), (x, y + 2)] for x, y in ((-9, 3), (40, 3), (3, -9), (3, 40)))])
def test_what_is_beside_the_picture_is_not_drawn(corners):
    outline = None if corners is None else normalised(corners)
    assert (cameras.draw_outline(outline, SMALL) == 255).all()


def test_a_lens_bends_the_edges_that_are_drawn():
    bent = CameraModel(320, 240, (160.0, 0, 165.0, 0, 170.0, 112.0, 0, 0, 1), BENT)
    outline = np.array([(-0.8, -0.5), (0.8, -0.5), (0.8, 0.5), (-0.8, 0.5)])
    picture = cameras.draw_outline(outline, bent)
    edge = np.column_stack([np.linspace(-0.8, 0.8, 9), np.full(9, -0.5)])
    u, v = bent.project(*edge[1:-1].T)
    for column, row in zip(np.rint(u).astype(int), v, strict=True):
        assert picture[int(np.ceil(row + 1.5)), column] == 0  # just within
        assert picture[int(np.floor(row - 1.5)), column] == 255
    assert np.ptp(v) > 5.0


@pytest.mark.parametrize("margin", [0.0, 2.0, None])
def test_the_whole_outline_is_within_the_margin(margin):
    kept = 2.0 if margin is None else margin
    given = () if margin is None else (margin,)
    low, high = np.array([kept, kept]), np.array([19.0 - kept, 13.0 - kept])
    for axis in (0, 1):
        for over, inside in ((-0.25, False), (0.0, True)):
            for a, b in ((low, high), (high, low)):
                corners = np.array([(a[0], a[1]), (b[0], a[1]), (b[0], b[1])], float)
                sign = 1.0 if a is low else -1.0
                corners[:, axis] += np.where(corners[:, axis] == a[axis], sign * over, 0.0)
                assert cameras.is_in_view(normalised(corners), SMALL, *given) is inside


# -- what is believed ----------------------------------------------------------------------------


def test_a_believed_camera_has_its_own_numbers():
    true = CameraModel(320, 240, (300.0, 0, 166.0, 0, 280.0, 115.0, 0, 0, 1), BENT)
    wrong = CalibrationOffset(focal=1.5, centre=(4.0, -3.0)).make_calibrated_camera(true)
    assert wrong == replace(true, K=(450.0, 0, 170.0, 0, 420.0, 112.0, 0, 0, 1))
    assert (
        CalibrationOffset(distortion=(0.1, 0.0, 0.0, 0.0)).make_calibrated_camera(true).D[0] == 0.1
    )
    assert (
        CalibrationOffset().make_calibrated_camera(true) == true
        and not CalibrationOffset().is_moved
    )
    assert (
        CalibrationOffset(xyz=(0, 0, 0.1)).is_moved and CalibrationOffset(rpy=(0, 0.1, 0)).is_moved
    )
    with pytest.raises(ExperimentError, match="^calibration_offset: "):
        CalibrationOffset(distortion=(0.1,) * 3).make_calibrated_camera(true)


def test_pixels_are_read_through_the_believed_lens():
    true = CameraModel(320, 240, (300.0, 0, 166.0, 0, 280.0, 115.0, 0, 0, 1))
    other = CameraModel(320, 240, (250.0, 0, 160.0, 0, 290.0, 110.0, 0, 0, 1))
    pixels = np.array([(10.0, 20.0), (300.0, 30.0), (160.0, 200.0)])
    np.testing.assert_allclose(normalise_pixels(pixels, true, other, is_closed=True),
                               (pixels - [160.0, 110.0]) / [250.0, 290.0])
    fish = CameraModel(320, 240, (60.0, 0, 160.0, 0, 60.0, 110.0, 0, 0, 1), (0.0,) * 4,
                       "equidistant")  # fmt: skip
    found = normalise_pixels(np.array([(160.0, 110.0), (310.0, 110.0)]), true, fish)
    np.testing.assert_allclose(found[0], 0.0, atol=1e-12)
    assert np.isnan(found[1]).all()  # 150 px are 2.5 rad: behind it


def test_what_a_camera_delivers_is_read_as_it_is_believed():
    """An outline's edges are bent by another lens; points are points."""
    true = CameraModel(320, 240, (300.0, 0, 166.0, 0, 280.0, 115.0, 0, 0, 1))
    eye = CameraSetup(
        "left", CameraSpec(), {}, {}, cameras.make_camera_config({}), true, replace(true, D=BENT)
    )
    pixels = np.array([(10.0, 20.0), (300.0, 30.0), (160.0, 200.0)])
    observer = FeatureObserver(None, frozenset((Need.IMAGE, Need.DEPTH)))
    frame = Frame(2_500_000_000, outline=pixels, points=pixels[:2], jitter=3.0, camera=true)
    seen = observe(frame, None, observer, eye.calibrated_camera)
    assert (seen.stamp, seen.camera, seen.corner_noise) == (2.5, eye.calibrated_camera, 0.01)
    assert len(seen.contour) == 24 and len(seen.corners) == 2
    np.testing.assert_allclose(np.column_stack(eye.calibrated_camera.project(*seen.corners.T)),
                               pixels[:2], atol=1e-6)
    image, depth = np.arange(12, dtype=np.uint8).reshape(3, 4), np.ones((3, 4))
    frame = Frame(3_000_000_000, image, "mono8", depth, camera=true)
    seen = observe(frame, None, observer, plane=Plane(0.0, 0.0, 2.0))
    assert (seen.stamp, seen.camera, seen.plane) == (3.0, true, Plane(0.0, 0.0, 2.0))
    np.testing.assert_array_equal(seen.image, image)
    np.testing.assert_array_equal(seen.depth, depth)
    target = MeasuredTarget(None, False, "covered", pixel_count=7)
    seen = observe(Frame(4_000_000_000, camera=true, target=target), None, observer)
    assert (seen.valid, seen.reason, seen.pixel_count) == (False, "covered", 7)
    gone = observe(Frame(5_000_000_000, camera=true), None, observer)
    assert (gone.valid, gone.reason) == (False, "the target is not in view")


# -- where they sit ------------------------------------------------------------------------------


def test_a_camera_sits_in_the_hand_or_stands():
    """In the hand x is forward, y left and z up; its own axes are right, down and forward."""
    link = np.eye(4)
    link[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    seat = matrix_from_xyz_rpy((0.1, 0.2, 0.3), (0.1, -0.2, 0.3))
    held = CameraSpec(xyz=(0.1, 0.2, 0.3), rpy=(0.1, -0.2, 0.3))
    back = np.linalg.inv(link)
    np.testing.assert_allclose(held.compute_pose(), back @ seat @ link, atol=1e-12)
    np.testing.assert_allclose(held.compute_pose()[:3, 3], [-0.2, -0.3, 0.1], atol=1e-12)
    stands = CameraSpec(pose=(0.1, 0.2, 0.3, 0.1, -0.2, 0.3))
    np.testing.assert_allclose(stands.compute_pose(), seat, atol=1e-12)
    assert CameraSpec().is_in_description and CameraSpec(frame="f").is_in_description
    assert (
        not held.is_in_description
        and not stands.is_in_description
        and not CameraSpec(rpy=(0, 0, 0.1)).is_in_description
    )
    np.testing.assert_allclose(CameraSpec(rpy=(0, 0, 0.5)).compute_pose()[:3, :3],
                               Rotation.from_euler("y", -0.5).as_matrix(), atol=1e-12)


# -- their files ---------------------------------------------------------------------------------


def test_a_camera_is_read_with_its_rate(tmp_path):
    packages = PackagePath()
    settings = {"width": 64, "height": 48, "update_rate": 20.0,
                "camera_matrix": {"fx": 50.0, "fy": 60.0, "cx": 30.0, "cy": 20.0}}
    spec = CameraSpec(settings, rate=7.0, calibration_offset=CalibrationOffset(focal=2.0))
    eye = CameraSetup.read("a", spec, packages, ROBOT, {})
    assert (eye.name, eye.rate) == ("a", 7.0) and settings["update_rate"] == 20.0
    assert eye.true_camera == CameraModel(
        64, 48, (50.0, 0, 30.0, 0, 60.0, 20.0, 0, 0, 1), eye.true_camera.D
    )
    assert eye.calibrated_camera.K[:6:4] == (100.0, 120.0)
    assert CameraSetup.read("a", CameraSpec(settings), packages, ROBOT, {}).rate == 20.0
    del settings["update_rate"]
    assert CameraSetup.read("a", CameraSpec(settings), packages, ROBOT, {}).rate == 30.0
    own = tmp_path / "own.yaml"
    own.write_text("width: 64\neffects: {gain: 2.0}\n")
    assert read_preset(str(own), packages, ROBOT) == {"width": 64, "effects": {"gain": 2.0}}
    original = read_preset("original", packages, ROBOT)
    assert original["width"] == 320
    # Keys lie over a preset, or a file, key by key.
    # over the description alone
    assert read_preset({"width": 64}, packages, ROBOT) == {"width": 64}
    found = read_preset({"preset": "noisy", "effects": {"gain": 0.5}}, packages, ROBOT)
    assert found == {**original, "effects": {"noise_stddev": 5.0, "gain": 0.5}}
    found = read_preset({"preset": str(own), "effects": {"exposure": 0.5}}, packages, ROBOT)
    assert found == {"width": 64, "effects": {"gain": 2.0, "exposure": 0.5}}
    with pytest.raises(ExperimentError, match="camera.preset is 3, must be the name of a preset"):
        read_preset({"preset": 3}, packages, ROBOT)
    for name, words in (("orignal", "no preset: did you mean 'original'"),
                        (str(tmp_path / "list.yml"), "contains no mapping")):
        (tmp_path / "list.yml").write_text("[1, 2]")
        with pytest.raises(ExperimentError, match=words):
            read_preset(name, packages, ROBOT)
    with pytest.raises(ExperimentError, match="widht"):
        cameras.make_camera_config({"widht": 3})


def eye(name, rate, delay=0.0):
    true = CameraModel(320, 240, (300.0, 0, 166.0, 0, 280.0, 115.0, 0, 0, 1))
    # Its latency is a delay too.
    settings = {"update_rate": rate, "latency": 0.5 * delay}
    config = cameras.make_camera_config(settings)
    return CameraSetup(name, CameraSpec(delay=0.5 * delay), settings, settings, config, true, true)


@pytest.mark.parametrize(("control", "other", "why"), [
    (eye("a", 32.0), eye("b", 8.0, 0.25), ""),  # 8 of the control camera's 32 are 0.25 s
    (eye("a", 32.0), eye("b", 8.0, 0.2499), None),
    (eye("a", 8.0, 0.3), eye("b", 16.0), None),
    (eye("a", 8.0, 0.5), eye("b", 16.0), "images of cameras 'b' and 'a' are never available "
     "together, because those of 'a' arrive 0.5 s later, and only the last 8 images of 'b' "
     "(0.5 s) are stored: make the delays more similar, or reduce the rate of camera 'b'"),
    (eye("a", 16.0), eye("b", 16.0, 0.5), "images of cameras 'a' and 'b' are never available "
     "together, because those of 'b' arrive 0.5 s later"),
    (eye("a", 16.0, 0.5), eye("b", 16.0, 0.5), None),
    (eye("a", 8.0, 0.5), eye("b", 0.5, 1.0), "camera 'b' delivers its first image after 3 s, but "
     "the run lasts only 3 s"),
    (eye("a", 2.0, 0.5), eye("b", 0.5, 0.99), None),
])  # fmt: skip
def test_pictures_of_one_instant_have_to_meet(control, other, why):
    if why is None:
        check_simultaneous_images([control, other], 3.0)
        check_simultaneous_images([control], 3.0)
        return
    with pytest.raises(ExperimentError) as told:
        check_simultaneous_images([control, other], 3.0)
    assert str(told.value).startswith(why)
