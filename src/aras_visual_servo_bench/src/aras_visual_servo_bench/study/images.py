"""What a study keeps of the images of its runs: numbers, pictures and depths; one row an image.

A picture is kept as a PNG of what the camera delivers, grey or colour; a depth image as a PNG of
16 bits, in steps of 0.1 mm, 0 where there is none within 6.5 m.
"""

from __future__ import annotations

import shutil
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa

from aras_visual_servo_base.poses import inverse
from aras_visual_servo_controller.seeing.frame import Frame
from aras_visual_servo_controller.seeing.image_reader import ImageReader
from aras_visual_servo_controller.seeing.observation import CAMERA

from ..errors import StudyError
from ..recording.run import Run
from ..running.loop import NS, Loop
from ..setup.assembly import assemble
from .progress import counted
from .study import Study

DEPTH_STEP = 1e-4  # m
_FARTHEST = np.iinfo(np.uint16).max * DEPTH_STEP
NUMBERS_BYTES = 600  # of a row's numbers, about
SAME_INSTANT = 1e-9  # s
_LIST = pa.list_(pa.float64())


@dataclass(frozen=True)
class Column:
    """A column: its type, and what it holds, with unit and frame."""

    kind: pa.DataType
    meaning: str


NUMBERS: Mapping[str, Column] = {
    "run": Column(pa.int64(), "number of the run, as in parts/"),
    "image": Column(pa.int64(), "number of the image in its run, from 0 on"),
    "stamp": Column(pa.float64(), "of the exposure, s of simulated time"),
    "phase": Column(pa.string(), "of the loop"),
    "features": Column(_LIST, "s, as measured; NaN where there is no answer"),
    "error": Column(_LIST, "s - s*"),
    "asked": Column(_LIST, "twist that the scheme asks of the camera (6), in its optical frame, "
                           "m/s and rad/s"),
    "achieved": Column(_LIST, "twist that the joints' velocities give (6), likewise"),
    "joints": Column(_LIST, "measured at the exposure, rad or m"),
    "pose": Column(_LIST, "true world_T_camera at the exposure (16), 4 x 4 row by row, m"),
    "camera_T_goal": Column(_LIST, "true pose of the goal in the camera's frame (16), likewise"),
    "camera_T_target": Column(_LIST, "true pose of the target in the camera's frame (16)"),
}  # fmt: skip


def columns(study: Study) -> dict[str, Column]:
    """The columns of a study's images, by name."""
    found, several = dict(NUMBERS), _cameras(study) != (CAMERA,)
    for name in _cameras(study) if study.pictures != "none" else ():
        end, of = (f"_{name}", f" of camera {name}") if several else ("", "")
        found[f"picture{end}"] = Column(pa.binary(), f"PNG{of}, as bytes")
        if study.depth:
            found[f"depth{end}"] = Column(
                pa.binary(), f"PNG of 16 bits{of}, as bytes: along the optical axis, in steps of "
                f"{1e3 * DEPTH_STEP:g} mm; 0: nothing within {_FARTHEST:.1f} m")  # fmt: skip
    return found


def schema(study: Study) -> pa.Schema:
    """Of the table of its images."""
    return pa.schema([(name, column.kind) for name, column in columns(study).items()])


def check(study: Study) -> None:
    """StudyError for pictures that cannot be kept."""
    if study.pictures == "none":
        if study.depth:
            raise StudyError("depth is kept beside pictures: give pictures: all, or first")
        return
    names = _cameras(study)
    for trial in study.trials():
        if not trial.pictures:
            raise StudyError(
                "pictures cannot be kept of exact features: give the experiment features: pictures"
            )
        if tuple(trial.seen_by) != names:
            raise StudyError(
                f"pictures are kept of the same cameras in all runs: {', '.join(names)} in one, "
                f"{', '.join(trial.seen_by)} in another"
            )


def check_room(study: Study, path: Path, done: int = 0) -> str:
    """How much room the images of the runs from `done` on take at most, in words; "" for none.

    Raises:
        StudyError: the disk of `path` has less.
    """
    if study.pictures == "none":
        return ""
    experiment = study.experiment_of(0)
    seen = Keeper(pictures=True)
    loop = Loop(experiment, assemble(experiment, depth=study.depth), watch=seen.add)
    try:
        loop.to_image()
    finally:
        loop.close()
    images = 1
    if study.pictures == "all":
        rate = max(eye.rate for eye in loop.parts.eyes.values())
        images = int(np.ceil(experiment.duration * rate)) + 2
    each = NUMBERS_BYTES + seen.nbytes
    total = (study.runs - done) * images * each
    there = next(parent for parent in (path.absolute(), *path.absolute().parents)
                 if parent.exists())  # fmt: skip
    free = shutil.disk_usage(there).free
    told = (f"{_size(total)} at most: {counted(study.runs - done, 'run')} of up to "
            f"{counted(images, 'image')} of {_size(each)}")  # fmt: skip
    if total > free:
        raise StudyError(
            f"the disk of {there} has {_size(free)}, and the data set would take {told}; make "
            "repeats or duration smaller, keep the first image of each run alone "
            "(pictures: first), or name another disk"
        )
    return told


class Keeper:
    """Takes in what the cameras of a run see, as it is made, and where the control camera is then.
    """

    def __init__(self, pictures: bool) -> None:
        """`pictures`: keep them too, and depth images."""
        self._pictures = pictures
        self._stamps: dict[str, list[float]] = {}
        self._seen: dict[str, list[tuple[bytes | None, bytes | None]]] = {}
        self._poses: dict[float, np.ndarray] = {}

    @property
    def nbytes(self) -> int:
        """Of the latest images of all cameras."""
        return sum(len(part or b"") for seen in self._seen.values() for part in seen[-1])

    def add(self, loop: Loop, reading: Frame) -> None:
        """An image of a camera of this loop, just made."""
        if reading.name == loop.parts.rig.control.name:
            # The plant stands at the end of the step in which it was exposed.
            positions, velocities = loop.plant.joints()
            since = loop.plant.time_ns / NS - reading.stamp
            at_exposure = (positions - since * velocities)[None]
            at_rest = loop.plant.poses(at_exposure)[0]
            self._poses[reading.stamp] = loop.plant.shaken(at_rest, reading.stamp_ns)
        if self._pictures:
            self._stamps.setdefault(reading.name, []).append(reading.stamp)
            self._seen.setdefault(reading.name, []).append((_picture(reading), _depth(reading)))

    def rows(self, number: int, run: Run, ended: float) -> list[dict[str, Any]]:
        """A row for each image that was answered in a run.

        Args:
            number: of the run. ended: simulated time at its end, s.
        """
        at_end = inverse(run.target.world_T_target(ended)) @ run.goal_pose
        found = []
        for i, stamp in enumerate(run.stamp.tolist()):
            pose = self._poses[stamp]
            camera_T_target = inverse(pose) @ run.target.world_T_target(stamp)
            found.append({
                "run": number, "image": i, "stamp": stamp, "phase": run.phases[i],
                **{name: getattr(run, name)[i].tolist()
                   for name in ("features", "error", "asked", "achieved", "joints")},
                "pose": pose.ravel().tolist(),
                "camera_T_goal": (camera_T_target @ at_end).ravel().tolist(),
                "camera_T_target": camera_T_target.ravel().tolist(),
                **self._at(stamp),
            })  # fmt: skip
        return found

    def _at(self, stamp: float) -> dict[str, bytes | None]:
        """Columns of the images that cameras had made last at a stamp, s."""
        found: dict[str, bytes | None] = {}
        for name, stamps in self._stamps.items():
            latest = bisect_right(stamps, stamp + SAME_INSTANT) - 1
            picture, depth = self._seen[name][latest] if latest >= 0 else (None, None)
            end = "" if name == CAMERA else f"_{name}"
            found |= {f"picture{end}": picture, f"depth{end}": depth}
        return found


def _cameras(study: Study) -> tuple[str, ...]:
    return tuple(study.experiment_of(0).seen_by)


def _picture(reading: Frame) -> bytes | None:
    if reading.image is None:
        return None
    picture = ImageReader.image_of(reading)
    return _png(picture.rgb[..., ::-1] if picture.has_colour else picture.grey)


def _depth(reading: Frame) -> bytes | None:
    if reading.depth is None:
        return None
    near = np.where(reading.depth <= _FARTHEST, reading.depth, 0.0)
    return _png(np.rint(near / DEPTH_STEP).astype(np.uint16))


def _png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(pixels))[1].tobytes()


def _size(count: float) -> str:
    for unit in ("bytes", "kB", "MB", "GB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} TB"
