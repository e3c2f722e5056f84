"""Cameras in the graph: formats, transports, settings, frames, and what is refused."""

from __future__ import annotations

import math
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import rospy
import yaml
from dynamic_reconfigure.msg import Config, ConfigDescription, DoubleParameter, StrParameter
from dynamic_reconfigure.srv import Reconfigure
from gazebo_msgs.msg import PerformanceMetrics
from ros_graph import wait_for, wait_for_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage

CAMERA = "/labrob/camera"
TABLE = 0.59
DOWN = [0.09, 0.0, 0.75, 0.0, math.pi / 2, 0.0]  # beside the arm's camera, looking down
SMALL = {
    "parent": "world", "pose": DOWN, "width": 64, "height": 48, "horizontal_fov": 1.6, "near": 0.05,
}  # fmt: skip
FORMATS = {
    "mono8": ("mono8", 1), "L16": ("mono16", 2), "B8G8R8": ("bgr8", 3), "rgb16": ("rgb16", 6),
    "BAYER_GRBG8": ("bayer_grbg8", 1),
}  # fmt: skip
WORLD = {
    **{f"as_{name}": {**SMALL, "format": name} for name in FORMATS},
    "lab": {"deep": {**SMALL, "depth": True, "segmentation": True}},
    "named": {**SMALL, "segmentation": True},
    "late": {**SMALL, "latency": 0.1, "update_rate": 20.0},
    "lossy": {**SMALL, "effects": {"drop_probability": 0.5}},
    "fish": {**SMALL, "lens": "equidistant", "horizontal_fov": 3.5},
    "legacy": {**SMALL, "legacy_camera_info": True},
    "prefixed": {**SMALL, "tf_prefix_is_no_key": 1},
    "misspelt": {**SMALL, "horizontal_fow": 1.0},
    "wrong_type": {**SMALL, "width": "wide"},
    "impossible": {**SMALL, "horizontal_fov": 3.3},
    "folding": {**SMALL, "distortion_coefficients": [-2.0, 0.0, 0.0, 0.0, 0.0]},
    "too_fast": {**SMALL, "update_rate": 2000.0},
    "nowhere": {**SMALL, "parent": "the_moon"},
    "unplaced": {**SMALL, "pose": [0.0, 1.0]},
}
REFUSED = {
    "misspelt": ("horizontal_fow", "horizontal_fov"),
    "wrong_type": ("width", "whole number"),
    "impossible": ("horizontal_fov", "fisheye"),
    "folding": ("distortion_coefficients", "smaller"),
    "too_fast": ("update_rate", "physics rate"),
    "nowhere": ("parent", "world"),
    "unplaced": ("pose", "[x, y, z, roll, pitch, yaw]"),
    "prefixed": ("unknown key 'tf_prefix_is_no_key'", "optical_frame_name"),
}


@pytest.fixture(scope="module")
def machine(launch, ros_node, tmp_path_factory):
    """The shipped robot with its calibrated camera, moved in its link, and cameras of the world."""
    path = tmp_path_factory.mktemp("cameras") / "world.yaml"
    moved = {"xyz": [0.02, 0.0, 0.0], "optical_frame_name": "camera_mounted_optical_frame"}
    others = {"labrob": {"camera": moved}, "typo": {"camera": {"width": 10}}}
    path.write_text(yaml.safe_dump({**WORLD, **others}))
    rospy.set_param("/lab/deep/tf_prefix", "robot_1")
    launched = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_gazebo.launch", nodes=["/gazebo"],
        camera="calibrated", world_cameras=path,
    )  # fmt: skip
    wait_for(lambda: "belong to no camera" in launched.output(), 20.0, "the robot")
    return launched


@pytest.fixture(autouse=True)
def _running(machine):
    return machine


def pixels(message: Image, kind: type = np.uint8) -> np.ndarray:
    """(height, width[, channels]) of a message."""
    return np.frombuffer(message.data, kind).reshape(message.height, message.width, -1).squeeze()


def reconfigure(namespace: str, **config: list) -> Config:
    service = rospy.ServiceProxy(f"{namespace}/set_parameters", Reconfigure)
    service.wait_for_service(10.0)
    return service(Config(**config)).config


@pytest.mark.parametrize("name", FORMATS)
def test_formats(name):
    encoding, size = FORMATS[name]
    image = wait_for_message(f"/as_{name}/image_raw", Image)
    assert (image.encoding, image.step, image.is_bigendian) == (encoding, 64 * size, 0)
    assert len(image.data) == 48 * image.step
    levels = np.frombuffer(image.data, np.uint16 if size in (2, 6) else np.uint8)
    full = 65535 if size in (2, 6) else 255
    assert levels.max() == full * 233 // 255  # white that faces up
    assert levels.min() <= full // 25


def test_image_is_latched_and_drawn_only_for_subscribers(machine):
    def drawing() -> dict[str, float]:
        return {s.name: s.fps for s in wait_for_message("/gazebo/performance_metrics",
                                                        PerformanceMetrics).sensors}

    first = wait_for_message("/lossy/image_raw", Image)
    wait_for(lambda: drawing()["lossy"] == 0.0, 5.0, "the end of drawing", interval=0.1)
    wait_for_message("/lossy/camera_info", CameraInfo)
    again = wait_for_message("/lossy/image_raw", Image)
    assert again.header.stamp >= first.header.stamp


def test_stamps_stay_true_when_nobody_looked_for_a_while(collect):
    """The first new picture after a pause is none that was missed."""
    wait_for_message("/fish/image_raw", Image)
    time.sleep(0.5)
    metrics = wait_for_message("/gazebo/performance_metrics", PerformanceMetrics)
    infos = collect("/fish/camera_info", CameraInfo)  # not latched: only new frames
    assert infos.wait().header.stamp > metrics.header.stamp


def test_camera_info_tells_the_lens():
    fish = wait_for_message("/fish/camera_info", CameraInfo)
    assert (fish.distortion_model, len(fish.D)) == ("equidistant", 4)
    assert fish.K[0] == pytest.approx(64 / 3.5)
    legacy = wait_for_message("/legacy/camera_info", CameraInfo)
    assert (legacy.K[2], legacy.K[5]) == (32.5, 24.5)
    calibrated = wait_for_message(f"{CAMERA}/camera_info", CameraInfo)
    assert calibrated.K[0] == 195.0507
    assert list(calibrated.D) == [-0.33060, 0.1170, 0, 0, 0]
    # hackBaseline 0.07 of the URDF
    assert calibrated.P[3] == pytest.approx(-195.0507 * 0.07)


def test_latency_shifts_arrival_and_not_the_stamp(collect):
    late = collect("/late/image_raw", Image)
    states = collect("/gazebo/performance_metrics", PerformanceMetrics)
    late.wait(6)
    stamps = [m.header.stamp.to_nsec() for m in late.messages]
    assert {b - a for a, b in pairwise(stamps)} == {50_000_000}
    now = states.wait(len(states.messages) + 1).header.stamp.to_nsec()
    assert now - late.messages[-1].header.stamp.to_nsec() >= 90_000_000


def test_lost_frames_leave_gaps(collect):
    lossy = collect("/lossy/image_raw", Image)
    lossy.wait(20)
    indices = [round(m.header.stamp.to_sec() * 30) for m in lossy.messages][1:]
    gaps = [b - a for a, b in pairwise(indices)]
    assert min(gaps) == 1
    assert max(gaps) > 1


def test_depth_and_segmentation():
    depth = wait_for_message("/lab/deep/depth/image_raw", Image)
    assert (depth.encoding, depth.step) == ("32FC1", 256)
    metres = pixels(depth, np.float32)
    assert metres[4, 4] == pytest.approx(0.75 - TABLE, abs=1e-3)
    info = wait_for_message("/lab/deep/depth/camera_info", CameraInfo)
    assert info.header.frame_id == "robot_1/lab_deep_optical_frame"
    labelled = wait_for_message("/lab/deep/segmentation/image_raw", Image)
    assert labelled.encoding == "32SC1"
    text = wait_for_message("/lab/deep/segmentation/labels", String).data
    names = {number: name for number, name in yaml.safe_load(text).items()}
    seen = {names[n] for n in np.unique(pixels(labelled, np.int32)) if n >= 0}
    assert {"aras_visual_servo::base_link", "target::planar_object"} <= seen


def test_labels_come_without_the_picture():
    text = wait_for_message("/named/segmentation/labels", String).data
    assert "aras_visual_servo::camera_link" in yaml.safe_load(text).values()


def test_compressed_transport(collect):
    topic = f"{CAMERA}/image_raw"
    sent = collect(f"{topic}/compressed", CompressedImage)
    images = collect(topic, Image)

    def latest_pair(image_format: str) -> tuple[CompressedImage, np.ndarray]:
        """The last compressed image of a format that came, and the raw one of the same instant."""

        def pair() -> tuple[CompressedImage, Image] | None:
            raw = {image.header.stamp: image for image in list(images.messages)}
            wanted = [m for m in list(sent.messages) if image_format in m.format]
            same = [(m, raw[m.header.stamp]) for m in wanted if m.header.stamp in raw]
            return same[-1] if same else None

        message, image = wait_for(pair, 10.0, f"a raw image and its {image_format}")
        return message, pixels(image)

    def decoded(message: CompressedImage) -> np.ndarray:
        data = np.frombuffer(message.data, np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]

    jpeg, image = latest_pair("jpeg")
    assert jpeg.format == "rgb8; jpeg compressed bgr8"
    assert jpeg.data[:2] == b"\xff\xd8"
    assert np.abs(decoded(jpeg).astype(int) - image).mean() < 3.0
    reply = reconfigure(f"{topic}/compressed", strs=[StrParameter("format", "png")])
    assert [s.value for s in reply.strs] == ["png"]
    png, image = latest_pair("png")
    assert png.format == "rgb8; png compressed bgr8"
    assert np.array_equal(decoded(png), image)
    reply = reconfigure(f"{topic}/compressed", strs=[StrParameter("format", "gif")])
    assert [s.value for s in reply.strs] == ["png"]


def test_imager_rate(machine, collect):
    described = wait_for_message(f"{CAMERA}/parameter_descriptions", ConfigDescription)
    (parameter,) = described.groups[0].parameters
    assert (parameter.name, parameter.type, parameter.level) == ("imager_rate", "double", 3)
    assert (described.min.doubles[0].value, described.max.doubles[0].value) == (1.0, 50.0)
    assert rospy.get_param(f"{CAMERA}/imager_rate") == 30.0
    images = collect(f"{CAMERA}/image_raw", Image)
    images.wait()
    reconfigure(CAMERA, doubles=[DoubleParameter("imager_rate", 50.0)])
    images.clear()
    images.wait(8)
    stamps = [m.header.stamp.to_nsec() for m in images.messages][2:]
    assert {b - a for a, b in pairwise(stamps)} == {20_000_000}
    assert rospy.get_param(f"{CAMERA}/imager_rate") == 50.0
    for wrong in ({"strs": [StrParameter("imager_rate", "fast")]},
                  {"doubles": [DoubleParameter("imager_rate", math.nan)]}):
        assert reconfigure(CAMERA, **wrong).doubles[0].value == 50.0
    assert "imager_rate is 'fast', must be a double; nothing was changed" in machine.output()
    reconfigure(CAMERA, doubles=[DoubleParameter("imager_rate", 30.0)])


def test_set_camera_info_writes_its_file(ros_master):
    info = wait_for_message(f"{CAMERA}/camera_info", CameraInfo)
    changed = CameraInfo(**{name: getattr(info, name) for name in info.__slots__})
    changed.K = [100.0, 0, 160, 0, 100, 120, 0, 0, 1]
    changed.header = Header()  # as camera_calibration sends it
    service = rospy.ServiceProxy(f"{CAMERA}/set_camera_info", SetCameraInfo)
    assert service(changed).success
    taken = wait_for_message(f"{CAMERA}/camera_info", CameraInfo, where=lambda m: m.K[0] == 100.0)
    assert taken.header.frame_id == info.header.frame_id != ""
    path = Path(ros_master.environment["ROS_HOME"], "camera_info", "labrob", "camera.yaml")
    written = yaml.safe_load(path.read_text())
    assert written["camera_name"] == "labrob/camera"
    assert written["camera_matrix"]["data"] == list(changed.K)
    assert service(info).success


def test_frames_of_cameras_without_urdf_are_on_tf_static():
    transforms = wait_for_message(
        "/tf_static", TFMessage,
        where=lambda m: any(t.child_frame_id.startswith("camera_mounted") for t in m.transforms),
    ).transforms  # fmt: skip
    frames = {t.child_frame_id: t for t in transforms}
    moved = frames["camera_mounted_optical_frame"]
    assert moved.header.frame_id == "camera_link"
    assert moved.transform.translation.x == pytest.approx(0.02)
    q = moved.transform.rotation
    assert [abs(v) for v in (q.x, q.y, q.z, q.w)] == pytest.approx([0.5] * 4)
    down = frames["fish_optical_frame"].transform
    assert down.translation.z == 0.75
    q = down.rotation  # z of the optical frame points down: x-y rotation by pi
    assert 1 - 2 * (q.x**2 + q.y**2) == pytest.approx(-1.0)
    image = wait_for_message(f"{CAMERA}/image_raw", Image)
    assert image.header.frame_id == "camera_mounted_optical_frame"


@pytest.mark.parametrize("name", REFUSED)
def test_impossible_cameras_are_refused_in_one_line(machine, name):
    lines = [li for li in machine.output().splitlines() if f"cameras/{name} is left out" in li]
    assert len(lines) == 1
    for word in REFUSED[name]:
        assert word in lines[0]
    assert "Traceback" not in machine.output()
    assert not any(topic.startswith(f"/{name}/") for topic, _ in rospy.get_published_topics())


def test_settings_of_no_camera_are_told(machine):
    assert "/gazebo/cameras/typo/camera belong to no camera" in machine.output()
