"""replay.launch: robot, target, clock, images and overlay are restored from a bag alone."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import rosbag
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from geometry_msgs.msg import PoseStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

GAZEBO = Path(__file__).parents[2] / "src" / "aras_visual_servo_gazebo"
SHIPPED = (GAZEBO / "robots" / "aras_visual_servo.urdf").read_text()
URDF = SHIPPED.replace('<robot name="aras_visual_servo"', '<robot name="another"')
TARGET = (GAZEBO / "targets" / "aras.urdf").read_text()
START, SECONDS = 100.0, 120.0  # long enough for a slow machine to have started all nodes


def picture() -> np.ndarray:
    """A dark box on a light ground, in colours that tell red from blue; bgr."""
    image = np.full((240, 320, 3), (255, 250, 200), np.uint8)
    image[100:140, 120:180] = (10, 20, 60)
    return image


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Bag of a run without joints, as record.launch writes it; its target was moved once."""
    path = tmp_path_factory.mktemp("bag") / "run.bag"
    K = [200.0, 0, 159.5, 0, 200.0, 119.5, 0, 0, 1]
    image = CompressedImage(format="rgb8; png compressed bgr8",
                            data=cv2.imencode(".png", picture())[1].tobytes())
    image.header.frame_id = "eye"
    info = CameraInfo(width=320, height=240, distortion_model="plumb_bob", D=[0.0] * 5, K=K)
    with rosbag.Bag(str(path), "w") as made:
        told = {"parameters": {"robot_description": URDF, "target_description": TARGET}}
        made.write("/aras_visual_servo/experiment", String(json.dumps(told)),
                   rospy.Time.from_sec(START))  # fmt: skip
        for x, time in ((0.1, START), (0.3, START + 1.0)):
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.orientation.w = x, 1.0
            # As a recorder writes it of a latched topic: its player latches it, too.
            made.write("/aras_visual_servo/target", pose, rospy.Time.from_sec(time),
                       connection_header={"latching": "1", "topic": "/aras_visual_servo/target",
                                          "type": pose._type, "md5sum": pose._md5sum,
                                          "message_definition": pose._full_text})  # fmt: skip
        for step in range(int(SECONDS * 50)):
            time = rospy.Time.from_sec(START + 0.02 * step)
            made.write("/clock", Clock(time), time)
            if step % 10 == 0:
                info.header.stamp = image.header.stamp = time
                made.write("/labrob/camera/camera_info", info, time)
                made.write("/labrob/camera/image_raw/compressed", image, time)
    return path


def contour(message: Image) -> np.ndarray:
    """Return the pixels (row, column) of the outline of a valid target in the overlay."""
    drawn = np.frombuffer(message.data, np.uint8).reshape(240, 320, 3)
    return (drawn == (0, 220, 0)).all(axis=2)


def target_at(message: MarkerArray, x: float) -> bool:
    """Return whether the target's plate, 0.05 m wide, is drawn with its faces around x."""
    faces = [m for m in message.markers if m.ns == "target face 0" and m.points]
    across = [point.x for m in faces for point in m.points]
    return bool(across) and abs(0.5 * (min(across) + max(across)) - x) < 1e-3


def test_a_bag_plays_with_its_robot_its_clock_and_its_pictures(launch, collect, bag):
    clock = collect("/clock", Clock)
    raw = collect("/labrob/camera/image_raw", Image)
    overlay = collect("/aras_visual_servo/camera/overlay", Image)
    measured = collect("/replay/moments", ImageMoments)
    recorded = collect("/aras_visual_servo/camera/moments", ImageMoments)
    drawings = collect("/aras_visual_servo/markers", MarkerArray)
    launch("aras_visual_servo_gazebo", "replay.launch", nodes=["/play", "/decompress"],
           bag=str(bag), show_rviz="false", markers="true")  # fmt: skip
    assert rospy.get_param("/robot_description") == URDF
    assert rospy.get_param("/use_sim_time") is True
    # The first pictures may come before the camera's intrinsics.
    drawn = overlay.wait(timeout=90.0, where=lambda message: contour(message).sum() > 150)
    assert contour(drawn)[100, 150] and not contour(drawn)[120, 150]  # of the box
    seen = raw.wait()
    assert (seen.encoding, seen.header.frame_id) == ("rgb8", "eye")
    np.testing.assert_array_equal(np.frombuffer(seen.data, np.uint8).reshape(240, 320, 3),
                                  picture()[..., ::-1])
    moments = measured.wait(where=lambda message: message.valid)
    assert moments.valid and moments.pixel_count == 2400
    assert recorded.messages == []  # what the bag says is not said twice
    drawings.wait(timeout=90.0, where=lambda message: target_at(message, 0.3))
    stamps = [message.clock.to_sec() for message in clock.messages]
    assert stamps[0] >= START and stamps[-1] <= START + SECONDS
    assert stamps == sorted(stamps)  # one clock, that of the bag
