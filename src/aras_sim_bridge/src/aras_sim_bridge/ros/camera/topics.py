"""The ROS face of one simulated camera: gazebo_ros_camera's topics, service and settings."""

from __future__ import annotations

from collections.abc import Callable

import rospy
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Empty, String

from aras_sim_bridge.camera import CameraConfig, CameraIntrinsics, SensorFrame
from aras_sim_bridge.camera.mounting import MountedCamera, together
from aras_sim_bridge.camera.points import within_reach
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.ros.camera import frames
from aras_sim_bridge.ros.camera.compressed import CompressedTopic
from aras_sim_bridge.ros.camera.image_topic import ImageTopic
from aras_sim_bridge.ros.camera.info import (
    prefixed,
    save_calibration,
    sensor_yaml,
    to_camera_info,
)
from aras_sim_bridge.ros.camera.labels import LabelTopic
from aras_sim_bridge.ros.camera.points_topic import PointsTopic
from aras_sim_bridge.ros.conversions import to_time
from aras_sim_bridge.ros.runtime.publisher import Peers, QuickPublisher
from aras_sim_bridge.ros.runtime.services import Fields, ServiceTable, serves
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_visual_servo_ros.parameters import Value
from aras_visual_servo_ros.reconfigure import Field, ReconfigureServer

Topic = QuickPublisher | CompressedTopic


class CameraTopics:
    """The ROS face of one mounted camera; it renders only while somebody listens."""

    def __init__(
        self,
        mounted: MountedCamera,
        thread: SimulationThread,
        before_frame: Callable[[], None] | None = None,
    ) -> None:
        """Advertise the topics of `mounted` and take its frames.

        before_frame: called in the simulation's thread before a frame goes out, or None.
        """
        self._mounted = mounted
        self._thread = thread
        self._before_frame = before_frame
        config = mounted.sensor.config
        self.namespace = config.topic_root
        self._camera_name = config.camera_name or config.name
        frame = config.optical_frame_name or config.frame_name or mounted.link
        self._frame_id = prefixed(frame, self.namespace)
        self._topics: list[Topic] = []
        self._closing: list[ServiceTable | ReconfigureServer] = []
        self._trigger: rospy.Subscriber | None = None
        self._figures: rospy.Publisher | None = None
        self._depth: ImageTopic | None = None
        self._points: PointsTopic | None = None
        self._depth_info: QuickPublisher | None = None
        self._segmentation: ImageTopic | None = None
        self._labels: LabelTopic | None = None
        self._announced = False
        self._on_graph = False
        try:
            self._info_message = to_camera_info(thread.call(self._intrinsics))
            self._info_message.header.frame_id = self._frame_id
            self._advertise(config)
        except Exception:
            self.shutdown()
            raise
        self._on_graph = True
        self._changed()

    def _intrinsics(self) -> CameraIntrinsics:
        return self._mounted.sensor.info

    def _advertise(self, config: CameraConfig) -> None:
        peers = Peers(self._changed)
        self._info = self._info_topic(config.topic(config.info_topic))
        self._image = self._kept(ImageTopic(config.topic(config.image_topic), self._changed))
        self._compressed = self._kept(CompressedTopic(config.topic(config.image_topic), peers))
        if config.depth:
            names = config.depth_topics
            self._depth = self._kept(ImageTopic(config.topic(names.image), self._changed))
            self._depth_info = self._info_topic(config.topic(names.info))
            if names.points:
                rays = self._thread.call(self._mounted.sensor.rays)
                self._points = self._kept(
                    PointsTopic(config.topic(names.points), rays, names, self._changed))
        if config.trigger_topic:
            self._trigger = rospy.Subscriber(
                config.topic(config.trigger_topic), Empty, self._on_trigger, queue_size=10)
        if config.segmentation:
            topic = config.topic("segmentation/image_raw")
            self._segmentation = self._kept(ImageTopic(topic, self._changed))
            topic = config.topic("segmentation/labels")
            self._labels = self._kept(LabelTopic(topic, self._changed))
        topic = config.topic("sensor_info")
        self._figures = rospy.Publisher(topic, String, latch=True, queue_size=1)
        self._figures.publish(String(sensor_yaml(config)))
        self._closing.append(ServiceTable(self.namespace, self._thread, self.set_camera_info))
        if config.camera_name:  # as upstream: none without a name of its own
            self._closing.append(self._rate_server(self._thread.call(self._rate)))
        self._announced = frames.announce(
            self._mounted,
            self._thread.call(lambda: self._mounted.parent_T_optical),
            self._frame_id,
            self.namespace,
        )

    def shutdown(self) -> None:
        """Take the camera off the graph."""
        self._on_graph = False
        self._changed()
        if self._announced:
            frames.withdraw(self._frame_id)
        for end in (self._trigger, self._figures):
            if end is not None:
                end.unregister()
        for service in self._closing:
            service.shutdown()
        for topic in self._topics:
            topic.unregister()

    def _kept(self, topic: Topic) -> Topic:
        self._topics.append(topic)
        return topic

    def _info_topic(self, topic: str) -> QuickPublisher:
        return self._kept(QuickPublisher(topic, CameraInfo, queue_size=2, changed=self._changed))

    def _rate(self) -> float:
        return self._mounted.sensor.rate

    def _rate_server(self, rate: float) -> ReconfigureServer:
        """imager_rate, told truly; upstream's limits of 1 to 50 Hz, or wider."""
        text = "Frames per second of simulated time"
        field = Field("imager_rate", "double", 2.0, min(1.0, rate), max(50.0, rate), text, level=3)

        def apply(values: dict[str, Value]) -> None:
            wanted = float(values["imager_rate"])

            def job() -> None:
                simulation = self._thread.simulation
                for camera in together(self._mounted, simulation.cameras):
                    if wanted != camera.sensor.rate:
                        camera.sensor.set_rate(wanted, simulation.time_ns, simulation.step_ns)

            self._thread.call(job)

        return ReconfigureServer(self.namespace, [field], {"imager_rate": rate}, apply)

    def _on_trigger(self, _message: Empty) -> None:
        """Have a picture taken, in the simulation's thread."""

        def job() -> None:
            simulation = self._thread.simulation
            for camera in together(self._mounted, simulation.cameras):
                camera.trigger(simulation.time_ns, simulation.step_ns)

        self._thread.post(job)

    def _changed(self) -> None:
        """Listeners may have come or gone, in any thread."""
        self._thread.post(self._switch)

    def _switch(self) -> None:
        """Have drawn what is listened to."""
        mounted = self._mounted
        mounted.on_frame = self._on_frame if self._on_graph else None
        mounted.enabled = self._on_graph and any(map(_heard, self._topics))
        wanted = _heard(self._depth) or _heard(self._points)
        mounted.sensor.depth = self._on_graph and wanted
        mounted.sensor.segmentation = self._on_graph and _heard(self._segmentation)

    def _on_frame(self, frame: SensorFrame) -> None:
        """Publish one frame."""
        if self._before_frame is not None:
            self._before_frame()
        stamp = to_time(frame.stamp_ns)
        self._image.send(stamp, self._frame_id, frame.image, frame.encoding)
        for publisher in (self._info, self._depth_info):
            if _heard(publisher):
                self._info_message.header.stamp = stamp
                publisher.publish(self._info_message)
        if _heard(self._compressed):
            self._compressed.publish(stamp, self._frame_id, frame)
        if frame.depth is not None and self._depth is not None:
            names = self._mounted.sensor.config.depth_topics
            self._depth.send(stamp, self._frame_id, within_reach(frame.depth, names),
                                "16UC1" if names.millimetres else "32FC1")
        if frame.depth is not None and self._points is not None:
            self._points.send(stamp, self._frame_id, frame)
        if self._labels is not None:
            self._labels.update(self._thread.simulation)
        if frame.segmentation is not None and self._segmentation is not None:
            self._segmentation.send(stamp, self._frame_id, frame.segmentation, "32SC1")

    @serves(SetCameraInfo, outside=True)
    def set_camera_info(self, _thread: SimulationThread, request: SetCameraInfo) -> Fields:
        """Publish this calibration from now on, and keep it."""
        # As camera_info_manager: taken over even where the file cannot be written. Calibrators
        # leave the frame empty, but an info without the frame of its image is of no use.
        info = request.camera_info
        info.header.frame_id = info.header.frame_id or self._frame_id
        self._info_message = info
        try:
            path = save_calibration(info, self._camera_name, self._mounted.sensor.config)
        except (CameraError, OSError) as error:
            text = f"Error storing camera calibration: {error}"
            return {"success": False, "status_message": text}
        rospy.loginfo("%s: calibration written to %s", self.namespace, path)
        return None


def _heard(topic: Topic | None) -> bool:
    return topic is not None and topic.listeners > 0
