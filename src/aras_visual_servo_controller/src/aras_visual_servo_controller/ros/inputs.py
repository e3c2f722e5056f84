"""What the loop hears: joint states always, and of the images what its scheme needs."""

from __future__ import annotations

import threading

import rospy
from aras_visual_servo_camera.msg import ImageMoments, KernelFeatures
from sensor_msgs.msg import CameraInfo, Image, JointState

from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import decode
from aras_visual_servo_camera.undistortion import CameraModel

from ..driver import Driver, Look
from ..observation import Need
from ..pairing import ByStamp
from ..settings import Settings
from ..state import Source
from .depth import depth_of
from .messages import camera_of, moments_of

PICTURES = {Need.IMAGE, Need.CONTOUR, Need.CORNERS, Need.DEPTH}
BUFFER = 2**24  # bytes, holds several images: always the newest, never a backlog


class Inputs:
    """Subscribers of one driver."""

    def __init__(self, settings: Settings, driver: Driver) -> None:
        self._driver = driver
        self._observer, needs = driver.observer, driver.observer.needs
        self._camera: CameraModel | None = None
        self._early: dict[str, Image] = {}  # the newest of each kind that came before camera_info
        self._lock = threading.Lock()
        self._measurements = ByStamp(("moments", "kernel"))
        space = settings.namespace.rstrip("/")
        self._images = ByStamp(("image", "depth") if Need.DEPTH in needs else ("image",))
        options = {"queue_size": 1, "tcp_nodelay": True}
        pictures, camera = {**options, "buff_size": BUFFER}, settings.camera_namespace.rstrip("/")
        states = {**options, "queue_size": 10 if settings.lockstep else 1}
        self._subscribers = [
            rospy.Subscriber(f"{space}/joint_states", JointState, self._on_joints, **states)
        ]
        if needs & PICTURES:
            topics = [
                (f"{camera}/camera_info", CameraInfo, self._on_info, options),
                (f"{camera}/image_raw", Image, self._on_image, pictures),
            ]
            if Need.DEPTH in needs:
                depth = f"{camera}/depth/image_raw"
                topics.append((depth, Image, self._on_depth, pictures))
        else:
            topics = [(f"{space}/camera/moments", ImageMoments, self._on_moments, options)]
            if Need.KERNEL in needs:
                topics.append((f"{space}/camera/kernel", KernelFeatures, self._on_kernel, options))
        self._kernel = Need.KERNEL in needs
        pictured = bool(needs & PICTURES)
        driver.source = Source(
            "image" if pictured else "features", topics[-1][0],
            "the simulator or the camera's driver" if pictured else "the camera node",
        )  # fmt: skip
        for topic, kind, callback, how in topics:
            self._subscribers.append(rospy.Subscriber(topic, kind, callback, **how))

    def close(self) -> None:
        """Hear nothing any more."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _on_joints(self, message: JointState) -> None:
        stamp = message.header.stamp.to_sec()
        self._driver.joints(message.name, message.position, message.velocity, stamp)

    def _on_moments(self, message: ImageMoments) -> None:
        if not self._kernel or not message.valid:
            self._measured(message, None)
        else:
            self._paired("moments", message)

    def _on_kernel(self, message: KernelFeatures) -> None:
        self._paired("kernel", message)

    def _paired(self, kind: str, message: ImageMoments | KernelFeatures) -> None:
        with self._lock:
            both = self._measurements.add(kind, message.header.stamp, message)
        if both is not None:
            self._measured(both["moments"], both["kernel"])

    def _measured(self, message: ImageMoments, kernel: KernelFeatures | None) -> None:
        stamp = message.header.stamp.to_sec()
        camera, fault = camera_of(message)
        moments, reason = moments_of(message)
        if kernel is not None:
            reason = reason or kernel.reason
        valid, reason = bool(message.valid and not fault), fault or reason

        def look(joints, commands):
            return self._observer.of_moments(
                stamp, moments, valid and not reason, reason, camera, joints, commands,
                kernel=None if kernel is None else kernel.data,
                pixel_count=int(message.pixel_count),
                touches=("border",) if message.touches_border else (),
            )  # fmt: skip

        self._driver.image(stamp, look)

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
        stamp = message.header.stamp.to_sec()
        try:
            image = decode(together["image"])
            depth = depth_of(together["depth"]) if "depth" in together else None
        except VisionError as error:
            rospy.logwarn_throttle(5.0, f"image skipped: {error}")
            return
        look: Look = lambda joints, commands: self._observer.of_image(  # noqa: E731
            stamp, image, camera, joints, commands, depth
        )
        self._driver.image(stamp, look)
