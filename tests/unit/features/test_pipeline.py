"""From image to measurement: accuracy, noise, and every invalid image."""

from math import pi

import numpy as np
import pytest
from feature_cases import TARGET, View, grey_image, rotation

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.detection_pipeline import (
    DetectionPipeline,
    DetectionSettings,
    TargetDetection,
)
from aras_visual_servo_camera.errors import DegenerateFeatureError, InvalidIntrinsicsError
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.moment_feature_values import compute_moment_features as compute
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.segmentation_settings import SegmentationSettings

CAMERA = CameraModel(320, 240, (188.04, 0, 159.5, 0, 188.04, 119.5, 0, 0, 1), (0.0,) * 5)


def view(seed: int, tilt: float = 0.1) -> View:
    random = np.random.default_rng(seed)
    R = rotation([*random.uniform(-tilt, tilt, 2), 0]) @ rotation([0, 0, random.uniform(-pi, pi)])
    return View(TARGET, R, np.array([*random.uniform(-0.03, 0.03, 2), random.uniform(0.18, 0.3)]))


def measure(
    grey: np.ndarray, pipeline: DetectionPipeline | None = None, **settings
) -> TargetDetection:
    if pipeline is None:
        pipeline = DetectionPipeline(DetectionSettings(**settings))
        pipeline.set_camera(CAMERA)
    return pipeline.measure(Image(grey, "mono8"))


def centroid_error(view: View, grey: np.ndarray, **settings) -> float:
    """Distance of the measured from the true centre of gravity, pixels."""
    measured, exact = measure(grey, **settings).moments, Moments.from_polygon(view.image)
    return 188.04 * float(np.hypot(measured.xg - exact.xg, measured.yg - exact.yg))


def test_grey_moments_see_below_a_pixel() -> None:
    """RMS errors of the centroid, px, and of the orientation of a nearly square target, rad."""
    rms = {}
    for weighting in ("coverage", "binary"):
        errors = []
        for seed in range(8):
            at = view(seed)
            exact = compute(Moments.from_polygon(at.image), ("alpha",), at.plane)["alpha"]
            grey = grey_image(at.image, CAMERA.pinhole)
            alpha = compute(measure(grey, weighting=weighting).moments, ("alpha",), at.plane)
            turned = (alpha["alpha"] - exact + pi / 2) % pi - pi / 2
            errors.append((centroid_error(at, grey, weighting=weighting), turned))
        rms[weighting] = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms["binary"] >= (3, 10) * rms["coverage"]).all(), rms
    assert (rms["coverage"] < (0.005, np.deg2rad(0.02))).all(), rms


@pytest.mark.parametrize("levels", [(0, 255), (20, 230)], ids=["saturated", "inside the range"])
def test_noise_of_the_sensor(levels) -> None:
    """Sigma 5 grey levels: centroid still within hundredths of a pixel, area within 0.3 %."""
    random = np.random.default_rng(0)
    for seed in range(5):
        at = view(seed)
        clean = grey_image(at.image, CAMERA.pinhole, fg=levels[0], bg=levels[1])
        noisy = np.clip(np.round(clean + random.normal(0, 5, clean.shape)), 0, 255).astype(np.uint8)
        measured = measure(noisy)
        assert measured.valid, measured.reason
        exact = Moments.from_polygon(at.image)
        assert measured.moments.m00 == pytest.approx(exact.m00, rel=3e-3)
        assert centroid_error(at, noisy) < 0.03


def white() -> np.ndarray:
    return np.full((240, 320), 255, np.uint8)


def with_box(row: int, column: int, height: int, width: int, level: int = 0) -> np.ndarray:
    grey = white()
    grey[row : row + height, column : column + width] = level
    return grey


DIAGONAL = white()
DIAGONAL[np.arange(50, 110), np.arange(50, 110)] = 0


@pytest.mark.parametrize(("grey", "text"), [
    (white(), "no target in view"), (DIAGONAL, "line"),
    (with_box(0, 290, 40, 30), "right and top border")], ids=["white", "diagonal", "corner"])
def test_bad_targets_are_not_valid_and_say_why(grey, text: str) -> None:
    """Of one at the border the moments are kept, to be shown."""
    measured = measure(grey, weighting="binary")
    assert not measured.valid and text in measured.reason
    assert measured.moments is not None or "border" not in text


@pytest.mark.parametrize(("component", "words"), [
    ("largest", "of 2 objects of target colour, the largest is the target: 2400 pixels around "
                "column 20, row 130"),
    ("nearest", "of 2 objects of target colour, the one nearest to the target's last position is "
                "the target"),
    ("all", "all pixels of target colour together are the target"),
    ("only", "(the only object of target colour is the target: 2400 pixels around")])
def test_of_several_objects_is_said_which_is_the_target_and_why(component, words) -> None:
    grey = with_box(100, 0, 60, 40)
    if component == "only":
        component = "largest"
    else:
        grey[30:50, 200:220] = 0
    measured = measure(grey, segmentation=SegmentationSettings(component=component))
    assert not measured.valid
    assert measured.reason.startswith("the target touches the left border of the image (")
    assert words in measured.reason


def test_camera_info_is_needed_but_by_the_original_s_kernel_features() -> None:
    pipeline = DetectionPipeline(DetectionSettings())
    measured = pipeline.measure(Image(with_box(100, 100, 30, 40), "mono8"))
    assert not measured.valid and "no camera_info" in measured.reason
    faint = Image(with_box(100, 100, 30, 40, 249), "mono8")  # of the original's threshold
    with pytest.raises(InvalidIntrinsicsError, match="no camera_info"):
        pipeline.compute_original_data(faint)
    pipeline.set_camera(CAMERA)
    assert pipeline.measure(Image(with_box(100, 100, 30, 40), "mono8")).valid
    numbers = pipeline.compute_original_data(faint)
    assert numbers == pytest.approx([(114.5 - 119.5) / 188.04, (119.5 - 159.5) / 188.04, 1200, 0])
    kernel = DetectionPipeline(DetectionSettings(layout="kernel"))
    assert len(kernel.compute_original_data(faint)) == 20
    with pytest.raises(DegenerateFeatureError):
        pipeline.compute_original_data(Image(white(), "mono8"))
    pipeline.drop_camera("focal length is zero")
    measured = pipeline.measure(Image(with_box(100, 100, 30, 40), "mono8"))
    assert not measured.valid and measured.reason == "focal length is zero"


def test_a_size_that_changes_and_a_lost_target():
    pipeline = DetectionPipeline(DetectionSettings())
    pipeline.set_camera(CAMERA)
    assert measure(with_box(100, 100, 30, 40), pipeline).valid
    smaller = with_box(100, 100, 30, 40)[:200, :300]
    measured = measure(np.ascontiguousarray(smaller), pipeline)
    assert not measured.valid and "300 x 200 but camera_info says 320 x 240" in measured.reason
    pipeline.set_camera(CameraModel(300, 200, CAMERA.K))
    assert measure(np.ascontiguousarray(smaller), pipeline).valid
    pipeline.set_camera(CAMERA)
    assert measure(with_box(100, 100, 30, 40), pipeline).valid
    pipeline = DetectionPipeline(DetectionSettings(SegmentationSettings(component="nearest")))
    pipeline.set_camera(CAMERA)
    grey = with_box(100, 20, 10, 10)
    measure(grey, pipeline)
    grey[60:120, 200:260] = 0
    assert measure(grey, pipeline).target.box == (20, 100, 10, 10)
    assert not measure(white(), pipeline).valid
    assert measure(grey, pipeline).target.box == (200, 60, 60, 60)  # the largest again


@pytest.mark.parametrize(
    ("near", "far"), [((-10, 0), (12, 0)), ((11, 0), (-11, 0)), ((0, -10), (0, 12)),
                      ((0, 11), (0, -11))],
    ids=["left", "right", "above", "below"],
)
def test_nearest_is_measured_from_the_middle_of_the_target(near, far) -> None:
    pipeline = DetectionPipeline(DetectionSettings(SegmentationSettings(component="nearest")))
    pipeline.set_camera(CAMERA)
    measure(with_box(100, 100, 30, 40), pipeline)  # its middle: column 119.5, row 114.5
    grey = white()
    for column, row in (near, far):  # 7 x 7, half a pixel nearer than the other
        grey[114 + row - 3 : 114 + row + 4, 119 + column - 3 : 119 + column + 4] = 0
    assert measure(grey, pipeline).target.box == (119 + near[0] - 3, 114 + near[1] - 3, 7, 7)


@pytest.mark.parametrize(("height", "width"), [(60, 20), (20, 60)], ids=["upright", "lying"])
@pytest.mark.parametrize("weighting", ["coverage", "binary"])
@pytest.mark.parametrize("lens", [(0.0,) * 5, (1e-9, 0, 0, 0, 0)], ids=["pinhole", "lens"])
def test_moments_of_a_rectangle_of_whole_pixels(height, width, weighting, lens) -> None:
    camera = CameraModel(320, 240, (200.0, 0, 159.5, 0, 160.0, 119.5, 0, 0, 1), lens)
    pipeline = DetectionPipeline(DetectionSettings(weighting=weighting))
    pipeline.set_camera(camera)
    moments = measure(with_box(70, 130, height, width), pipeline).moments
    a, b = width / 200.0, height / 160.0
    assert moments.m00 == pytest.approx(a * b, rel=1e-6)
    assert moments.xg == pytest.approx((130 + (width - 1) / 2 - 159.5) / 200.0, abs=1e-7)
    assert moments.yg == pytest.approx((70 + (height - 1) / 2 - 119.5) / 160.0, abs=1e-7)
    # edges that fall between pixels are sampled worst: up to two of 20^2 parts too little
    assert moments.mu(2, 0) == pytest.approx(a**3 * b / 12, rel=6e-3)
    assert moments.mu(0, 2) == pytest.approx(a * b**3 / 12, rel=6e-3)
    assert moments.mu(1, 0) == moments.mu(0, 1) == 0.0


def test_original_mask_is_the_same_on_a_table_that_is_not_quite_white() -> None:
    pipeline = DetectionPipeline(DetectionSettings())
    grey = grey_image(view(5).image, CAMERA.pinhole)
    white = pipeline.make_original_mask(Image(grey, "mono8"))
    assert 0 < (white > 0).mean() < 0.5
    for level in (233, 200):
        dim = np.rint(grey * (level / 255.0)).astype(np.uint8)
        assert (pipeline.make_original_mask(Image(dim, "mono8")) == white).mean() > 0.9999


FISHEYE = CameraModel(320, 240, (106.0, 0, 159.5, 0, 106.0, 119.5, 0, 0, 1), (0.0,) * 4,
                      "equidistant")  # fmt: skip


def test_beyond_the_image_circle_of_a_wide_lens_nothing_is_the_target():
    pipeline = DetectionPipeline(DetectionSettings())
    pipeline.set_camera(FISHEYE)
    grey = with_box(110, 150, 20, 20)
    grey[:40, 285:] = 90  # 100 degrees off the axis, and larger
    measurement = measure(grey, pipeline)
    assert measurement.valid, measurement.reason
    assert measurement.target.box[:2] == (150, 110)
    measurement = measure(with_box(30, 250, 40, 50), pipeline)
    assert not measurement.valid and "range of the lens model" in measurement.reason
