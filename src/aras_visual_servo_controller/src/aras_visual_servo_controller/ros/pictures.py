"""Pictures, for schemes that look for themselves: image, camera_info, and depth where wanted."""

from __future__ import annotations

import threading

import rospy
from sensor_msgs.msg import CameraInfo, Image

from aras_visual_servo_base.stamp_pairing import ByStamp
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import decode
from aras_visual_servo_camera.label_topics import BUFFER, LabelTopics
from aras_visual_servo_camera.undistortion import CameraModel

from ..driving.driver import Driver
from ..parameters import CameraEntry
from ..records.state import Source
from ..seeing.frame import Frame
from ..seeing.observation import SEGMENTED, Need
from ..seeing.observer import Observer, observe
from ..seeing.rig import Look
from .depth import depth_of

PICTURED = {Need.IMAGE, Need.CONTOUR, Need.CORNERS, Need.DEPTH}


class PictureInput:
    """Subscribers to a camera's topics; gives each image to the driver."""

    def __init__(self, topics: CameraEntry, driver: Driver, observer: Observer) -> None:
        self._driver, self._observer = driver, observer
        self._camera: CameraModel | None = None
        self._early: dict[str, Image] = {}  # the newest of each kind that came before camera_info
        self._lock = threading.Lock()
        depth = Need.DEPTH in observer.needs
        segmentation, self._labels = observer.segmentation, None
        looked_at = bool(observer.needs & SEGMENTED)
        kinds = segmentation.kinds if looked_at else ("image",)
        self._images = ByStamp((*kinds, "depth") if depth else kinds)
        if looked_at:
            self._labels = LabelTopics.asked(segmentation, topics.namespace, self._seen)
        options = {"queue_size": 1, "tcp_nodelay": True}
        large, camera = {**options, "buff_size": BUFFER}, topics.namespace
        driver.comes_from(
            observer.name,
            Source("image", f"{camera}/image_raw", "the simulator or camera's driver"),
        )
        self.subscribers = [
            rospy.Subscriber(f"{camera}/camera_info", CameraInfo, self._on_info, **options),
            rospy.Subscriber(f"{camera}/image_raw", Image, self._on_image, **large),
        ]
        if depth:
            topic = f"{camera}/depth/image_raw"
            self.subscribers.append(rospy.Subscriber(topic, Image, self._on_depth, **large))
        if self._labels is not None:
            self.subscribers += self._labels.subscribers

    def _on_info(self, message: CameraInfo) -> None:
        try:
            camera = CameraModel.from_message(message)
        except VisionError as error:
            camera = None
            rospy.logwarn_throttle(5.0, f"camera_info is of no use: {error}")
        with self._lock:
            self._camera = camera
            early = {}
            if camera is not None:
                early, self._early = self._early, early
        for kind, image in early.items():
            self._seen(kind, image)

    def _on_image(self, message: Image) -> None:
        self._seen("image", message)

    def _on_depth(self, message: Image) -> None:
        self._seen("depth", message)

    def _seen(self, kind: str, message: Image) -> None:
        with self._lock:
            camera = self._camera
            if camera is None:
                # The first image may overtake its camera_info; in lockstep time waits for it.
                if kind in self._early:
                    rospy.logwarn_throttle(5.0, "images wait for their camera_info")
                self._early[kind] = message
                return
            together = self._images.add(kind, message.header.stamp, message)
        if together is None:
            return
        try:
            image = decode(together["image"])
            depth = depth_of(together["depth"]) if "depth" in together else None
            labelled = self._labels.mask(together["labels"]) if "labels" in together else None
        except VisionError as error:
            rospy.logwarn_throttle(5.0, f"image skipped: {error}")
            return
        frame = Frame(
            message.header.stamp.to_nsec(), image.pixels, image.encoding, depth,
            name=self._observer.name, labelled=labelled, camera=camera,
        )  # fmt: skip
        look: Look = lambda joints, commands: observe(  # noqa: E731
            frame, joints, self._observer, commands=commands
        )
        self._driver.image(frame.stamp, look, frame.name)
