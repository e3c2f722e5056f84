"""replay.launch: a bag alone gives robot, clock, pictures and their overlay back."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import rosbag
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import String

from aras_visual_servo_bench.ros.decompress import decompressed

URDF = "<robot name='another'><link name='base_link'/></robot>"
START, SECONDS = 100.0, 120.0  # long enough for a slow machine to have started all nodes


def picture() -> np.ndarray:
    """A dark box on a light ground, in colours that tell red from blue; bgr."""
    image = np.full((240, 320, 3), (255, 250, 200), np.uint8)
    image[100:140, 120:180] = (10, 20, 60)
    return image


def compressed(stamp: rospy.Time, kind: str = ".png") -> CompressedImage:
    data = cv2.imencode(kind, picture())[1].tobytes()
    message = CompressedImage(format=f"rgb8; {kind[1:]} compressed bgr8", data=data)
    message.header.stamp, message.header.frame_id = stamp, "eye"
    return message


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """As record.launch writes them, of a run without joints."""
    path = tmp_path_factory.mktemp("bag") / "run.bag"
    K = [200.0, 0, 159.5, 0, 200.0, 119.5, 0, 0, 1]
    info = CameraInfo(width=320, height=240, distortion_model="plumb_bob", D=[0.0] * 5, K=K)
    with rosbag.Bag(str(path), "w") as made:
        told = {"parameters": {"robot_description": URDF}}
        made.write("/aras_visual_servo/experiment", String(json.dumps(told)),
                   rospy.Time.from_sec(START))  # fmt: skip
        for step in range(int(SECONDS * 50)):
            time = rospy.Time.from_sec(START + 0.02 * step)
            made.write("/clock", Clock(time), time)
            if step % 10 == 0:
                info.header.stamp = time
                made.write("/labrob/camera/camera_info", info, time)
                made.write("/labrob/camera/image_raw/compressed", compressed(time), time)
    return path


def contour(message: Image) -> np.ndarray:
    """Where the overlay draws a valid target's outline, (rows, columns)."""
    drawn = np.frombuffer(message.data, np.uint8).reshape(240, 320, 3)
    return (drawn == (0, 220, 0)).all(axis=2)


def test_a_bag_plays_with_its_robot_its_clock_and_its_pictures(launch, collect, bag):
    clock = collect("/clock", Clock)
    raw = collect("/labrob/camera/image_raw", Image)
    overlay = collect("/aras_visual_servo/camera/overlay", Image)
    measured = collect("/replay/moments", ImageMoments)
    recorded = collect("/aras_visual_servo/camera/moments", ImageMoments)
    launch("aras_visual_servo_gazebo", "replay.launch", nodes=["/play", "/decompress"],
           bag=str(bag), show_rviz="false")  # fmt: skip
    assert rospy.get_param("/robot_description") == URDF
    assert rospy.get_param("/use_sim_time") is True
    # The first pictures may come before the camera's intrinsics.
    drawn = overlay.wait(timeout=90.0, where=lambda message: contour(message).sum() > 150)
    assert contour(drawn)[100, 150] and not contour(drawn)[120, 150]  # of the box
    seen = raw.wait()
    assert (seen.encoding, seen.header.frame_id) == ("rgb8", "eye")
    np.testing.assert_array_equal(
        np.frombuffer(seen.data, np.uint8).reshape(240, 320, 3), picture()[..., ::-1]
    )
    moments = measured.wait(where=lambda message: message.valid)
    assert moments.valid and moments.pixel_count == 2400
    assert recorded.messages == []  # what the bag says is not said twice
    stamps = [message.clock.to_sec() for message in clock.messages]
    assert stamps[0] >= START and stamps[-1] <= START + SECONDS
    assert stamps == sorted(stamps)  # one clock, that of the bag


def test_pictures_that_cannot_be_read_are_none():
    made = decompressed(compressed(rospy.Time(3), ".jpg"))
    assert made.header.stamp == rospy.Time(3) and made.step == 960
    red = np.frombuffer(made.data, np.uint8).reshape(240, 320, 3)[120, 150]
    assert red[0] > red[2]
    assert decompressed(CompressedImage(format="jpeg", data=b"none")) is None
    grey = cv2.imencode(".png", np.full((2, 3), 7, np.uint8))[1].tobytes()
    made = decompressed(CompressedImage(format="png", data=grey))
    assert (made.encoding, made.step, made.data) == ("mono8", 3, bytes([7] * 6))
