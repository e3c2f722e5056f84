"""Contents of the messages."""

import numpy as np
import pytest

pytest.importorskip("aras_visual_servo_camera.msg")

from std_msgs.msg import Header  # noqa: E402

from aras_visual_servo_camera import messages
from aras_visual_servo_camera.camera_model import CameraModel  # noqa: E402
from aras_visual_servo_camera.detection_pipeline import (  # noqa: E402
    DetectionPipeline,
    DetectionSettings,
    TargetDetection,
)
from aras_visual_servo_camera.errors import VisionError  # noqa: E402
from aras_visual_servo_camera.images import Image  # noqa: E402
from aras_visual_servo_camera.moments import Moments  # noqa: E402
from aras_visual_servo_controller.ros.goal_publishers import make_outline_message  # noqa: E402

CAMERA = CameraModel(80, 60, (70.0, 0, 39.5, 0, 71.0, 29.5, 0, 0, 1), (0.1, 0, 0, 0, 0))
HEADER = Header(seq=3, frame_id="camera")


def measured(column: int = 20, camera: CameraModel | None = CAMERA) -> TargetDetection:
    grey = np.full((60, 80), 255, np.uint8)
    grey[10:30, column : column + 10] = 0
    pipeline = DetectionPipeline(DetectionSettings(weighting="binary"))
    if camera:
        pipeline.set_camera(camera)
    return pipeline.measure(Image(grey, "mono8"))


def test_a_measurement_arrives_as_it_was_sent():
    measurement = measured()
    message = messages.make_moments_message(measurement, HEADER, "fixed")
    assert message.header is HEADER and message.segmentation == "fixed"
    assert message.valid is True and message.reason == "" and message.touches_border is False
    assert (message.pixel_count, message.threshold, message.order) == (200, 128.0, 6)
    assert (message.width, message.height) == (80, 60)
    assert message.distortion_model == "plumb_bob"
    assert tuple(message.K + message.D) == (*CAMERA.K, *CAMERA.D)
    assert len(message.K) == 9
    back = Moments.from_arrays(message.m, message.mu, message.order)
    np.testing.assert_array_equal(back.m_array, measurement.moments.m_array)
    np.testing.assert_array_equal(back.mu_array, measurement.moments.mu_array)
    message = messages.make_moments_message(measured(camera=None), HEADER, "otsu")
    assert message.valid is False and "no camera_info" in message.reason
    assert (list(message.m), list(message.mu), message.order) == ([], [], 0)
    assert (list(message.D), message.width, message.distortion_model) == ([], 0, "")
    assert not any(message.K)
    message = messages.make_moments_message(measured(column=0), HEADER, "fixed")
    assert message.touches_border is True and "left border" in message.reason


@pytest.mark.parametrize(("encoding", "channels"), [("mono8", 1), ("rgb8", 3)])
def test_pictures_are_sent_row_by_row(encoding: str, channels: int) -> None:
    shape = (4, 5) if channels == 1 else (4, 5, channels)
    wide = np.arange(2 * np.prod(shape), dtype=np.uint8).reshape(4, 10, *shape[2:])
    pixels = wide[:, ::2]  # not contiguous
    message = messages.make_image_message(pixels, encoding, HEADER)
    assert (message.height, message.width, message.step) == (4, 5, 5 * channels)
    assert message.encoding == encoding and message.header is HEADER
    assert message.data == pixels.tobytes()


def test_a_desired_outline_is_read_as_it_was_sent() -> None:
    corners = np.array([[0.1, 0.2], [-0.3, 0.4], [0.5, -0.25]])
    message = make_outline_message(corners, "camera_optical_frame")
    assert message.header.frame_id == "camera_optical_frame"
    assert [point.z for point in message.polygon.points] == [1.0, 1.0, 1.0]
    np.testing.assert_allclose(messages.read_outline_message(message), corners, atol=1e-7)
    assert messages.read_outline_message(make_outline_message(np.zeros((0, 2)), "")) == ()
    for wrong in (corners[:2], np.where(corners == 0.4, np.nan, corners)):
        with pytest.raises(VisionError, match="at least three corners with finite"):
            messages.read_outline_message(make_outline_message(wrong, ""))
