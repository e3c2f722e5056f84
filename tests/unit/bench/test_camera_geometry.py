"""Cameras of experiments: images, visibility, poses and error messages."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

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
TRUE = CameraModel(320, 240, (300.0, 0, 166.0, 0, 280.0, 115.0, 0, 0, 1))
OTHER = CameraModel(320, 240, (250.0, 0, 160.0, 0, 290.0, 110.0, 0, 0, 1))
PIXELS = np.array([(10.0, 20.0), (300.0, 30.0), (160.0, 200.0)])
ROBOT = "aras_visual_servo_gazebo"


def normalised(pixels):
    return (np.array(pixels) - [3.0, -2.0]) / [16.0, 32.0]


def covered(corners):
    """Part of each pixel that a polygon covers: Green's formula along lines 1/1000 px apart."""
    y = (np.arange(14000) + 0.5)[:, None] / 1000 - 0.5
    found = np.zeros((14000, 20))
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y0 != y1:
            x = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
            sign = np.sign(y1 - y0) * ((y - y0) * (y - y1) < 0.0)
            found += sign * np.clip(x - np.arange(20) + 0.5, 0.0, 1.0)
    return abs(found).reshape(14, 1000, 20).mean(axis=1)


@pytest.mark.parametrize("corners", [
    [(3.25, 2.5), (12.75, 2.5), (12.75, 7.25), (3.25, 7.25)],
    [(1.3, 2.2), (15.1, 4.7), (6.4, 11.9)], [(6.4, 11.9), (15.1, 4.7), (1.3, 2.2)],
    [(-7.0, 3.3), (8.2, 1.1), (26.0, 9.0), (4.0, 21.0)], [(2.1, -5.0), (4.7, -5.0), (4.9, 30.0)],
    [(-9.0, -9.0), (40.0, -9.0), (40.0, 40.0), (-9.0, 40.0)],
    [(18.6, 12.7), (19.4, 12.9), (19.0, 13.4)], [(5.0, 5.0), (5.0000001, 9.0), (8.0, 9.0)],
    [(2.0, 2.0), (12.0, 2.0), (12.0, 5.5), (6.5, 5.5), (6.5, 11.0), (2.0, 11.0)],  # a notch
    *([(x, y), (x + 2, y), (x, y + 2)] for x, y in ((-9, 3), (40, 3), (3, -9), (3, 40))),
])  # fmt: skip
def test_a_pixel_is_as_dark_as_the_outline_covers_it(corners):
    picture = cameras.draw_outline(normalised(corners), SMALL)
    assert picture.shape == (14, 20) and picture.dtype == np.uint8
    assert np.abs(picture - 255 * (1.0 - covered(corners))).max() <= 0.7
    assert (cameras.draw_outline(None, SMALL) == 255).all()


def test_a_lens_bends_the_edges_that_are_drawn():
    bent = CameraModel(320, 240, (160.0, 0, 165.0, 0, 170.0, 112.0, 0, 0, 1), BENT)
    outline = np.array([(-0.8, -0.5), (0.8, -0.5), (0.8, 0.5), (-0.8, 0.5)])
    picture = cameras.draw_outline(outline, bent)
    u, v = bent.project(np.linspace(-0.6, 0.6, 7), np.full(7, -0.5))
    columns = np.rint(u).astype(int)
    assert not picture[np.ceil(v + 1.5).astype(int), columns].any()  # just within
    assert (picture[np.floor(v - 1.5).astype(int), columns] == 255).all()
    assert np.ptp(v) > 5.0


@pytest.mark.parametrize(("given", "margin"), [((0.0,), 0.0), ((3.0,), 3.0), ((), 2.0)])
def test_the_whole_outline_is_within_the_margin(given, margin):
    box = np.array([(margin, margin), (19.0 - margin, 13.0 - margin)])
    for place in (None, (0, 0), (0, 1), (1, 0), (1, 1)):
        edges = box.copy()
        if place:
            edges[place] += 0.25 if place[0] else -0.25
        corners = [edges[0], (edges[1, 0], edges[0, 1]), edges[1]]
        assert cameras.is_in_view(normalised(corners), SMALL, *given) is (place is None)


def test_a_believed_camera_has_its_own_numbers():
    true, bent = replace(TRUE, D=BENT), CalibrationOffset(distortion=(0.1, 0.0, 0.0, 0.0))
    wrong = CalibrationOffset(focal=1.5, centre=(4.0, -3.0)).make_calibrated_camera(true)
    assert wrong == replace(true, K=(450.0, 0, 170.0, 0, 420.0, 112.0, 0, 0, 1))
    assert bent.make_calibrated_camera(true).D[0] == 0.1 and not bent.is_moved
    assert CalibrationOffset().make_calibrated_camera(true) == true
    assert CalibrationOffset(xyz=(0, 0, 0.1)).is_moved
    assert CalibrationOffset(rpy=(0, 0.1, 0)).is_moved
    assert not CameraSpec(rpy=(0, 0, 0.1)).is_in_description
    with pytest.raises(ExperimentError, match="^calibration_offset: "):
        CalibrationOffset(distortion=(0.1,) * 3).make_calibrated_camera(true)


def test_pixels_are_read_through_the_believed_lens():
    np.testing.assert_allclose(normalise_pixels(PIXELS, TRUE, OTHER, is_closed=True),
                               (PIXELS - [160.0, 110.0]) / [250.0, 290.0])  # fmt: skip
    fish = CameraModel(320, 240, (60.0, 0, 160.0, 0, 60.0, 110.0, 0, 0, 1), (0.0,) * 4,
                       "equidistant")  # fmt: skip
    found = normalise_pixels(np.array([(160.0, 110.0), (310.0, 110.0)]), TRUE, fish)
    np.testing.assert_allclose(found[0], 0.0, atol=1e-12)
    assert np.isnan(found[1]).all()  # 150 px are 2.5 rad: behind it


def test_what_a_camera_delivers_is_observed_as_it_is_believed():
    """An outline's edges are bent by another lens; points are points."""
    bent = replace(TRUE, D=BENT)
    observer = FeatureObserver(None, frozenset((Need.IMAGE, Need.DEPTH)))
    frame = Frame(2_500_000_000, outline=PIXELS, points=PIXELS[:2], jitter=3.0, camera=TRUE)
    seen = observe(frame, None, observer, bent)
    assert (seen.stamp, seen.camera, seen.corner_noise) == (2.5, bent, 0.01)
    assert len(seen.contour) == 24
    np.testing.assert_allclose(np.column_stack(bent.project(*seen.corners.T)), PIXELS[:2],
                               atol=1e-6)  # fmt: skip
    image, depth = np.arange(12, dtype=np.uint8).reshape(3, 4), np.ones((3, 4))
    frame = Frame(3_000_000_000, image, "mono8", depth, camera=TRUE)
    seen = observe(frame, None, observer, plane=Plane(0.0, 0.0, 2.0))
    assert (seen.stamp, seen.camera, seen.plane) == (3.0, TRUE, Plane(0.0, 0.0, 2.0))
    assert (seen.image == image).all() and (seen.depth == depth).all()
    target = MeasuredTarget(None, False, "covered", pixel_count=7)
    seen = observe(Frame(4_000_000_000, camera=TRUE, target=target), None, observer)
    assert (seen.valid, seen.reason, seen.pixel_count) == (False, "covered", 7)
    gone = observe(Frame(5_000_000_000, camera=TRUE), None, observer)
    assert (gone.valid, gone.reason) == (False, "the target is not in view")


def test_a_camera_is_read_with_its_rate(tmp_path):
    packages = PackagePath()
    settings = {"width": 64, "height": 48, "update_rate": 20.0,
                "camera_matrix": {"fx": 50.0, "fy": 60.0, "cx": 30.0, "cy": 20.0}}
    spec = CameraSpec(settings, rate=7.0, calibration_offset=CalibrationOffset(focal=2.0))
    eye = CameraSetup.read("a", spec, packages, ROBOT, {})
    assert (eye.name, eye.rate) == ("a", 7.0) and settings["update_rate"] == 20.0
    assert eye.true_camera.K == (50.0, 0, 30.0, 0, 60.0, 20.0, 0, 0, 1)
    assert eye.calibrated_camera.K[:6:4] == (100.0, 120.0)
    assert CameraSetup.read("a", CameraSpec(settings), packages, ROBOT, {}).rate == 20.0
    original, own = read_preset("original", packages, ROBOT), tmp_path / "own.yaml"
    own.write_text("width: 64\neffects: {gain: 2.0}\n")
    for given, wanted in (  # keys lie over a preset, or a file, key by key
        (str(own), {"width": 64, "effects": {"gain": 2.0}}), ({"width": 64}, {"width": 64}),
        ({"preset": "noisy", "effects": {"gain": 0.5}},
         {**original, "effects": {"noise_stddev": 5.0, "gain": 0.5}}),
        ({"preset": str(own), "effects": {"exposure": 0.5}},
         {"width": 64, "effects": {"gain": 2.0, "exposure": 0.5}}),
    ):  # fmt: skip
        assert read_preset(given, packages, ROBOT) == wanted
    own.write_text("[1, 2]")
    for wrong, words in (({"preset": 3}, "camera.preset is 3, must be the name of a preset"),
                         ("orignal", "no preset: did you mean 'original'"),
                         (str(own), "contains no mapping"), ({"widht": 3}, "widht")):
        with pytest.raises(ExperimentError, match=words):
            cameras.make_camera_config(read_preset(wrong, packages, ROBOT))


def eye(name, rate, delay=0.0):
    settings = {"update_rate": rate, "latency": 0.5 * delay}  # its latency is a delay too
    config = cameras.make_camera_config(settings)
    return CameraSetup(name, CameraSpec(delay=0.5 * delay), settings, settings, config, TRUE, TRUE)


@pytest.mark.parametrize(("control", "other", "why"), [
    (eye("a", 32.0), eye("b", 8.0, 0.25), "those of 'b' arrive 0.25 s later, .* last 8 images"),
    (eye("a", 32.0), eye("b", 8.0, 0.2499), ""),
    (eye("a", 8.0, 0.3), eye("b", 16.0), ""),
    (eye("a", 8.0, 0.5), eye("b", 16.0), "^images of cameras 'b' and 'a' are never available "
     r"together, because those of 'a' arrive 0.5 s later, and only the last 8 images of 'b' \("
     r"0.5 s\) are stored: make the delays more similar, or reduce the rate of camera 'b'"),
    (eye("a", 16.0, 0.5), eye("b", 16.0, 0.5), ""),
    (eye("a", 8.0, 0.5), eye("b", 0.5, 1.0), "'b' delivers its first image after 3 s, but the run "
     "lasts only 3 s"),
    (eye("a", 2.0, 0.5), eye("b", 0.5, 0.99), ""),
])  # fmt: skip
def test_pictures_of_one_instant_have_to_meet(control, other, why):
    check_simultaneous_images([control], 3.0)
    with pytest.raises(ExperimentError, match=why) if why else contextlib.nullcontext():
        check_simultaneous_images([control, other], 3.0)
