"""Camera node on a real graph: topics, stamps, image layouts, and every invalid input."""

from __future__ import annotations

import os
import subprocess
import time

import numpy as np
import pytest
import rospy
from aras_visual_servo_camera.msg import ImageMoments, KernelFeatures
from ros_graph import PATIENCE, RosMaster, wait_for
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Float64MultiArray

from aras_visual_servo_camera.moment_feature_values import PAPER_FEATURES, Reference
from aras_visual_servo_camera.moment_feature_values import compute_moment_features as compute
from aras_visual_servo_camera.moments import Moments

NODE = ["rosrun", "aras_visual_servo_camera", "aras_visual_servo_camera_node"]
K = [200.0, 0, 159.5, 0, 200.0, 119.5, 0, 0, 1]
OUTPUT = "/aras_visual_servo/camera/"


class Rig:
    """Publishes images one at a time and waits for the moments with the same stamp."""

    def __init__(self, collect) -> None:
        self.images = rospy.Publisher("/labrob/camera/image_raw", Image, queue_size=5)
        self.infos = rospy.Publisher("/labrob/camera/camera_info", CameraInfo, queue_size=5)
        self.moments = collect(OUTPUT + "moments", ImageMoments)
        self.data = collect(OUTPUT + "data", Float64MultiArray)
        self.thresholded = collect(OUTPUT + "thresholded_image", Image)
        self.overlay = collect(OUTPUT + "overlay", Image)
        self.count = 0
        wait_for(
            lambda: self.images.get_num_connections() and self.infos.get_num_connections(),
            20.0,
            "the camera node's subscriptions",
        )
        wait_for(
            lambda: all(
                c.connected()
                for c in (self.moments, self.data, self.thresholded, self.overlay)
            ),
            20.0,
            "the camera node's publishers",
        )

    def info(self, **changes) -> None:
        good = {"width": 320, "height": 240, "distortion_model": "plumb_bob", "D": [0.0] * 5}
        good["K"] = K
        self.infos.publish(CameraInfo(**{**good, **changes}))
        time.sleep(0.3)  # the two topics have no order between them

    def send(self, grey: np.ndarray, **changes) -> rospy.Time:
        self.count += 1
        rgb = np.repeat(grey[..., None], 3, axis=2)
        message = Image(
            height=grey.shape[0],
            width=grey.shape[1],
            encoding="rgb8",
            step=3 * grey.shape[1],
            data=rgb.tobytes(),
        )
        message.header.frame_id = "camera_link"
        message.header.stamp = rospy.Time(7, self.count * 33_000_000)
        for name, value in changes.items():
            setattr(message, name, value)
        self.images.publish(message)
        return message.header.stamp

    def frame(self, grey: np.ndarray, **changes) -> ImageMoments:
        stamp = self.send(grey, **changes)
        return self.moments.wait(where=lambda m: m.header.stamp == stamp)


def picture(row=80, column=100, height=50, width=90) -> np.ndarray:
    grey = np.full((240, 320), 255, np.uint8)
    grey[row : row + height, column : column + width] = 0
    return grey


@pytest.fixture
def start(ros_master):
    """Factory: starts the node with private parameters; ends it as Ctrl-C does."""
    running: list[tuple[subprocess.Popen, object]] = []

    def run(**parameters) -> subprocess.Popen:
        log = (ros_master.directory / f"camera-{time.monotonic_ns()}.txt").open("w+")
        arguments = [f"_{name}:={value}" for name, value in parameters.items()]
        process = subprocess.Popen(
            NODE + arguments,
            env=ros_master.environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        process.output = lambda: (log.flush(), open(log.name).read())[1]  # noqa: SIM115
        running.append((process, log))
        return process

    yield run
    for process, log in running:
        if process.poll() is None:
            os.killpg(process.pid, 2)
            process.wait(20.0 * PATIENCE)
        log.close()
    for name in ("aras_visual_servo_camera",):
        if ros_master.api.hasParam("/" + name):
            ros_master.api.deleteParam("/" + name)


def test_moments_and_pictures_of_one_frame(ros_node, collect, start) -> None:
    node = start()
    rig = Rig(collect)
    early = rig.frame(picture())
    assert not early.valid and "/labrob/camera/camera_info" in early.reason
    rig.info()
    message = rig.frame(picture())
    assert message.valid and message.reason == "" and not message.touches_border
    assert message.header.frame_id == "camera_link" and message.pixel_count == 4500
    assert (message.order, len(message.m), len(message.mu)) == (6, 28, 28)
    assert list(message.K) == K and (message.width, message.height) == (320, 240)
    moments = Moments.from_arrays(message.m, message.mu, message.order)
    assert moments.m00 == pytest.approx(4500 / 200**2)
    assert moments.xg == pytest.approx((144.5 - 159.5) / 200)
    features = compute(moments, PAPER_FEATURES, reference=Reference(moments.m00, 0.3))
    assert features["an"] == pytest.approx(0.3)

    numbers = rig.data.wait().data
    expected = [(104.5 - 119.5) / 200, (144.5 - 159.5) / 200, 4500, 0.0]
    assert numbers == pytest.approx(expected, abs=1e-12)
    stamp = message.header.stamp
    binary = rig.thresholded.wait(where=lambda m: m.header.stamp == stamp)
    assert (binary.encoding, binary.height, binary.width) == ("mono8", 240, 320)
    mask = np.frombuffer(binary.data, np.uint8).reshape(240, 320)
    np.testing.assert_array_equal(mask, 255 - picture())
    overlay = rig.overlay.wait(where=lambda m: m.header.stamp == stamp)
    assert (overlay.encoding, overlay.step) == ("rgb8", 960)
    assert node.poll() is None


def test_every_bad_frame_is_survived_and_explained(ros_node, collect, start) -> None:
    node = start()
    rig = Rig(collect)
    rig.info()
    assert rig.frame(picture()).valid
    sent = len(rig.data.messages)
    assert "touches the top border" in rig.frame(picture(row=0)).reason
    # no message at all for what is no image, and the next good frame is measured
    before = len(rig.moments.messages)
    rig.send(picture(), encoding="32FC1")
    # Alone: of frames that come faster than it looks, the node takes the newest.
    wait_for(lambda: "encoding '32FC1' is not supported" in node.output(), 5.0, "its complaint")
    rig.send(picture(), data=b"\0" * 100)
    rig.send(picture(), step=5)
    assert rig.frame(picture()).valid
    assert len(rig.moments.messages) == before + 1
    smaller = np.ascontiguousarray(picture()[:200, :300])
    assert "300 x 200 but camera_info says 320 x 240" in rig.frame(smaller).reason
    rig.info(K=[0.0] * 9)
    assert "focal lengths fx=0" in rig.frame(picture()).reason
    rig.info(width=300, height=200)
    assert rig.frame(smaller).valid
    rig.info()
    assert rig.frame(picture()).valid
    for message in rig.data.messages[sent:]:
        assert np.isfinite(message.data).all() and message.data[2] > 0
    assert "Traceback" not in node.output()


def test_kernel_features_carry_their_images_stamp_or_a_reason(ros_node, collect, start) -> None:
    start()  # whatever the layout of camera/data
    rig = Rig(collect)
    found = collect("/aras_visual_servo/camera/kernel", KernelFeatures)
    wait_for(found.connected, 10.0, "kernel features")
    rig.info()
    rig.frame(picture())
    message = found.wait()
    assert len(message.data) == 20 and message.data[15] == -1.0 and not message.reason
    assert message.header.stamp == rig.moments.messages[-1].header.stamp
    rig.frame(picture(width=0))
    wait_for(lambda: found.messages[-1].reason, 5.0, "the reason")
    assert not found.messages[-1].data


def test_wrong_parameters_end_it_with_one_line(ros_node, ros_master, start) -> None:
    """All of them: tests/unit/features/test_parameters.py."""
    node = start(mask_image="/nowhere.png")
    assert node.wait(20.0 * PATIENCE) == 1
    assert "cannot read an image from '/nowhere.png'" in node.output()
    assert "Traceback" not in node.output()
    # Its address may be another node's by now: the master would end that for a second of its name.
    assert not ros_master.knows("/aras_visual_servo_camera")


def test_master_gone_ends_the_node(tmp_path):
    master = RosMaster(tmp_path)
    node = None
    try:
        node = subprocess.Popen(
            NODE,
            env=master.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        wait_for(lambda: "/aras_visual_servo_camera" in master.nodes(), 20.0, "the node")
        time.sleep(2.5)  # it has asked the living master at least once
        master.process.terminate()
        master.process.wait()
        output, _ = node.communicate(timeout=20.0 * PATIENCE)
    finally:
        if node is not None and node.poll() is None:
            node.kill()
        master.stop()
    assert node.returncode == 0
    assert "the ROS master does not answer any more: ending" in output
    assert "Traceback" not in output
