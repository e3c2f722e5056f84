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
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.image_reader import ImageReader
from aras_visual_servo_controller.observation.observation import CAMERA

from ..errors import StudyError
from ..recording.run import Run
from ..runner.loop import NS, Loop
from ..setup.assembly import assemble
from .progress import format_count
from .study import Study

DEPTH_STEP = 1e-4  # m
_FARTHEST = np.iinfo(np.uint16).max * DEPTH_STEP
NUMBERS_BYTES = 600  # of a row's numbers, about
TIME_TOLERANCE = 1e-9  # s
_LIST = pa.list_(pa.float64())


@dataclass(frozen=True)
class Column:
    """A column: its type, and what it holds, with unit and frame."""

    kind: pa.DataType
    meaning: str


NUMBER_COLUMNS: Mapping[str, Column] = {
    "run": Column(pa.int64(), "number of the run, as in parts/"),
    "image": Column(pa.int64(), "number of the image in its run, from 0 on"),
    "stamp": Column(pa.float64(), "of the exposure, s of simulated time"),
    "phase": Column(pa.string(), "of the loop"),
    "features": Column(_LIST, "s, as measured; NaN where there is no answer"),
    "error": Column(_LIST, "s - s*"),
    "desired_twist": Column(_LIST, "twist that the scheme requests of the camera (6), in its "
                                   "optical frame, "
                           "m/s and rad/s"),
    "achieved_twist": Column(_LIST, "twist that the joints' velocities give (6), likewise"),
    "joints": Column(_LIST, "measured at the exposure, rad or m"),
    "pose": Column(_LIST, "true world_T_camera at the exposure (16), 4 x 4 row by row, m"),
    "camera_T_goal": Column(_LIST, "true pose of the goal in the camera's frame (16), likewise"),
    "camera_T_target": Column(_LIST, "true pose of the target in the camera's frame (16)"),
}  # fmt: skip


def list_columns(study: Study) -> dict[str, Column]:
    """The columns of a study's images, by name."""
    found, several = dict(NUMBER_COLUMNS), _find_cameras(study) != (CAMERA,)
    for name in _find_cameras(study) if study.pictures != "none" else ():
        end, of = (f"_{name}", f" of camera {name}") if several else ("", "")
        found[f"picture{end}"] = Column(pa.binary(), f"PNG{of}, as bytes")
        if study.depth:
            found[f"depth{end}"] = Column(
                pa.binary(), f"PNG of 16 bits{of}, as bytes: along the optical axis, in steps of "
                f"{1e3 * DEPTH_STEP:g} mm; 0: nothing within {_FARTHEST:.1f} m")  # fmt: skip
    return found


def make_schema(study: Study) -> pa.Schema:
    """Of the table of its images."""
    return pa.schema([(name, column.kind) for name, column in list_columns(study).items()])


def check_images(study: Study) -> None:
    """StudyError for pictures that cannot be kept."""
    if study.pictures == "none":
        if study.depth:
            raise StudyError("depth is kept beside pictures: give pictures: all, or first")
        return
    names = _find_cameras(study)
    for trial in study.make_trials():
        if not trial.has_images:
            raise StudyError(
                "pictures cannot be kept of exact features: give the experiment features: images"
            )
        if tuple(trial.camera_specs) != names:
            raise StudyError(
                f"pictures are kept of the same cameras in all runs: {', '.join(names)} in one, "
                f"{', '.join(trial.camera_specs)} in another"
            )


def check_room(study: Study, path: Path, finished_runs: int = 0) -> str:
    """How much room the images of the runs from `finished_runs` on take at most, in words; "" for
    none.

    Raises:
        StudyError: the disk of `path` has less.
    """
    if study.pictures == "none":
        return ""
    experiment = study.make_experiment(0)
    seen = ImageRecorder(records_images=True)
    loop = Loop(experiment, assemble(experiment, has_depth=study.depth), on_frame=seen.add_frame)
    try:
        loop.run_to_image()
    finally:
        loop.close()
    images = 1
    if study.pictures == "all":
        rate = max(eye.rate for eye in loop.parts.cameras.values())
        images = int(np.ceil(experiment.duration * rate)) + 2
    each = NUMBERS_BYTES + seen.nbytes
    total = (study.run_count - finished_runs) * images * each
    there = next(parent for parent in (path.absolute(), *path.absolute().parents)
                 if parent.exists())  # fmt: skip
    free = shutil.disk_usage(there).free
    told = (f"{_format_size(total)} at most: "
            f"{format_count(study.run_count - finished_runs, 'run')} of up to "
            f"{format_count(images, 'image')} of {_format_size(each)}")  # fmt: skip
    if total > free:
        raise StudyError(
            f"the disk of {there} has {_format_size(free)}, and the data set would take {told}; "
            "make "
            "repeats or duration smaller, keep the first image of each run alone "
            "(pictures: first), or name another disk"
        )
    return told


class ImageRecorder:
    """Takes in what the cameras of a run see, as it is made, and where the control camera is then.
    """

    def __init__(self, records_images: bool) -> None:
        """`records_images`: keep them too, and depth images."""
        self._records_images = records_images
        self._stamps: dict[str, list[float]] = {}
        self._images: dict[str, list[tuple[bytes | None, bytes | None]]] = {}
        self._poses: dict[float, np.ndarray] = {}

    @property
    def nbytes(self) -> int:
        """Of the latest images of all cameras."""
        return sum(len(part or b"") for seen in self._images.values() for part in seen[-1])

    def add_frame(self, loop: Loop, reading: Frame) -> None:
        """An image of a camera of this loop, just made."""
        if reading.name == loop.parts.rig.control.name:
            # The plant stands at the end of the step in which it was exposed.
            positions, velocities = loop.plant.read_joints()
            since = loop.plant.time_ns / NS - reading.stamp
            at_exposure = (positions - since * velocities)[None]
            at_rest = loop.plant.compute_rest_poses(at_exposure)[0]
            self._poses[reading.stamp] = loop.plant.apply_vibration(at_rest, reading.stamp_ns)
        if self._records_images:
            self._stamps.setdefault(reading.name, []).append(reading.stamp)
            self._images.setdefault(reading.name, []).append(
                (_encode_image(reading), _encode_depth(reading))
            )

    def make_rows(self, number: int, run: Run, end_time: float) -> list[dict[str, Any]]:
        """A row for each image that was answered in a run.

        Args:
            number: of the run. ended: simulated time at its end, s.
        """
        at_end = inverse(run.target.world_T_target(end_time)) @ run.goal_pose
        found = []
        for i, stamp in enumerate(run.stamp.tolist()):
            pose = self._poses[stamp]
            camera_T_target = inverse(pose) @ run.target.world_T_target(stamp)
            found.append({
                "run": number, "image": i, "stamp": stamp, "phase": run.phases[i],
                **{name: getattr(run, name)[i].tolist()
                   for name in ("features", "error", "desired_twist", "achieved_twist", "joints")},
                "pose": pose.ravel().tolist(),
                "camera_T_goal": (camera_T_target @ at_end).ravel().tolist(),
                "camera_T_target": camera_T_target.ravel().tolist(),
                **self._find_images(stamp),
            })  # fmt: skip
        return found

    def _find_images(self, stamp: float) -> dict[str, bytes | None]:
        """Columns of the images that cameras had made last at a stamp, s."""
        found: dict[str, bytes | None] = {}
        for name, stamps in self._stamps.items():
            latest = bisect_right(stamps, stamp + TIME_TOLERANCE) - 1
            picture, depth = self._images[name][latest] if latest >= 0 else (None, None)
            end = "" if name == CAMERA else f"_{name}"
            found |= {f"picture{end}": picture, f"depth{end}": depth}
        return found


def _find_cameras(study: Study) -> tuple[str, ...]:
    return tuple(study.make_experiment(0).camera_specs)


def _encode_image(reading: Frame) -> bytes | None:
    if reading.image is None:
        return None
    picture = ImageReader.decode_image(reading)
    return _encode_png(picture.rgb[..., ::-1] if picture.has_colour else picture.grey)


def _encode_depth(reading: Frame) -> bytes | None:
    if reading.depth is None:
        return None
    near = np.where(reading.depth <= _FARTHEST, reading.depth, 0.0)
    return _encode_png(np.rint(near / DEPTH_STEP).astype(np.uint16))


def _encode_png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(pixels))[1].tobytes()


def _format_size(count: float) -> str:
    for unit in ("bytes", "kB", "MB", "GB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} TB"
