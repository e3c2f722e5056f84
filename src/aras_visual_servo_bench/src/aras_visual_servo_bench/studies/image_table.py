"""Table with a row for each image of a study's runs: numbers such as poses, and the images.

An image is stored as a grey or colour PNG. A depth image is stored as a 16-bit PNG in steps of 0.1
mm; the value 0 means that there is no surface within 6.5 m.
"""

from __future__ import annotations

import shutil
from bisect import bisect_right
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pyarrow as pa

from aras_visual_servo_base.poses import inverse
from aras_visual_servo_controller.observation.feature_extractor import FeatureExtractor
from aras_visual_servo_controller.observation.frame import NANOSECONDS, Frame
from aras_visual_servo_controller.observation.observation import CAMERA

from ..errors import StudyError
from ..metrics.formatting import format_count
from ..recording.run import Run
from ..runner.loop import Loop
from ..setup.assembly import assemble
from .study import Study

DEPTH_STEP = 1e-4  # m
_FARTHEST = np.iinfo(np.uint16).max * DEPTH_STEP
NUMBERS_BYTES = 600  # approximate size of a row without its images, bytes
TIME_TOLERANCE = 1e-9  # s


class ImageTableColumn(NamedTuple):
    """Column of the table of images: type of the values, and their meaning with unit and frame."""

    kind: pa.DataType
    meaning: str


NUMBER_COLUMNS = {
    "run": ImageTableColumn(pa.int64(), "number of the run, as in parts/"),
    "image": ImageTableColumn(pa.int64(), "number of the image in its run, from 0"),
    "stamp": ImageTableColumn(pa.float64(), "time of the exposure, s of simulated time"),
    "phase": ImageTableColumn(pa.string(), "phase of the control loop"),
    **{name: ImageTableColumn(pa.list_(pa.float64()), meaning) for name, meaning in {
        "features": "measured features s; NaN without a measurement",
        "error": "s - s*",
        "desired_twist": "camera twist (6) that the scheme commands, in the optical frame, m/s and "
                         "rad/s",
        "achieved_twist": "camera twist (6) that the commanded joint velocities produce, in the "
                          "optical frame, m/s and rad/s",
        "joints": "joint positions measured at the exposure, rad or m",
        "pose": "true world_T_camera at the exposure (16), 4 x 4 row by row, m",
        "camera_T_goal": "true camera_T_goal (16), the goal pose of the camera in its present "
                         "frame, 4 x 4 row by row, m",
        "camera_T_target": "true pose of the target in the camera's frame (16), 4 x 4 row by row",
    }.items()},
}  # fmt: skip


def list_columns(study: Study) -> dict[str, ImageTableColumn]:
    """Return the columns of the table of a study's images, by name."""
    columns, several = dict(NUMBER_COLUMNS), _find_cameras(study) != (CAMERA,)
    for name in _find_cameras(study) if study.pictures != "none" else ():
        end, of = (f"_{name}", f" of camera {name}") if several else ("", "")
        columns[f"picture{end}"] = ImageTableColumn(pa.binary(), f"image{of}, bytes of a PNG file")
        if study.depth:
            columns[f"depth{end}"] = ImageTableColumn(
                pa.binary(), f"depth image{of}, bytes of a 16-bit PNG file: depth along the "
                f"optical axis in steps of {1e3 * DEPTH_STEP:g} mm, or 0 if no surface is within "
                f"{_FARTHEST:.1f} m")  # fmt: skip
    return columns


def make_schema(study: Study) -> pa.Schema:
    """Return the schema of the table of a study's images."""
    return pa.schema([(name, column.kind) for name, column in list_columns(study).items()])


def check_images(study: Study) -> None:
    """Check that all runs of a study have the images that the study stores.

    Raises:
        StudyError: a run has no images, or has different cameras; or `depth` is set without
            `pictures`.
    """
    if study.pictures == "none":
        if study.depth:
            raise StudyError("depth needs pictures: set pictures to all or first")
        return
    names = _find_cameras(study)
    for trial in study.make_trials():
        if not trial.has_images:
            raise StudyError(
                "pictures needs images, but exact features have none: set features to images in "
                "the experiment"
            )
        if tuple(trial.camera_specs) != names:
            raise StudyError(
                f"pictures needs the same cameras in all runs, but one run has {', '.join(names)} "
                f"and another {', '.join(trial.camera_specs)}: set the same cameras"
            )


def check_room(study: Study, path: Path, finished_runs: int = 0) -> str:
    """Describe the maximum disk space for the images of the remaining runs.

    Return '' if the study stores no images.

    Args:
        study: study whose images are stored.
        path: folder of the study.
        finished_runs: number of runs whose images are already stored.

    Raises:
        StudyError: the free space of the disk is smaller than this maximum.
    """
    if study.pictures == "none":
        return ""
    experiment = study.make_experiment(0)
    recorder = ImageRecorder(records_images=True)
    loop = Loop(
        experiment, assemble(experiment, has_depth=study.depth), on_frame=recorder.add_frame
    )
    try:
        loop.run_to_image()
    finally:
        loop.close()
    images = 1
    if study.pictures == "all":
        rate = max(camera.rate for camera in loop.parts.cameras.values())
        images = int(np.ceil(experiment.duration * rate)) + 2
    each = NUMBERS_BYTES + recorder.nbytes
    total = (study.run_count - finished_runs) * images * each
    existing = next(parent for parent in (path.absolute(), *path.absolute().parents)
                    if parent.exists())  # fmt: skip
    free = shutil.disk_usage(existing).free
    size = (f"{_format_size(total)} at most: "
            f"{format_count(study.run_count - finished_runs, 'run')} of up to "
            f"{format_count(images, 'image')} of {_format_size(each)}")  # fmt: skip
    if total > free:
        raise StudyError(
            f"the disk of {existing} has {_format_size(free)}, but the data set needs {size}; "
            "make repeats or duration smaller, store only the first image of each run "
            "(pictures: first), or use another disk"
        )
    return size


class ImageRecorder:
    """Recorder of a run's images and of the true pose of the control camera at each exposure."""

    def __init__(self, records_images: bool) -> None:
        """Prepare the recorder.

        records_images: whether to record images and depth images; False: only poses.
        """
        self._records_images = records_images
        self._stamps: dict[str, list[float]] = {}
        self._images: dict[str, list[tuple[bytes | None, bytes | None]]] = {}
        self._poses: dict[float, np.ndarray] = {}

    @property
    def nbytes(self) -> int:
        """Total size of the latest image and depth image of each camera, bytes."""
        return sum(len(part or b"") for images in self._images.values() for part in images[-1])

    def add_frame(self, loop: Loop, reading: Frame) -> None:
        """Add an image; the loop calls this method when a camera exposes an image."""
        if reading.name == loop.parts.rig.control.name:
            # The plant is at the end of its step, and the exposure was earlier in the step, so the
            # joint positions are extrapolated back to the exposure.
            positions, velocities = loop.plant.read_joints()
            elapsed = loop.plant.time_ns / NANOSECONDS - reading.stamp
            at_exposure = (positions - elapsed * velocities)[None]
            rest_pose = loop.plant.compute_rest_poses(at_exposure)[0]
            self._poses[reading.stamp] = loop.plant.apply_vibration(rest_pose, reading.stamp_ns)
        if self._records_images:
            self._stamps.setdefault(reading.name, []).append(reading.stamp)
            self._images.setdefault(reading.name, []).append(
                (_encode_image(reading), _encode_depth(reading))
            )

    def make_rows(self, number: int, run: Run, end_time: float) -> list[dict[str, Any]]:
        """Make a row for each image that the loop processed in a run.

        Args:
            number: number of the run.
            run: record of the run.
            end_time: simulated time at the end of the run, s.
        """
        target_T_goal = inverse(run.target.world_T_target(end_time)) @ run.goal_pose
        rows = []
        for i, stamp in enumerate(run.stamp.tolist()):
            pose = self._poses[stamp]
            camera_T_target = inverse(pose) @ run.target.world_T_target(stamp)
            rows.append({
                "run": number, "image": i, "stamp": stamp, "phase": run.phases[i],
                **{name: getattr(run, name)[i].tolist()
                   for name in ("features", "error", "desired_twist", "achieved_twist", "joints")},
                "pose": pose.ravel().tolist(),
                "camera_T_goal": (camera_T_target @ target_T_goal).ravel().tolist(),
                "camera_T_target": camera_T_target.ravel().tolist(),
                **self._find_images(stamp),
            })  # fmt: skip
        return rows

    def _find_images(self, stamp: float) -> dict[str, bytes | None]:
        """Return the image that each camera took last before a stamp (s), by column name."""
        columns: dict[str, bytes | None] = {}
        for name, stamps in self._stamps.items():
            latest = bisect_right(stamps, stamp + TIME_TOLERANCE) - 1
            image, depth = self._images[name][latest] if latest >= 0 else (None, None)
            end = "" if name == CAMERA else f"_{name}"
            columns |= {f"picture{end}": image, f"depth{end}": depth}
        return columns


def _find_cameras(study: Study) -> tuple[str, ...]:
    return tuple(study.make_experiment(0).camera_specs)


def _encode_image(reading: Frame) -> bytes | None:
    if reading.image is None:
        return None
    image = FeatureExtractor.decode_image(reading)
    return _encode_png(image.rgb[..., ::-1] if image.has_colour else image.grey)


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
