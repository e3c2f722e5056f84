"""image_raw, camera_info and set_camera_info of one simulated camera."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import rospy
import yaml
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo, SetCameraInfoResponse

from aras_sim_bridge.ros.conversions import to_time
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

    def __init__(self, mounted: Any) -> None:
        """Advertise the topics of `mounted` (simulation.MountedCamera) and take its frames."""
        self._mounted = mounted
        config = mounted.sensor.config
        self.namespace = namespace_of(config.robot_namespace, config.camera_name)
        self._camera_name = config.camera_name
        self._frame_id = _prefixed(config.frame_name, self.namespace)
        self._info_message = to_camera_info(mounted.sensor.info)
        self._info_message.header.frame_id = self._frame_id
        watcher = _Watcher(self._on_subscribers)
        self._image: rospy.Publisher | None = None
        self._info: rospy.Publisher | None = None
        mounted.enabled = False
        self._info = rospy.Publisher(
            f"{self.namespace}/{config.info_topic}",
            CameraInfo,
            queue_size=2,
            subscriber_listener=watcher,
        )
        self._image = rospy.Publisher(
            f"{self.namespace}/{config.image_topic}",
            Image,
            latch=True,
            queue_size=2,
            subscriber_listener=watcher,
            tcp_nodelay=True,
        )
        self._services = ServiceTable(self.namespace)
        self._services.add(
            "set_camera_info",
            SetCameraInfo,
            self._on_set_camera_info,
            lambda text: SetCameraInfoResponse(False, text),
        )
        mounted.on_frame = self._on_frame
        self._on_subscribers()

    def shutdown(self) -> None:
        """Take the camera off the graph."""
        self._mounted.enabled = False
        self._mounted.on_frame = None
        self._services.shutdown()
        self._image.unregister()
        self._info.unregister()

    def _on_subscribers(self) -> None:
        publishers = [p for p in (self._image, self._info) if p is not None]
        self._mounted.enabled = any(p.get_num_connections() > 0 for p in publishers)

    def _on_frame(self, frame: Any) -> None:
        """Publish one frame; runs in the simulation's thread."""
        stamp = to_time(frame.stamp_ns)
        # A new message each time: a latched publisher keeps the last one.
        message = Image()
        message.header.stamp = stamp
        message.header.frame_id = self._frame_id
        message.height, message.width = frame.image.shape[:2]
        message.encoding = frame.encoding
        message.data = frame.image.tobytes()
        message.step = len(message.data) // message.height
        self._image.publish(message)
        if self._info.get_num_connections():
            self._info_message.header.stamp = stamp
            self._info.publish(self._info_message)

    def _on_set_camera_info(self, request: SetCameraInfo) -> SetCameraInfoResponse:
        self._info_message = request.camera_info
        home = Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")
        path = home / "camera_info" / f"{self._camera_name.replace('/', '_')}.yaml"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(_calibration_yaml(request.camera_info, self._camera_name))
        except OSError as error:
            return SetCameraInfoResponse(False, f"Error storing camera calibration: {error}")
        return SetCameraInfoResponse(True, "")


def namespace_of(robot_namespace: str, camera_name: str) -> str:
    """Return the absolute namespace of a camera's topics."""
    return "/" + "/".join(part for part in (robot_namespace.strip("/"), camera_name) if part)


def to_camera_info(info: Any) -> CameraInfo:
    """Return the message of a CameraIntrinsics (width, height, model, D, K, R, P); no stamp."""
    return CameraInfo(
        height=info.height,
        width=info.width,
        distortion_model=info.model,
        D=_flat(info.D),
        K=_flat(info.K),
        R=_flat(info.R),
        P=_flat(info.P),
    )


def _flat(values: Any) -> list[float]:
    rows = values.ravel() if hasattr(values, "ravel") else values
    return [float(value) for value in rows]


def _prefixed(frame_id: str, namespace: str) -> str:
    """Return frame_id under the parameter tf_prefix, which is searched upward from namespace."""
    frame_id = frame_id.lstrip("/")
    parts = namespace.strip("/").split("/")
    for count in range(len(parts), -1, -1):
        prefix = rospy.get_param("/" + "/".join([*parts[:count], "tf_prefix"]), "")
        if prefix:
            return f"{prefix.strip('/')}/{frame_id}"
    return frame_id


def _calibration_yaml(info: CameraInfo, name: str) -> str:
    """Return the text that camera_calibration_parsers reads."""

    def matrix(rows: int, values: list[float]) -> dict[str, Any]:
        data = [float(value) for value in values]
        return {"rows": rows, "cols": len(data) // rows, "data": data}

    return yaml.safe_dump(
        {
            "image_width": info.width,
            "image_height": info.height,
            "camera_name": name,
            "camera_matrix": matrix(3, info.K),
            "distortion_model": info.distortion_model,
            "distortion_coefficients": matrix(1, info.D),
            "rectification_matrix": matrix(3, info.R),
            "projection_matrix": matrix(3, info.P),
        },
        sort_keys=False,
    )
