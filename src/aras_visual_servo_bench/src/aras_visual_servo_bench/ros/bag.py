"""Reading of recorded runs from bags, even if a bag was not closed or has older messages.

Topics are found by their types, so bags with any namespaces, cameras and robots can be read.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from aras_visual_servo_base.poses import Pose, normalise, optical_pose
from aras_visual_servo_camera.errors import ImageError
from aras_visual_servo_camera.images import decode

from ..errors import BenchError
from ..recording.graph_recording import GraphRecording
from ..recording.image_tracks import find_nearest
from ..recording.message_run_builder import MessageRunBuilder
from ..recording.recorded_experiment import RecordedExperiment
from ..recording.run import Run
from .bag_file import open_bag
from .recorded_clock import CLOCK_TOLERANCE_NS, STATES_TOLERANCE_NS, RecordedClock

if TYPE_CHECKING:
    import rosbag

STATE, REPORT, MOMENTS = (
    "aras_visual_servo_controller/ServoState", "aras_visual_servo_controller/ServoReport",
    "aras_visual_servo_camera/ImageMoments",
)  # fmt: skip
JOINTS, INFO, METRICS = (
    "sensor_msgs/JointState", "sensor_msgs/CameraInfo", "gazebo_msgs/PerformanceMetrics",
)
# For each message type, the fields that a report needs. Earlier versions of the messages lack some
# of these fields.
USED_FIELDS = {
    STATE: ("header", "scheme", "phase", "reason", "feature_names", "features", "desired_features",
            "error", "camera_twist", "joint_names", "joint_commands", "singular_values"),
    REPORT: ("header", "outcome", "reason", "remedy", "achieved_twist", "rank", "singular_values_l",
             "manipulability", "scale", "computation_time"),
    MOMENTS: ("header", "valid", "order", "m", "mu"),
    METRICS: ("header", "real_time_factor"),
}  # fmt: skip
# names of message fields in earlier versions of the messages, by the present name of the field
OLD_FIELDS = {
    "remedy": "mend", "desired_twist": "asked", "achieved_twist": "achieved",
    "infeasible_twist": "lost", "computation_time": "computing",
}  # fmt: skip
IMAGE, COMPRESSED = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
CLOCK = "/clock"
# last part of the name of the topic with the description of the experiment
EXPERIMENT_TOPIC = "experiment"
# prefix of the topics of the camera that is preferred if a bag contains several cameras
CAMERA_NAMESPACE = "/labrob/camera/"
OPTICAL, LINK = "camera_optical_frame", "camera_link"
TF, TF_STATIC = "/tf", "/tf_static"


def read_bag(
    path: str | Path, progress: Callable[[float], None] = lambda part: None, name: str = ""
) -> Run:
    """Read a bag that record.launch has written.

    Args:
        path: path of the bag.
        progress: function that is called with the fraction that has been read, 0 to 1.
        name: name of the run; if empty, it is derived from the path.

    Raises:
        BenchError: the file cannot be read, or lacks data that a report needs.
    """
    path = Path(path)
    with open_bag(path) as (bag, note):
        reader = BagReader(bag, path)
        reader.read(progress)
        run = MessageRunBuilder(reader).build_run(name or _find_name(path))
    if note:
        run.notes.insert(0, note)
    return run


def read_recorded_experiment(path: Path) -> RecordedExperiment:
    """Read only the description of the experiment from a bag.

    Raises:
        BenchError: the file cannot be read.
    """
    text = ""
    with open_bag(path) as (bag, _):
        topics = bag.get_type_and_topic_info().topics
        topic = find_topics({name: one.msg_type for name, one in topics.items()}).experiment
        for _, raw, _ in bag.read_messages([topic], raw=True) if topic else ():
            text = unpack(raw).data
    return RecordedExperiment.from_text(text)


def _find_name(path: Path) -> str:
    """Return the file's name without suffix, or the folder's name if the file is named run.bag."""
    stem = path.name.split(".")[0]
    return path.resolve().parent.name if stem == "run" else stem


def find_topics(kinds: Mapping[str, str]) -> SimpleNamespace:
    """Find the topics that a report needs, by message type; the name of a missing topic is ''.

    If there are several cameras, the camera of the ARAS robot is preferred.

    kinds: message type of each topic in the bag.
    """

    def find_topic(kind: str, ending: str = "", near: str = "") -> str:
        found = [t for t, k in kinds.items() if k == kind and t.endswith(ending)]
        return next((t for t in found if near and near in t), found[0] if found else "")

    info = find_topic(INFO, near=CAMERA_NAMESPACE)
    camera = info.rpartition("/")[0] + "/" if info else CAMERA_NAMESPACE
    image = find_topic(IMAGE, "image_raw", camera)
    if not image.startswith(camera):
        image = find_topic(COMPRESSED, near=camera) or image
    return SimpleNamespace(
        state=find_topic(STATE), report=find_topic(REPORT), moments=find_topic(MOMENTS),
        joints=find_topic(JOINTS, "joint_states"), info=info, metrics=find_topic(METRICS),
        image=image,
        experiment=find_topic("std_msgs/String", EXPERIMENT_TOPIC),
    )  # fmt: skip


class BagReader(GraphRecording):
    """Reader of a bag. `read` reads all messages except images, `read_images` single images."""

    def __init__(self, bag: rosbag.Bag, path: Path) -> None:
        super().__init__(path)
        self._bag = bag
        info = bag.get_type_and_topic_info().topics
        self._topics = find_topics({topic: one.msg_type for topic, one in info.items()})
        if not self._topics.state:
            topics = ", ".join(sorted(info)) or "none"
            raise BenchError(
                f"{path} contains no state of a servo controller (a topic of type {STATE}), which "
                f"a report needs; its topics: {topics}"
            )
        self._counts = {topic: one.message_count for topic, one in info.items()}
        self._transforms: dict[str, tuple[str, np.ndarray]] = {}
        # topic that gives the time of the recording: /clock, or the states of the controller if it
        # is missing
        self._clock_topic = CLOCK
        self._clock = RecordedClock(self._read_stamps(CLOCK), CLOCK_TOLERANCE_NS)
        if not self._clock:
            self._clock_topic = self._topics.state
            self._clock = RecordedClock(self._read_stamps(self._clock_topic), STATES_TOLERANCE_NS)
        # For each topic, differences (ns) between the time of the recording and the stamps of
        # messages that were left out because another clock has stamped them.
        self._foreign: dict[str, list[int]] = {}

    def read(self, progress: Callable[[float], None]) -> None:
        """Read all messages except images, and the stamps of the images.

        progress: function that is called with the fraction that has been read, 0 to 1.
        """
        t = self._topics
        handlers: dict[str, Callable[[Any], None]] = {
            t.state: self.states.append, t.report: self.add_report,
            t.moments: self.add_moments, t.joints: self.joints.append,
            t.info: self._add_info, t.metrics: self._add_metrics,
            t.experiment: self._add_experiment, TF: self._add_tf,
            # If the bag contains /tf, messages of /tf_static add no camera poses, because their
            # stamps can be older than those of earlier messages.
            TF_STATIC: self._add_transforms if TF in self._counts else self._add_tf,
        }  # fmt: skip
        # The last message on each of these topics remains valid after a reset of the clock.
        always = (t.info, t.experiment, TF_STATIC)
        start = self._find_start()
        topics = [topic for topic in (*handlers, t.image) if topic in self._counts]
        total = sum(self._counts[topic] for topic in topics)
        is_readable: dict[str, bool] = {}
        messages = self._bag.read_messages(topics, raw=True)
        for done, (topic, message, time) in enumerate(messages, 1):
            if 100 * done // total > 100 * (done - 1) // total:
                progress(done / total)
            _, data, _, position, _ = message
            if start is not None and position < start and topic not in always:
                continue
            if topic not in (*always, t.state) and (
                distance := self._clock.find_difference(position, _read_stamp(data, topic))
            ):
                self._foreign.setdefault(topic, []).append(distance)
                continue
            if topic == t.image:
                self.stamps.append((1e-9 * _read_stamp(data, topic), time.to_sec(), time))
                continue
            if topic not in is_readable:
                is_readable[topic] = self._has_used_fields(topic, message)
            if is_readable[topic]:
                handlers[topic](unpack(message))
        self._note_foreign_stamps()

    def _has_used_fields(self, topic: str, raw: tuple) -> bool:
        """Return whether the messages of a topic have all fields that a report needs.

        The bag can contain another version of the messages.

        Raises:
            BenchError: the messages of the controller's state lack a field.
        """
        name, _, _, _, kind = raw
        missing = [field for field in USED_FIELDS.get(name, ()) if field not in kind.__slots__]
        if not missing:
            return True
        problem = f"{topic} has another version of {name}, without {', '.join(missing)}"
        renamed = [f"{OLD_FIELDS[field]} is now called {field}" for field in missing
                   if OLD_FIELDS.get(field) in kind.__slots__]  # fmt: skip
        if renamed:
            problem += f" ({', '.join(renamed)})"
        if name == STATE:
            raise BenchError(f"{self.path}: {problem}; create the report with the version of this "
                             "software that recorded the bag")  # fmt: skip
        self.notes.append(f"{problem}: the report omits it")
        return False

    def _read_stamps(self, topic: str) -> list[tuple[tuple, int]]:
        """Return file position and stamp (ns) of each message on a topic; none without a topic."""
        if topic not in self._counts:
            return []
        return [
            (position, _read_stamp(data, topic))
            for _, (_, data, _, position, _), _ in self._bag.read_messages([topic], raw=True)
        ]

    def _find_start(self) -> tuple | None:
        """Return the file position of the last clock reset; return None if there is none."""
        resets = self._clock.resets
        if self._clock_topic != CLOCK and self._topics.joints:
            # Without /clock, resets are found in the stamps of joint states, which are more
            # frequent than states of the controller.
            entries = self._read_stamps(self._topics.joints)
            own = [one for one in entries if not self._clock.find_difference(*one)]
            resets = RecordedClock(own, STATES_TOLERANCE_NS).resets
        if not resets:
            return None
        count = "once" if len(resets) == 1 else f"{len(resets)} times"
        self.notes.append(
            f"the clock was reset {count} during the recording: the report covers the time after "
            "the last reset"
        )
        return resets[-1]

    def _note_foreign_stamps(self) -> None:
        """Add a note about messages that were left out because another clock has stamped them."""
        for topic, distances in self._foreign.items():
            count = "1 message is" if len(distances) == 1 else f"{len(distances)} messages are"
            self.notes.append(
                f"{topic}: {count} left out, because of stamps that are up to "
                f"{1e-9 * max(distances):.4g} s away from those on {self._clock_topic}: probably a "
                "second node publishes there and stamps its messages by another clock, such as "
                "wall time"
            )

    def _add_metrics(self, message: Any) -> None:
        self.real_time_factors.append((message.header.stamp.to_sec(), message.real_time_factor))

    def _add_info(self, message: Any) -> None:
        self.info = message

    def _add_experiment(self, message: Any) -> None:
        self.experiment_text = message.data

    def _add_transforms(self, message: Any) -> None:
        for entry in message.transforms:
            self._transforms[entry.child_frame_id.lstrip("/")] = (
                entry.header.frame_id.lstrip("/"), _to_matrix(entry.transform),
            )  # fmt: skip

    def _add_tf(self, message: Any) -> None:
        self._add_transforms(message)
        pose = self._compute_optical_pose()
        if message.transforms and pose is not None:
            self.poses.append((message.transforms[0].header.stamp.to_sec(), pose))

    def _compute_optical_pose(self) -> np.ndarray | None:
        """Compute the pose base_T_optical (4, 4) of the camera from the transforms read so far.

        Return None if they do not contain the camera.
        """
        frame = OPTICAL if OPTICAL in self._transforms else LINK
        if frame not in self._transforms:
            return None
        pose = np.eye(4)
        if frame == LINK:
            pose = optical_pose(pose)
        while frame in self._transforms:
            frame, parent_T_frame = self._transforms[frame]
            pose = parent_T_frame @ pose
        return pose

    def read_images(self, stamps: Iterable[float]) -> Iterator[tuple[float, np.ndarray]]:
        """Read the images nearest to the given stamps, s; yield the stamp and RGB image of each."""
        stamps = np.array(list(stamps))
        exposures = np.array([row[0] for row in self.stamps])
        selected = {self.stamps[i][2].to_nsec(): exposures[i]
                  for i in find_nearest(exposures, stamps).tolist()}  # fmt: skip
        times = [self.stamps[i][2] for i in find_nearest(exposures, stamps[[0, -1]]).tolist()]
        for _, message, written in self._bag.read_messages(
            [self._topics.image], start_time=min(times), end_time=max(times), raw=True
        ):
            exposure = selected.pop(written.to_nsec(), None)
            image = None if exposure is None else _to_rgb(unpack(message))
            if image is not None:
                yield float(exposure), image


def unpack(raw: tuple) -> Any:
    """Deserialize a raw message of rosbag, a tuple (type, bytes, md5, position, class)."""
    _, data, _, _, kind = raw
    message = kind()
    message.deserialize(data)
    return message


def _read_stamp(data: bytes, topic: str) -> int:
    """Return the stamp (ns) of a serialized message; 0 if it has none.

    The message is a rosgraph_msgs/Clock, a list of transforms, or starts with a std_msgs/Header.
    """
    offset = {CLOCK: 0, TF: 8}.get(topic, 4)
    if len(data) < offset + 8:
        return 0  # the message is an empty list of transforms
    secs, nsecs = struct.unpack_from("<II", data, offset)
    return secs * 1_000_000_000 + nsecs


def _to_matrix(transform: Any) -> np.ndarray:
    """Convert a geometry_msgs/Transform to a matrix (4, 4)."""
    q, t = transform.rotation, transform.translation
    return Pose((t.x, t.y, t.z), normalise((q.x, q.y, q.z, q.w))).matrix()


def _to_rgb(message: Any) -> np.ndarray | None:
    """Convert an image message, compressed or not, to an RGB array (rows, columns, 3).

    Return None if the image cannot be decoded.
    """
    if hasattr(message, "format"):
        image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        return None if image is None else image[..., ::-1]
    with contextlib.suppress(ImageError):
        return decode(message).rgb
    return None
