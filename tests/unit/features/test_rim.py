"""Dark areas beyond the image circle of a wide lens are not detected as the target."""

import numpy as np

from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.pipeline import Pipeline, PipelineSettings
from aras_visual_servo_camera.undistortion import CameraModel

FISHEYE = CameraModel(320, 240, (106.0, 0, 159.5, 0, 106.0, 119.5, 0, 0, 1), (0.0,) * 4,
                      "equidistant")  # fmt: skip


def measure(grey: np.ndarray):
    pipeline = Pipeline(PipelineSettings())
    pipeline.set_camera(FISHEYE)
    return pipeline.measure(Image(grey, "mono8"))


def test_a_dark_corner_larger_than_the_target_is_left_out():
    grey = np.full((240, 320), 255, np.uint8)
    grey[:40, 285:] = 90  # 100 degrees off the axis
    grey[110:130, 150:170] = 0
    measurement = measure(grey)
    assert measurement.valid, measurement.reason
    assert measurement.target.box[:2] == (150, 110)


def test_a_target_that_reaches_the_rim_is_refused():
    grey = np.full((240, 320), 255, np.uint8)
    grey[30:70, 250:300] = 0
    measurement = measure(grey)
    assert not measurement.valid and "range of the lens model" in measurement.reason
