"""ROS interface of one camera: topics, service and settings of gazebo_ros_camera."""

from __future__ import annotations

from collections.abc import Callable

import rospy
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Empty, String

from aras_sim_bridge.camera import CameraConfig, CameraIntrinsics, CameraReading
from aras_sim_bridge.camera.mounting import MountedCamera, find_simultaneous
from aras_sim_bridge.camera.point_cloud_builder import clip_depth
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.ros.camera import frame_broadcaster
from aras_sim_bridge.ros.camera.compressed import CompressedTopic
from aras_sim_bridge.ros.camera.image_topic import ImageTopic
from aras_sim_bridge.ros.camera.info import (
    add_prefix,
    format_sensor_yaml,
    save_calibration,
    to_camera_info,
)
from aras_sim_bridge.ros.camera.labels import LabelTopic
from aras_sim_bridge.ros.camera.points_topic import PointsTopic
from aras_sim_bridge.ros.conversions import to_time
from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher, SubscriberWatch
from aras_sim_bridge.ros.runtime.services import Fields, ServiceTable, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_visual_servo_ros.parameters import Value
from aras_visual_servo_ros.reconfigure import ReconfigurableParameter, ReconfigureServer

Topic = NonBlockingPublisher | CompressedTopic


class CameraTopics:
    """Topics, service and settings of one camera.

    The camera renders images only while one of its topics has subscribers.
    """

    def __init__(
        self,
        mounted: MountedCamera,
        thread: SimulationThread,
        before_frame: Callable[[], None] | None = None,
    ) -> None:
        """Advertise the topics of the camera `mounted`, and publish its frame on /tf_static.

        If given, the simulation thread calls `before_frame` before it publishes an image.
        """
        self._mounted = mounted
        self._thread = thread
        self._before_frame = before_frame
        config = mounted.sensor.config
        self.namespace = config.topic_root
        self._camera_name = config.camera_name or config.name
        frame = config.optical_frame_name or config.frame_name or mounted.link
        self._frame_id = add_prefix(frame, self.namespace)
        self._topics: list[Topic] = []
        self._services: list[ServiceTable | ReconfigureServer] = []
        self._trigger: rospy.Subscriber | None = None
        self._sensor_settings: rospy.Publisher | None = None
        self._depth: ImageTopic | None = None
        self._points: PointsTopic | None = None
        self._depth_info: NonBlockingPublisher | None = None
        self._segmentation: ImageTopic | None = None
        self._labels: LabelTopic | None = None
        self._publishes_frame = False
        self._is_advertised = False
        try:
            self._info_message = to_camera_info(thread.call(self._read_intrinsics))
            self._info_message.header.frame_id = self._frame_id
            self._advertise(config)
        except Exception:
            self.shutdown()
            raise
        self._is_advertised = True
        self._on_subscribers()

    def _read_intrinsics(self) -> CameraIntrinsics:
        return self._mounted.sensor.info

    def _advertise(self, config: CameraConfig) -> None:
        watch = SubscriberWatch(self._on_subscribers)
        self._info = self._make_info_topic(config.resolve_topic(config.info_topic))
        self._image = self._add_topic(
            ImageTopic(config.resolve_topic(config.image_topic), self._on_subscribers)
        )
        self._compressed = self._add_topic(
            CompressedTopic(config.resolve_topic(config.image_topic), watch)
        )
        if config.depth:
            names = config.depth_topics
            self._depth = self._add_topic(
                ImageTopic(config.resolve_topic(names.image), self._on_subscribers)
            )
            self._depth_info = self._make_info_topic(config.resolve_topic(names.info))
            if names.points:
                rays = self._thread.call(self._mounted.sensor.compute_rays)
                self._points = self._add_topic(
                    PointsTopic(
                        config.resolve_topic(names.points), rays, names, self._on_subscribers
                    )
                )
        if config.trigger_topic:
            self._trigger = rospy.Subscriber(
                config.resolve_topic(config.trigger_topic), Empty, self._on_trigger, queue_size=10)
        if config.segmentation:
            topic = config.resolve_topic("segmentation/image_raw")
            self._segmentation = self._add_topic(ImageTopic(topic, self._on_subscribers))
            topic = config.resolve_topic("segmentation/labels")
            self._labels = self._add_topic(LabelTopic(topic, self._on_subscribers))
        topic = config.resolve_topic("sensor_info")
        self._sensor_settings = rospy.Publisher(topic, String, latch=True, queue_size=1)
        self._sensor_settings.publish(String(format_sensor_yaml(config)))
        self._services.append(ServiceTable(self.namespace, self._thread, self.set_camera_info))
        # As in gazebo_ros, only a camera with a name has a dynamic_reconfigure server for its rate.
        if config.camera_name:
            self._services.append(self._make_rate_server(self._thread.call(self._read_rate)))
        self._publishes_frame = frame_broadcaster.announce(
            self._mounted,
            self._thread.call(lambda: self._mounted.parent_T_optical),
            self._frame_id,
            self.namespace,
        )

    def shutdown(self) -> None:
        """Shut down all topics and services of the camera."""
        self._is_advertised = False
        self._on_subscribers()
        if self._publishes_frame:
            frame_broadcaster.withdraw(self._frame_id)
        for topic in (self._trigger, self._sensor_settings):
            if topic is not None:
                topic.unregister()
        for service in self._services:
            service.shutdown()
        for topic in self._topics:
            topic.unregister()

    def _add_topic(self, topic: Topic) -> Topic:
        self._topics.append(topic)
        return topic

    def _make_info_topic(self, topic: str) -> NonBlockingPublisher:
        return self._add_topic(
            NonBlockingPublisher(topic, CameraInfo, queue_size=2, on_change=self._on_subscribers)
        )

    def _read_rate(self) -> float:
        return self._mounted.sensor.rate

    def _make_rate_server(self, rate: float) -> ReconfigureServer:
        """Serve the parameter imager_rate with the limits of gazebo_ros, 1 and 50 Hz.

        If the initial rate is outside of the limits, they are extended.
        """
        text = "Frames per second of simulated time"
        field = ReconfigurableParameter(
            "imager_rate", "double", 2.0, min(1.0, rate), max(50.0, rate), text, level=3
        )

        def apply_rate(values: dict[str, Value]) -> None:
            new_rate = float(values["imager_rate"])

            def job() -> None:
                simulation = self._thread.simulation
                for camera in find_simultaneous(self._mounted, simulation.cameras):
                    if new_rate != camera.sensor.rate:
                        camera.sensor.set_rate(new_rate, simulation.time_ns, simulation.step_ns)

            self._thread.call(job)

        return ReconfigureServer(self.namespace, [field], {"imager_rate": rate}, apply_rate)

    def _on_trigger(self, _message: Empty) -> None:
        """Trigger an exposure of this camera and of the cameras synchronised with it."""

        def job() -> None:
            simulation = self._thread.simulation
            for camera in find_simultaneous(self._mounted, simulation.cameras):
                camera.trigger(simulation.time_ns, simulation.step_ns)

        self._thread.post(job)

    def _on_subscribers(self) -> None:
        """Make the simulation thread call `_update_outputs`; any thread may call this."""
        self._thread.post(self._update_outputs)

    def _update_outputs(self) -> None:
        """Enable images, depth and segmentation only if their topics have subscribers."""
        mounted = self._mounted
        mounted.on_frame = self._on_frame if self._is_advertised else None
        mounted.enabled = self._is_advertised and any(map(_has_subscribers, self._topics))
        needs_depth = _has_subscribers(self._depth) or _has_subscribers(self._points)
        mounted.sensor.depth = self._is_advertised and needs_depth
        mounted.sensor.segmentation = self._is_advertised and _has_subscribers(self._segmentation)

    def _on_frame(self, frame: CameraReading) -> None:
        """Publish one frame on all topics that have subscribers."""
        if self._before_frame is not None:
            self._before_frame()
        stamp = to_time(frame.stamp_ns)
        self._image.send(stamp, self._frame_id, frame.image, frame.encoding)
        for publisher in (self._info, self._depth_info):
            if _has_subscribers(publisher):
                self._info_message.header.stamp = stamp
                publisher.publish(self._info_message)
        if _has_subscribers(self._compressed):
            self._compressed.publish(stamp, self._frame_id, frame)
        if frame.depth is not None and self._depth is not None:
            names = self._mounted.sensor.config.depth_topics
            self._depth.send(stamp, self._frame_id, clip_depth(frame.depth, names),
                                "16UC1" if names.millimetres else "32FC1")
        if frame.depth is not None and self._points is not None:
            self._points.send(stamp, self._frame_id, frame)
        if self._labels is not None:
            self._labels.update(self._thread.simulation)
        if frame.segmentation is not None and self._segmentation is not None:
            self._segmentation.send(stamp, self._frame_id, frame.segmentation, "32SC1")

    @service_handler(SetCameraInfo, in_caller_thread=True)
    def set_camera_info(self, _thread: SimulationThread, request: SetCameraInfo) -> Fields:
        """Publish the requested calibration from now on, and save it to a file."""
        # As in camera_info_manager, the calibration is used even if its file cannot be written.
        # Calibration tools leave frame_id empty; the published message gets the frame of the image.
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


def _has_subscribers(topic: Topic | None) -> bool:
    return topic is not None and topic.subscriber_count > 0
