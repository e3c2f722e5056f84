"""ROS interface of one camera: topics, service and settings of gazebo_ros_camera."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

import rospy
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Empty, String

from aras_sim_bridge.camera import CameraConfig, CameraReading
from aras_sim_bridge.camera.mounting import MountedCamera, find_simultaneous
from aras_sim_bridge.camera.point_clouds import clip_depth
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.ros.camera import frame_broadcaster
from aras_sim_bridge.ros.camera.compressed import CompressedTopic
from aras_sim_bridge.ros.camera.image_topics import ImageTopic, LabelTopic, PointsTopic
from aras_sim_bridge.ros.camera.info import (
    add_prefix,
    format_sensor_yaml,
    save_calibration,
    to_camera_info,
)
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
        self._topics: dict[str, Topic] = {}
        self._cleanup = ExitStack()  # closes everything that this object has advertised
        self._is_advertised = False
        try:
            self._info_message = to_camera_info(thread.call(lambda: mounted.sensor.info))
            self._info_message.header.frame_id = self._frame_id
            self._advertise_topics(config)
            self._advertise_services(config)
            self._publish_frame()
        except Exception:
            self.shutdown()
            raise
        self._is_advertised = True
        self._on_subscribers()

    def _advertise_topics(self, config: CameraConfig) -> None:
        resolve, on_change = config.resolve_topic, self._on_subscribers
        image_topic = resolve(config.image_topic)
        self._add_info_topic("info", resolve(config.info_topic))
        self._add_topic("image", ImageTopic(image_topic, on_change))
        self._add_topic("compressed", CompressedTopic(image_topic, SubscriberWatch(on_change)))
        if config.depth:
            names = config.depth_topics
            self._add_topic("depth", ImageTopic(resolve(names.image), on_change))
            self._add_info_topic("depth_info", resolve(names.info))
            if names.points:
                rays = self._thread.call(self._mounted.sensor.compute_rays)
                points = PointsTopic(resolve(names.points), rays, names, on_change)
                self._add_topic("points", points)
        if config.segmentation:
            image_topic = resolve("segmentation/image_raw")
            self._add_topic("segmentation", ImageTopic(image_topic, on_change))
            self._add_topic("labels", LabelTopic(resolve("segmentation/labels"), on_change))

    def _add_topic(self, name: str, topic: Topic) -> None:
        self._topics[name] = topic
        self._cleanup.callback(topic.unregister)

    def _add_info_topic(self, name: str, topic: str) -> None:
        on_change = self._on_subscribers
        self._add_topic(name, NonBlockingPublisher(topic, CameraInfo, 2, on_change=on_change))

    def _advertise_services(self, config: CameraConfig) -> None:
        if config.trigger_topic:
            topic = config.resolve_topic(config.trigger_topic)
            trigger = rospy.Subscriber(topic, Empty, self._on_trigger, queue_size=10)
            self._cleanup.callback(trigger.unregister)
        topic = config.resolve_topic("sensor_info")
        sensor_settings = rospy.Publisher(topic, String, latch=True, queue_size=1)
        self._cleanup.callback(sensor_settings.unregister)
        sensor_settings.publish(String(format_sensor_yaml(config)))
        services = ServiceTable(self.namespace, self._thread, self.set_camera_info)
        self._cleanup.callback(services.shutdown)
        # As in gazebo_ros, only a camera with a name has a dynamic_reconfigure server for its rate.
        if config.camera_name:
            rate = self._thread.call(lambda: self._mounted.sensor.rate)
            self._cleanup.callback(self._make_rate_server(rate).shutdown)

    def _publish_frame(self) -> None:
        pose = self._thread.call(lambda: self._mounted.parent_T_optical)
        if frame_broadcaster.announce(self._mounted, pose, self._frame_id, self.namespace):
            self._cleanup.callback(frame_broadcaster.withdraw, self._frame_id)

    def shutdown(self) -> None:
        """Shut down all topics and services of the camera."""
        self._is_advertised = False
        self._on_subscribers()
        self._cleanup.close()

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
        mounted.enabled = self._is_advertised and self._has_subscribers(*self._topics)
        mounted.sensor.depth = self._is_advertised and self._has_subscribers("depth", "points")
        mounted.sensor.segmentation = self._is_advertised and self._has_subscribers("segmentation")

    def _has_subscribers(self, *names: str) -> bool:
        """Return whether one of the topics exists and has a subscriber."""
        topics = self._topics
        return any(name in topics and topics[name].subscriber_count > 0 for name in names)

    def _on_frame(self, frame: CameraReading) -> None:
        """Publish one frame on all topics that have subscribers."""
        if self._before_frame is not None:
            self._before_frame()
        topics, stamp, frame_id = self._topics, to_time(frame.stamp_ns), self._frame_id
        topics["image"].send(stamp, frame_id, frame.image, frame.encoding)
        for name in ("info", "depth_info"):
            if self._has_subscribers(name):
                self._info_message.header.stamp = stamp
                topics[name].publish(self._info_message)
        if self._has_subscribers("compressed"):
            topics["compressed"].publish(stamp, frame_id, frame)
        if frame.depth is not None:
            names = self._mounted.sensor.config.depth_topics
            encoding = "16UC1" if names.millimetres else "32FC1"
            topics["depth"].send(stamp, frame_id, clip_depth(frame.depth, names), encoding)
            if "points" in topics:
                topics["points"].send(stamp, frame_id, frame)
        if "labels" in topics:
            topics["labels"].update(self._thread.simulation)
        if frame.segmentation is not None:
            topics["segmentation"].send(stamp, frame_id, frame.segmentation, "32SC1")

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
