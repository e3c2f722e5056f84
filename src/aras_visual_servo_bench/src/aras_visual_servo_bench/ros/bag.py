"""A recorded run read from a bag."""

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from aras_visual_servo_camera.errors import CalibrationError
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.errors import ServoError

from ..report.recording import Images, MomentsTrack, Recording, States

NAMESPACE = "/aras_visual_servo"
CAMERA_LINK = "camera_link"
OPTICAL_FRAME = "camera_optical_frame"


def read_bag(path: str | Path) -> Recording:
    """Read a bag that record.launch wrote.

    Raises:
        ServoError: the file cannot be read or lacks what a report needs.
    """
    import rosbag

    try:
        with rosbag.Bag(str(path)) as bag:
            collector = _Collector()
            for topic, message, time in bag.read_messages(topics=collector.topics):
                collector.take(topic, message, time.to_sec())
    except (OSError, rosbag.ROSBagException) as error:
        raise ServoError(f"cannot read the bag {path}: {error}") from error
    return collector.run(str(path))


class _Collector:
    """Sorts messages into lists while the bag is read once."""

    def __init__(self) -> None:
        self.topics = [
            "/tf_static",
            "/tf",
            f"{NAMESPACE}/joint_states",
            f"{NAMESPACE}/controller/state",
            f"{NAMESPACE}/controller/diagnosis",
            f"{NAMESPACE}/camera/moments",
            "/labrob/camera/image_raw",
            "/labrob/camera/camera_info",
        ]
        self._transforms: dict[str, tuple[str, np.ndarray]] = {}
        self._camera: list[tuple[float, np.ndarray]] = []
        self._joints: list[tuple[float, dict[str, float]]] = []
        self._diagnosis: Any = None
        self._states: list[Any] = []
        self._moments: list[Any] = []
        self._images: list[tuple[float, float]] = []
        self._first: Any = None
        self._last: Any = None
        self._intrinsics = Images.camera

    def take(self, topic: str, message: Any, arrival: float) -> None:
        if topic.startswith("/tf"):
            self._take_transforms(message, topic == "/tf")
        elif topic.endswith("joint_states"):
            values = dict(zip(message.name, message.position, strict=False))
            self._joints.append((message.header.stamp.to_sec(), values))
        elif topic.endswith("controller/diagnosis"):
            self._diagnosis = message
        elif topic.endswith("controller/state"):
            if len(message.error) > 0:
                self._states.append(message)
        elif topic.endswith("moments"):
            if message.valid:
                self._moments.append(message)
        elif topic.endswith("image_raw"):
            self._images.append((message.header.stamp.to_sec(), arrival))
            # The first image that matters is the one the controller began with.
            if self._first is None or not self._states:
                self._first = message
            self._last = message
        else:
            with contextlib.suppress(CalibrationError):  # the camera node has told
                self._intrinsics = CameraModel.from_message(message)

    def _take_transforms(self, message: Any, moving: bool) -> None:
        for entry in message.transforms:
            self._transforms[entry.child_frame_id.lstrip("/")] = (
                entry.header.frame_id.lstrip("/"),
                _matrix(entry.transform),
            )
        if not moving or not message.transforms:
            return
        pose = self._optical_pose()
        if pose is not None:
            self._camera.append((message.transforms[0].header.stamp.to_sec(), pose))

    def _optical_pose(self) -> np.ndarray | None:
        """`base_T_optical` along the tree of transforms known by now."""
        has_optical = OPTICAL_FRAME in self._transforms
        frame = OPTICAL_FRAME if has_optical else CAMERA_LINK
        pose = np.eye(4)
        if frame not in self._transforms:
            return None
        if not has_optical:
            pose[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
        while frame in self._transforms:
            frame, parent_T_frame = self._transforms[frame]
            pose = parent_T_frame @ pose
        return pose

    def run(self, path: str) -> Recording:
        for what, found in (
            ("states of a servoing controller", self._states),
            ("images", self._images),
            ("joint states", self._joints),
            ("transforms of the camera", self._camera),
            ("valid image moments", self._moments),
        ):
            if not found:
                raise ServoError(f"{path} holds no {what}: nothing to report on")
        camera_stamp, camera_pose = zip(*self._camera, strict=True)
        names = tuple(self._states[0].joint_names)
        known = [(t, q) for t, q in self._joints if all(name in q for name in names)]
        if not known:
            raise ServoError(f"{path} holds no joint states of {', '.join(names)}")
        joint_stamp = [stamp for stamp, _ in known]
        joints = [[values[name] for name in names] for _, values in known]
        last = self._diagnosis
        stamp, arrival = np.array(self._images).T
        return Recording(
            states=_states(self._states),
            joint_stamp=np.array(joint_stamp),
            joints=np.array(joints),
            camera_stamp=np.array(camera_stamp),
            camera_pose=np.array(camera_pose),
            images=Images(
                stamp,
                arrival,
                _rgb(self._first),
                _rgb(self._last),
                self._intrinsics,
            ),
            moments=MomentsTrack(
                np.array([m.header.stamp.to_sec() for m in self._moments]),
                int(self._moments[0].order),
                np.array([m.m for m in self._moments]),
                np.array([m.mu for m in self._moments]),
            ),
            **({} if last is None else
               {"outcome": last.outcome, "reason": last.reason, "mend": last.mend}),
        )


def _states(messages: Iterable[Any]) -> States:
    messages = list(messages)
    return States(
        stamp=np.array([m.header.stamp.to_sec() for m in messages]),
        phase=[m.phase for m in messages],
        reason=[m.reason for m in messages],
        names=tuple(messages[0].feature_names),
        features=np.array([m.features for m in messages]),
        desired=np.array([m.desired_features for m in messages]),
        error=np.array([m.error for m in messages]),
        twist=np.array(
            [
                [getattr(part, axis) for part in (t.linear, t.angular) for axis in "xyz"]
                for t in (m.camera_twist for m in messages)
            ]
        ),
        joint_names=tuple(messages[0].joint_names),
        commands=np.array([
            _padded(m.joint_commands, len(messages[0].joint_names)) for m in messages
        ]),
        singular_values=np.array([
            _padded(m.singular_values, max(len(m.singular_values) for m in messages))
            for m in messages
        ]),
    )


def _padded(values: Iterable[float], count: int) -> list[float]:
    values = list(values)[:count]
    return values + [float("nan")] * (count - len(values))


def _matrix(transform: Any) -> np.ndarray:
    """(4, 4) of a geometry_msgs/Transform."""
    q, t = transform.rotation, transform.translation
    x, y, z, w = np.array([q.x, q.y, q.z, q.w]) / np.linalg.norm([q.x, q.y, q.z, q.w])
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = t.x, t.y, t.z
    return matrix


def _rgb(message: Any) -> np.ndarray | None:
    """(H, W, 3) uint8 of an image message with eight bits a channel; None for other kinds."""
    channels = {"rgb8": 3, "bgr8": 3, "mono8": 1}.get(message.encoding)
    if channels is None:
        return None
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    image = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    if message.encoding == "bgr8":
        image = image[..., ::-1]
    return np.repeat(image, 3, axis=2) if channels == 1 else image.copy()
