"""What the camera node measured of each image: moments, and kernel features where wanted."""

from __future__ import annotations

import threading

import rospy
from aras_visual_servo_camera.msg import ImageMoments, KernelFeatures

from aras_visual_servo_base.stamp_pairing import ByStamp

from ..driving.driver import Driver
from ..parameters import CameraEntry
from ..records.state import Source
from ..seeing.frame import Frame, MeasuredTarget
from ..seeing.observation import Need
from ..seeing.observer import Observer, observe
from ..seeing.rig import Look
from .messages import camera_of, moments_of


class MeasurementInput:
    """Subscribers to the camera node's topics; gives each image to the driver."""

    def __init__(self, camera: CameraEntry, driver: Driver, observer: Observer) -> None:
        self._driver, self._observer = driver, observer
        self._lock = threading.Lock()
        self._measurements = ByStamp(("moments", "kernel"))
        self._kernel = Need.KERNEL in observer.needs
        topics = [(f"{camera.features}/moments", ImageMoments, self._on_moments)]
        if self._kernel:
            topics.append((f"{camera.features}/kernel", KernelFeatures, self._on_kernel))
        driver.comes_from(observer.name, Source("features", topics[-1][0], "the camera node"))
        self.subscribers = [
            rospy.Subscriber(topic, kind, callback, queue_size=1, tcp_nodelay=True)
            for topic, kind, callback in topics
        ]

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
        camera, fault = camera_of(message)
        moments, reason = moments_of(message)
        if kernel is not None:
            reason = reason or kernel.reason
        valid, reason = bool(message.valid and not fault), fault or reason
        target = MeasuredTarget(
            moments, valid and not reason, reason, None if kernel is None else kernel.data,
            int(message.pixel_count), ("border",) if message.touches_border else (),
        )  # fmt: skip
        frame = Frame(message.header.stamp.to_nsec(), name=self._observer.name, camera=camera,
                      target=target)  # fmt: skip
        look: Look = lambda joints, commands: observe(  # noqa: E731
            frame, joints, self._observer, commands=commands
        )
        self._driver.image(frame.stamp, look, frame.name)
