"""Input of the camera node's measurements: moments, and kernel features if needed."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import rospy
from aras_visual_servo_camera.msg import ImageMoments, KernelFeatures

from aras_visual_servo_base.stamp_synchronizer import StampSynchronizer

from ..observation.camera_rig import ObserveFrame
from ..observation.feature_observer import FeatureObserver, observe
from ..observation.frame import Frame, MeasuredTarget
from ..observation.observation import Need
from ..parameters import CameraEntry
from ..records.state import ImageSource
from ..runner.loop_runner import LoopRunner
from .messages import read_camera, read_moments

if TYPE_CHECKING:
    from aras_visual_servo_camera.camera_node import CameraNode


class DetectionSubscribers:
    """Subscribers of the camera node's topics, which pass each measurement to the loop."""

    def __init__(
        self, camera: CameraEntry, runner: LoopRunner, observer: FeatureObserver,
        camera_node: CameraNode | None = None,
    ) -> None:
        """Subscribe; if `camera_node` measures in this process, it passes on its moments itself."""
        self._runner, self._observer = runner, observer
        self._lock = threading.Lock()
        self._measurements = StampSynchronizer(("moments", "kernel"))
        self._needs_kernel = Need.KERNEL in observer.needs
        moments = f"{camera.features}/moments"
        topics = [(moments, ImageMoments, self._on_moments)]
        if self._needs_kernel:
            on_kernel = partial(self._add_message, "kernel")
            topics.append((f"{camera.features}/kernel", KernelFeatures, on_kernel))
        source = ImageSource("features", topics[-1][0], "the camera node")
        if camera_node is not None and moments == camera_node.moments_topic:
            # The camera node runs as long as this process; features are missing without images.
            source = replace(source, sender="the simulator or camera's driver")
            camera_node.on_moments = self._on_moments
            topics = topics[1:]
        runner.set_source(observer.name, source)
        self.subscribers = [
            rospy.Subscriber(topic, kind, callback, queue_size=1, tcp_nodelay=True)
            for topic, kind, callback in topics
        ]

    def _on_moments(self, message: ImageMoments) -> None:
        if not self._needs_kernel or not message.valid:
            self._process_measurement(message, None)
        else:
            self._add_message("moments", message)

    def _add_message(self, kind: str, message: ImageMoments | KernelFeatures) -> None:
        with self._lock:
            both = self._measurements.add(kind, message.header.stamp, message)
        if both is not None:
            self._process_measurement(both["moments"], both["kernel"])

    def _process_measurement(self, message: ImageMoments, kernel: KernelFeatures | None) -> None:
        camera, fault = read_camera(message)
        moments, reason = read_moments(message)
        if kernel is not None:
            reason = reason or kernel.reason
        valid, reason = bool(message.valid and not fault), fault or reason
        target = MeasuredTarget(
            moments, valid and not reason, reason, None if kernel is None else kernel.data,
            int(message.pixel_count), ("border",) if message.touches_border else (),
        )  # fmt: skip
        frame = Frame(message.header.stamp.to_nsec(), name=self._observer.name, camera=camera,
                      target=target)  # fmt: skip
        observe_frame: ObserveFrame = lambda joints, commands: observe(  # noqa: E731
            frame, joints, self._observer, commands=commands
        )
        self._runner.add_image(frame.stamp, observe_frame, frame.name)
