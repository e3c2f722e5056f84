"""A recorded run read from a bag: what a report needs of it, whatever its age and however it ended.

Topics are found by their types, so that other namespaces, cameras and robots are read as well.
"""

from __future__ import annotations

import contextlib
import io
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

if TYPE_CHECKING:
    import rosbag

STATE, REPORT, MOMENTS = (
    "aras_visual_servo_controller/ServoState", "aras_visual_servo_controller/ServoReport",
    "aras_visual_servo_camera/ImageMoments",
)  # fmt: skip
JOINTS, INFO, METRICS = (
    "sensor_msgs/JointState", "sensor_msgs/CameraInfo", "gazebo_msgs/PerformanceMetrics",
)
# What a report is made of; other versions of the messages may lack it.
USED_FIELDS = {
    STATE: ("header", "scheme", "phase", "reason", "feature_names", "features", "desired_features",
            "error", "camera_twist", "joint_names", "joint_commands", "singular_values"),
    REPORT: ("header", "outcome", "reason", "remedy", "achieved_twist", "rank", "singular_values_l",
             "manipulability", "scale", "computation_time"),
    MOMENTS: ("header", "valid", "order", "m", "mu"),
    METRICS: ("header", "real_time_factor"),
}  # fmt: skip
# Old names of fields in messages of earlier versions.
OLD_FIELDS = {
    "remedy": "mend", "desired_twist": "asked", "achieved_twist": "achieved",
    "infeasible_twist": "lost", "computation_time": "computing",
}  # fmt: skip
IMAGE, COMPRESSED = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
# ns by which stamps may be out of order without a clock that was put back
CLOCK_TOLERANCE_NS = 500_000_000
EXPERIMENT_TOPIC = "experiment"  # last part of the topic's name
CAMERA_NAMESPACE = "/labrob/camera/"  # of the shipped robot, where a bag has several
OPTICAL, LINK = "camera_optical_frame", "camera_link"
TF, TF_STATIC = "/tf", "/tf_static"


def read_bag(
    path: str | Path, progress: Callable[[float], None] = lambda part: None, name: str = ""
) -> Run:
    """Read a bag that record.launch wrote.

    Args:
        progress: told the part that is read. name: of the run; empty: the file's.

    Raises:
        BenchError: the file cannot be read, or lacks what a report needs.
    """
    import rosbag

    path = Path(path)
    try:
        bag, note = open_bag(path)
        with bag:
            reader = BagReader(bag, path)
            reader.read(progress)
            run = MessageRunBuilder(reader).build_run(name or _find_name(path))
    except (OSError, rosbag.ROSBagException, struct.error, ValueError, RuntimeError) as error:
        raise BenchError(f"cannot read the bag {path}: {error}") from error
    if note:
        run.notes.insert(0, note)
    return run


def read_recorded_experiment(path: Path) -> RecordedExperiment:
    """What a bag says of its run, read without the rest of it; BenchError where it cannot be."""
    import rosbag

    text = ""
    try:
        bag, _ = open_bag(path)
        with bag:
            topics = bag.get_type_and_topic_info().topics
            named = _find_topics({topic: one.msg_type for topic, one in topics.items()}).experiment
            for _, raw, _ in bag.read_messages([named], raw=True) if named else ():
                text = unpack(raw).data
    except (OSError, rosbag.ROSBagException, struct.error, ValueError, RuntimeError) as error:
        raise BenchError(f"cannot read the bag {path}: {error}") from error
    return RecordedExperiment.from_text(text)


def _find_name(path: Path) -> str:
    """The folder's name for a demo's run.bag, else the file's."""
    stem = path.name.split(".")[0]
    return path.resolve().parent.name if stem == "run" else stem


def open_bag(path: Path) -> tuple[rosbag.Bag, str]:
    """The bag, and what a reader must know of it."""
    import rosbag

    try:
        return rosbag.Bag(str(path)), ""
    except rosbag.ROSBagUnindexedException:
        return _reindex(path), (
            "the bag was not closed: it is still being recorded, or its recorder was killed. What "
            "is here is what was whole when it was read."
        )


def _reindex(path: Path) -> rosbag.Bag:
    """An unclosed bag with an index of its whole chunks; the file is left as it is."""
    import rosbag

    bag = rosbag.Bag(str(path), allow_unindexed=True)
    # Connections stand in the chunks; again behind them in a bag that was being closed.
    bag._reader._read_terminal_connection_records = lambda: None
    with contextlib.suppress(io.UnsupportedOperation):  # it would cut off what is behind them
        for _ in bag.reindex():
            pass
    for entries in bag._connection_indexes.values():  # they are of the last, broken chunk too
        entries[:] = [entry for entry in entries if entry.chunk_pos in bag._chunk_headers]
    bag._connection_indexes_read = True
    return bag


def _find_topics(kinds: Mapping[str, str]) -> SimpleNamespace:
    """Names of what a report is made of, empty where the bag has none; kinds: type of each topic.

    state, report, moments, joints, info, metrics, image, experiment: see the constants above.
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
    """Reads once all but the pictures, and then the few pictures that are shown."""

    def __init__(self, bag: rosbag.Bag, path: Path) -> None:
        super().__init__(path)
        self._bag = bag
        info = bag.get_type_and_topic_info().topics
        self._topics = _find_topics({topic: one.msg_type for topic, one in info.items()})
        if not self._topics.state:
            there = ", ".join(sorted(info)) or "no message"
            raise BenchError(
                f"{path} holds no state of a servo controller (a topic of type {STATE}); it has "
                f"{there}"
            )
        self._counts = {topic: one.message_count for topic, one in info.items()}
        self._transforms: dict[str, tuple[str, np.ndarray]] = {}

    # -- reading ---------------------------------------------------------------------------

    def read(self, progress: Callable[[float], None]) -> None:
        """All but the pictures' own bytes."""
        t = self._topics
        takers: dict[str, Callable[[Any], None]] = {
            t.state: self.states.append, t.report: self.add_report,
            t.moments: self.add_moments, t.joints: self.joints.append,
            t.info: self._add_info, t.metrics: self._add_metrics,
            t.experiment: self._add_experiment, TF: self._add_tf,
            # What never changes may be stamped before others that were recorded before it.
            TF_STATIC: self._add_transforms if TF in self._counts else self._add_tf,
        }  # fmt: skip
        always = (t.info, t.experiment, TF_STATIC)  # told once, or never another
        began = self._find_start()
        wanted = [topic for topic in (*takers, t.image) if topic in self._counts]
        total = sum(self._counts[topic] for topic in wanted)
        asked: dict[str, bool] = {}
        messages = self._bag.read_messages(wanted, raw=True)
        for done, (topic, message, time) in enumerate(messages, 1):
            if 100 * done // total > 100 * (done - 1) // total:
                progress(done / total)
            _, data, _, place, _ = message
            if began is not None and place < began and topic not in always:
                continue
            if topic == t.image:
                self.stamps.append((1e-9 * _read_stamp(data), time.to_sec(), time))
                continue
            if topic not in asked:
                asked[topic] = self._is_this_version(topic, message)
            if asked[topic]:
                takers[topic](unpack(message))

    def _is_this_version(self, topic: str, raw: tuple) -> bool:
        """Whether messages, which are read as the bag defines them, have what is made use of.

        Raises:
            BenchError: the controller's states do not.
        """
        name, _, _, _, kind = raw
        missing = [field for field in USED_FIELDS.get(name, ()) if field not in kind.__slots__]
        if not missing:
            return True
        without = f"{topic} is of another version of {name}, without {', '.join(missing)}"
        renamed = [f"{OLD_FIELDS[field]} is now called {field}" for field in missing
                   if OLD_FIELDS.get(field) in kind.__slots__]  # fmt: skip
        if renamed:
            without += f" ({', '.join(renamed)})"
        if name == STATE:
            raise BenchError(f"{self.path}: {without}; report on it with the version of this "
                             "software that recorded it")  # fmt: skip
        self.notes.append(f"{without}: it is left out")
        return False

    def _find_start(self) -> tuple | None:
        """Where in the file the clock was last put back, None: never. From there on is one run."""
        topic, written = self._topics.joints or self._topics.state, []
        for _, (_, data, _, place, _), _ in self._bag.read_messages([topic], raw=True):
            written.append((place, _read_stamp(data)))
        written = sorted(one for one in written if one[1])
        back = [
            i
            for i in range(1, len(written))
            if written[i][1] < written[i - 1][1] - CLOCK_TOLERANCE_NS
        ]
        if not back:
            return None
        self.notes.append(
            f"the clock was put back {'once' if len(back) == 1 else f'{len(back)} times'} while "
            "this bag was recorded: what is here is what came after"
        )
        return written[back[-1]][0]

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
        """`base_T_optical` along the tree of transforms known by now."""
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
        """The pictures that are next to these exposures, as rgb, read in one pass."""
        stamps = np.array(list(stamps))
        exposures = np.array([row[0] for row in self.stamps])
        wanted = {self.stamps[i][2].to_nsec(): exposures[i]
                  for i in find_nearest(exposures, stamps).tolist()}  # fmt: skip
        times = [self.stamps[i][2] for i in find_nearest(exposures, stamps[[0, -1]]).tolist()]
        for _, message, written in self._bag.read_messages(
            [self._topics.image], start_time=min(times), end_time=max(times), raw=True
        ):
            exposure = wanted.pop(written.to_nsec(), None)
            picture = None if exposure is None else _to_rgb(unpack(message))
            if picture is not None:
                yield float(exposure), picture


def unpack(raw: tuple) -> Any:
    """The message of (type, bytes, md5, position, class)."""
    _, data, _, _, kind = raw
    message = kind()
    message.deserialize(data)
    return message


def _read_stamp(data: bytes) -> int:
    """ns, of a message that begins with a std_msgs/Header: seq, secs, nsecs, each four bytes."""
    _, secs, nsecs = struct.unpack_from("<III", data)
    return secs * 1_000_000_000 + nsecs


def _to_matrix(transform: Any) -> np.ndarray:
    """(4, 4) of a geometry_msgs/Transform."""
    q, t = transform.rotation, transform.translation
    return Pose((t.x, t.y, t.z), normalise((q.x, q.y, q.z, q.w))).matrix()


def _to_rgb(message: Any) -> np.ndarray | None:
    """(H, W, 3) uint8 of an image raw or compressed; None: of an unknown encoding."""
    if hasattr(message, "format"):
        image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        return None if image is None else image[..., ::-1]
    with contextlib.suppress(ImageError):
        return decode(message).rgb
    return None
