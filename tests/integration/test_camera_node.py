"""Camera node on a real graph: topics, stamps, invalid input and its end."""

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

NODE = ["rosrun", "aras_visual_servo_camera", "aras_visual_servo_camera_node"]
K = [200.0, 0, 159.5, 0, 200.0, 119.5, 0, 0, 1]
OUTPUT = {"moments": ImageMoments, "data": Float64MultiArray, "thresholded_image": Image,
          "overlay": Image, "kernel": KernelFeatures}


class Rig:
    """Publishes images one at a time and waits for the moments with the same stamp."""

    def __init__(self, collect) -> None:
        self.images = rospy.Publisher("/labrob/camera/image_raw", Image, queue_size=5)
        self.infos = rospy.Publisher("/labrob/camera/camera_info", CameraInfo, queue_size=5)
        self.heard = {name: collect(f"/aras_visual_servo/camera/{name}", kind)
                      for name, kind in OUTPUT.items()}
        self.count = 0
        wait_for(lambda: self.images.get_num_connections() and self.infos.get_num_connections()
                 and all(c.connected() for c in self.heard.values()), 20.0, "the camera node")

    def info(self, **changes) -> None:
        good = {"width": 320, "height": 240, "distortion_model": "plumb_bob", "D": [0.0] * 5}
        self.infos.publish(CameraInfo(**{**good, "K": K, **changes}))
        time.sleep(0.3)  # the two topics have no order between them

    def send(self, grey: np.ndarray, **changes) -> rospy.Time:
        self.count += 1
        rgb = np.repeat(grey[..., None], 3, axis=2)
        message = Image(height=grey.shape[0], width=grey.shape[1], encoding="rgb8",
                        step=3 * grey.shape[1], data=rgb.tobytes())
        message.header.frame_id = "camera_link"
        message.header.stamp = rospy.Time(7, self.count * 33_000_000)
        for name, value in changes.items():
            setattr(message, name, value)
        self.images.publish(message)
        return message.header.stamp

    def frame(self, grey: np.ndarray) -> ImageMoments:
        return self.of("moments", self.send(grey))

    def of(self, name: str, stamp: rospy.Time):
        """Return the message of that image on an output topic."""
        return self.heard[name].wait(where=lambda m: m.header.stamp == stamp)


def picture(row=80, height=50) -> np.ndarray:
    grey = np.full((240, 320), 255, np.uint8)
    grey[row : row + height, 100:190] = 0
    return grey


@pytest.fixture
def start(ros_master):
    """Function that starts the node with private parameters; it is ended as by Ctrl-C."""
    running: list[subprocess.Popen] = []

    def run(**parameters) -> subprocess.Popen:
        log = ros_master.directory / f"camera-{time.monotonic_ns()}.txt"
        with log.open("w") as output:
            running.append(subprocess.Popen(
                NODE + [f"_{name}:={value}" for name, value in parameters.items()],
                env=ros_master.environment, stdin=subprocess.DEVNULL, stdout=output,
                stderr=subprocess.STDOUT, start_new_session=True))
        running[-1].read_log = log.read_text
        return running[-1]

    yield run
    for process in running:
        if process.poll() is None:
            os.killpg(process.pid, 2)
            process.wait(20.0 * PATIENCE)
        assert "Traceback" not in process.read_log()
    if ros_master.api.hasParam("/aras_visual_servo_camera"):
        ros_master.api.deleteParam("/aras_visual_servo_camera")


def test_moments_and_pictures_of_one_frame_and_bad_frames(ros_node, collect, start) -> None:
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
    assert message.m[0] == pytest.approx(4500 / 200**2)
    stamp = message.header.stamp
    expected = [(104.5 - 119.5) / 200, (144.5 - 159.5) / 200, 4500, 0.0]
    assert rig.heard["data"].wait().data == pytest.approx(expected, abs=1e-12)
    binary, overlay = rig.of("thresholded_image", stamp), rig.of("overlay", stamp)
    assert (binary.encoding, overlay.encoding, overlay.step) == ("mono8", "rgb8", 960)
    mask = np.frombuffer(binary.data, np.uint8).reshape(240, 320)
    np.testing.assert_array_equal(mask, 255 - picture())
    kernel = rig.of("kernel", stamp)
    assert len(kernel.data) == 20 and kernel.data[15] == -1.0 and not kernel.reason
    # No message at all for what is no image, and the next good frame is measured.
    before = len(rig.heard["moments"].messages)
    rig.send(picture(), encoding="32FC1")
    # Alone: of frames that come faster than it looks, the node takes the newest.
    wait_for(lambda: "encoding '32FC1' is not supported" in node.read_log(), 5.0, "its complaint")
    assert rig.frame(picture()).valid
    assert len(rig.heard["moments"].messages) == before + 1
    smaller = np.ascontiguousarray(picture()[:200, :300])
    assert "300 x 200 but camera_info says 320 x 240" in rig.frame(smaller).reason
    rig.info(K=[0.0] * 9)
    assert "focal lengths fx=0" in rig.frame(picture()).reason
    rig.info()
    empty = rig.frame(picture(height=0))
    assert not empty.valid and rig.of("kernel", empty.header.stamp).reason
    assert rig.frame(picture()).valid and node.poll() is None


def test_wrong_parameters_end_it_with_one_line(ros_node, ros_master, start) -> None:
    node = start(mask_image="/nowhere.png")
    assert node.wait(20.0 * PATIENCE) == 1
    assert "cannot read an image from '/nowhere.png'" in node.read_log()
    # Its address may be another node's by now: the master would end that for a second of its name.
    assert not ros_master.knows("/aras_visual_servo_camera")


def test_master_gone_ends_the_node(tmp_path):
    master = RosMaster(tmp_path)
    node = None
    try:
        node = subprocess.Popen(NODE, env=master.environment, stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, text=True)
        wait_for(lambda: "/aras_visual_servo_camera" in master.nodes(), 20.0, "the node")
        time.sleep(2.5)  # it has asked the living master at least once
        master.process.terminate()
        master.process.wait()
        output, _ = node.communicate(timeout=20.0 * PATIENCE)
    finally:
        if node is not None and node.poll() is None:
            node.kill()
        master.stop()
    assert node.returncode == 0 and "Traceback" not in output
    assert "the ROS master does not answer any more: ending" in output
