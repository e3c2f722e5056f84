"""The ROS face of one simulated camera: gazebo_ros_camera's topics, service and settings."""

from __future__ import annotations

import threading
from typing import Any

import rospy
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo, SetCameraInfoResponse

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.ros.camera import camera_frames
from aras_sim_bridge.ros.camera.camera_info import prefixed, save_calibration, to_camera_info
from aras_sim_bridge.ros.camera.camera_labels import LabelTopic
from aras_sim_bridge.ros.camera.compressed import CompressedTopic
from aras_sim_bridge.ros.camera.image_topic import ImageTopic
from aras_sim_bridge.ros.camera.quick_publisher import QuickPublisher
from aras_sim_bridge.ros.control.reconfigure import Field, ReconfigureServer
from aras_sim_bridge.ros.conversions import to_time
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.ros.services import ServiceTable


class _Watcher(rospy.SubscribeListener):
    """Tells the camera when its subscribers come and go."""

    def __init__(self, changed: Any) -> None:
        super().__init__()
        self._changed = changed

    def peer_subscribe(self, *_args: object) -> None:
        self._changed()

    def peer_unsubscribe(self, *_args: object) -> None:
        self._changed()


class CameraTopics:
    """The ROS face of one mounted camera; it renders only while somebody listens."""

    def __init__(self, mounted: Any, thread: SimulationThread) -> None:
        """Advertise the topics of `mounted` (mounting.MountedCamera) and take its frames."""
        self._mounted = mounted
        self._thread = thread
        config = mounted.sensor.config
        self.namespace = config.topic_root
        self._camera_name = config.camera_name or config.name
        frame = config.optical_frame_name or config.frame_name or mounted.link
        self._frame_id = prefixed(frame, self.namespace)
        self._info_message = to_camera_info(mounted.sensor.info)
        self._info_message.header.frame_id = self._frame_id
        mounted.enabled = False
        self._lock = threading.Lock()
        self._closing: list[Any] = []
        self._publishers: list[ImageTopic | QuickPublisher] = []
        self._watcher = _Watcher(self._on_subscribers)
        self._compressed: CompressedTopic | None = None
        self._labels: LabelTopic | None = None
        self._depth = self._depth_info = self._segmentation = None
        self._announced = False
        try:
            self._advertise(config)
        except Exception:
            self.shutdown()
            raise

    def _advertise(self, config: CameraConfig) -> None:
        root = self.namespace.rstrip("/")
        self._info = self._info_topic(f"{root}/{config.info_topic}")
        self._image = self._image_topic(f"{root}/{config.image_topic}")
        self._compressed = CompressedTopic(f"{root}/{config.image_topic}", self._watcher)
        self._closing.append(self._compressed)
        if config.depth:
            self._depth = self._image_topic(f"{root}/depth/image_raw")
            self._depth_info = self._info_topic(f"{root}/depth/camera_info")
        if config.segmentation:
            self._segmentation = self._image_topic(f"{root}/segmentation/image_raw")
            self._labels = LabelTopic(f"{root}/segmentation/labels", self._watcher)
            self._closing.append(self._labels)
        services = ServiceTable(self.namespace)
        self._closing.append(services)
        services.add(
            "set_camera_info",
            SetCameraInfo,
            self._on_set_camera_info,
            lambda text: SetCameraInfoResponse(False, text),
        )
        if config.camera_name:  # as upstream: none without a name of its own
            self._closing.append(self._rate_server())
        self._announced = camera_frames.announce(self._mounted, self._frame_id, self.namespace)
        self._mounted.on_frame = self._on_frame
        self._on_subscribers()

    def shutdown(self) -> None:
        """Take the camera off the graph."""
        self._mounted.enabled = False
        self._mounted.on_frame = None
        if self._announced:
            camera_frames.withdraw(self._frame_id)
        for part in self._closing:
            part.shutdown()
        for publisher in self._publishers:
            publisher.unregister()

    def _info_topic(self, topic: str) -> QuickPublisher:
        publisher = QuickPublisher(
            topic, CameraInfo, queue_size=2, subscriber_listener=self._watcher
        )
        self._publishers.append(publisher)
        return publisher

    def _image_topic(self, topic: str) -> ImageTopic:
        publisher = ImageTopic(topic, self._watcher)
        self._publishers.append(publisher)
        return publisher

    def _rate_server(self) -> ReconfigureServer:
        """imager_rate, told truly; upstream's limits of 1 to 50 Hz, or wider."""
        rate = self._mounted.sensor.rate
        text = "Frames per second of simulated time"
        field = Field("imager_rate", "double", 2.0, min(1.0, rate), max(50.0, rate), text, level=3)

        def apply(values: dict[str, Any]) -> None:
            wanted = float(values["imager_rate"])

            def job() -> None:
                simulation, sensor = self._thread.simulation, self._mounted.sensor
                if wanted != sensor.rate:
                    sensor.set_rate(wanted, simulation.time_ns, simulation.step_ns)

            self._thread.call(job)

        return ReconfigureServer(self.namespace, [field], {"imager_rate": rate}, apply)

    def _on_subscribers(self) -> None:
        with self._lock:
            wanted = any(map(_heard, self._publishers))
            for part in (self._compressed, self._labels):
                wanted = wanted or (part is not None and part.wanted)
            sensor = self._mounted.sensor
            sensor.depth = _heard(self._depth)
            sensor.segmentation = _heard(self._segmentation)
            self._mounted.enabled = wanted

    def _on_frame(self, frame: Any) -> None:
        """Publish one frame; runs in the simulation's thread."""
        stamp = to_time(frame.stamp_ns)
        self._image.publish(stamp, self._frame_id, frame.image, frame.encoding)
        for publisher in (self._info, self._depth_info):
            if _heard(publisher):
                self._info_message.header.stamp = stamp
                publisher.publish(self._info_message)
        if self._compressed.wanted:
            self._compressed.publish(stamp, self._frame_id, frame)
        if frame.depth is not None and self._depth is not None:
            self._depth.publish(stamp, self._frame_id, frame.depth, "32FC1")
        if self._labels is not None:
            self._labels.update(self._thread.simulation)
        if frame.segmentation is not None and self._segmentation is not None:
            self._segmentation.publish(stamp, self._frame_id, frame.segmentation, "32SC1")

    def _on_set_camera_info(self, request: SetCameraInfo) -> SetCameraInfoResponse:
        # As camera_info_manager: taken over even where the file cannot be written. Calibrators
        # leave the frame empty, but an info without the frame of its image is of no use.
        info = request.camera_info
        info.header.frame_id = info.header.frame_id or self._frame_id
        self._info_message = info
        try:
            path = save_calibration(info, self._camera_name)
        except (CameraError, OSError) as error:
            return SetCameraInfoResponse(False, f"Error storing camera calibration: {error}")
        rospy.loginfo("%s: calibration written to %s", self.namespace, path)
        return SetCameraInfoResponse(True, "")


def _heard(publisher: ImageTopic | QuickPublisher | None) -> bool:
    return publisher is not None and publisher.get_num_connections() > 0
