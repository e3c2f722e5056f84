"""Input of images for schemes that process images: image, camera_info, and depth image."""

from __future__ import annotations

import threading
from functools import partial

import rospy
from sensor_msgs.msg import CameraInfo, Image

from aras_visual_servo_base.stamp_synchronizer import StampSynchronizer
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import decode
from aras_visual_servo_camera.label_subscribers import BUFFER_SIZE, LabelSubscribers

from ..observation.camera_rig import ObserveFrame
from ..observation.feature_observer import FeatureObserver, observe
from ..observation.frame import Frame
from ..observation.observation import SEGMENTED, Need
from ..parameters import CameraEntry
from ..records.state import ImageSource
from ..runner.loop_runner import LoopRunner
from .depth_image import read_depth

IMAGE_NEEDS = {Need.IMAGE, Need.CONTOUR, Need.CORNERS, Need.DEPTH}


class CameraSubscribers:
    """Subscribers of one camera's topics, which pass each image to the loop."""

    def __init__(self, topics: CameraEntry, runner: LoopRunner, observer: FeatureObserver) -> None:
        self._runner, self._observer = runner, observer
        self._camera: CameraModel | None = None
        # Newest image of each kind that was received before the first camera_info.
        self._early_images: dict[str, Image] = {}
        self._lock = threading.Lock()
        depth = Need.DEPTH in observer.needs
        kinds, self._label_subscribers = ("image",), None
        if observer.needs & SEGMENTED:
            kinds = observer.segmentation.image_kinds
            self._label_subscribers = LabelSubscribers.for_segmentation(
                observer.segmentation, topics.namespace, self._add_image
            )
        self._images = StampSynchronizer((*kinds, "depth") if depth else kinds)
        options = {"queue_size": 1, "tcp_nodelay": True}
        large, camera = {**options, "buff_size": BUFFER_SIZE}, topics.namespace
        runner.set_source(
            observer.name,
            ImageSource("image", f"{camera}/image_raw", "the simulator or camera's driver"),
        )
        self.subscribers = [
            rospy.Subscriber(f"{camera}/camera_info", CameraInfo, self._on_info, **options),
            rospy.Subscriber(
                f"{camera}/image_raw", Image, partial(self._add_image, "image"), **large
            ),
        ]
        if depth:
            self.subscribers.append(rospy.Subscriber(
                f"{camera}/depth/image_raw", Image, partial(self._add_image, "depth"), **large
            ))  # fmt: skip
        if self._label_subscribers is not None:
            self.subscribers += self._label_subscribers.subscribers

    def _on_info(self, message: CameraInfo) -> None:
        try:
            camera = CameraModel.from_message(message)
        except VisionError as error:
            camera = None
            rospy.logwarn_throttle(5.0, f"camera_info cannot be used: {error}")
        with self._lock:
            self._camera = camera
            early = {}
            if camera is not None:
                early, self._early_images = self._early_images, early
        for kind, image in early.items():
            self._add_image(kind, image)

    def _add_image(self, kind: str, message: Image) -> None:
        with self._lock:
            camera = self._camera
            if camera is None:
                # Store the image: in lockstep, the simulation waits until its first image is
                # processed, and this image can arrive before the camera_info.
                if kind in self._early_images:
                    rospy.logwarn_throttle(5.0, "images wait for their camera_info")
                self._early_images[kind] = message
                return
            together = self._images.add(kind, message.header.stamp, message)
        if together is None:
            return
        try:
            image = decode(together["image"])
            depth = read_depth(together["depth"]) if "depth" in together else None
            labelled = None
            if "labels" in together:
                labelled = self._label_subscribers.make_mask(together["labels"])
        except VisionError as error:
            rospy.logwarn_throttle(5.0, f"image skipped: {error}")
            return
        frame = Frame(
            message.header.stamp.to_nsec(), image.pixels, image.encoding, depth,
            name=self._observer.name, target_mask=labelled, camera=camera,
        )  # fmt: skip
        observe_frame: ObserveFrame = lambda joints, commands: observe(  # noqa: E731
            frame, joints, self._observer, commands=commands
        )
        self._runner.add_image(frame.stamp, observe_frame, frame.name)
