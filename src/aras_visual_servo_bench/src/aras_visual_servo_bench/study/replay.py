"""One run of a study again, with its pictures: a report and a video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..asked import cameras
from ..asked.assembly import assemble
from ..asked.experiment import Experiment
from ..errors import ExperimentError, StudyError
from ..numbers import metrics as known_metrics
from ..numbers.metrics import Finished
from ..plants import CameraReading
from ..recording.of_run import record_of
from ..recording.record import Record
from ..recording.run import Details
from ..report.write import write_report
from ..running.flight import Flight
from ..running.loop import Loop
from . import rows
from .folder import Folder


@dataclass(frozen=True)
class Replay:
    """The run again. study: its folder. details: of its loop. pictures: rgb (rows, columns, 3) of
    every image. changed: what is not as it was recorded, by column."""

    number: int
    study: Path
    finished: Finished
    details: Details
    pictures: list[np.ndarray]
    row: dict[str, Any]
    changed: dict[str, tuple[Any, Any]]


def replay(folder: Folder, run: int) -> Replay:
    """Carry a run out once more.

    Raises:
        StudyError: there is no such run, or it cannot be run.
    """
    study = folder.study
    if not 0 <= run < study.runs:
        raise StudyError(f"there is no run {run}: {folder.path} has runs 0 to {study.runs - 1}")
    try:
        finished, details, pictures = _with_pictures(study.experiment_of(run))
        now = _row(folder, run, finished)
    except ExperimentError as error:
        raise StudyError(f"run {run}: {error}") from error
    except Exception as error:  # its outcome was a fault, in a user's code most often
        raise StudyError(f"run {run}: {type(error).__name__}: {error}") from error
    recorded = _recorded(folder, run)
    changed = {
        key: (recorded[key], value) for key, value in now.items()
        if key in recorded and recorded[key] != value
        and not (recorded[key] != recorded[key] and value != value)
    }  # fmt: skip
    return Replay(run, folder.path, finished, details, pictures, now, changed)


def carried_out(name: str, experiment: Experiment, source: str = "") -> Record:
    """The record of an experiment that is run here and now; ExperimentError where it cannot."""
    return record_of(name, *_with_pictures(experiment), source)


def _with_pictures(experiment: Experiment) -> tuple[Finished, Details, list[np.ndarray]]:
    """A run with all that its loop knew, and rgb of every image that was answered."""
    parts = assemble(experiment)
    if experiment.plant == "ideal":
        flight = Flight(experiment, parts)
        while flight.outcome is None:
            flight.step()
        return Finished(experiment, parts, flight.result()), flight.details(), []
    pictures: list[np.ndarray] = []
    loop = Loop(experiment, parts)
    try:
        while not loop.over:
            before = loop.reading
            loop.to_image()
            if loop.reading is not None and loop.reading is not before:
                pictures.append(_picture(loop.reading, loop))
        return Finished(experiment, parts, loop.result()), loop.details(), pictures
    finally:
        loop.close()


def _row(folder: Folder, run: int, finished: Finished) -> dict[str, Any]:
    result, study = finished.run, folder.study
    return {
        **rows.blank(study, run),
        "outcome": result.outcome, "verdict": result.verdict.word, "reason": result.reason,
        "images": len(result.stamp),
        **{rows.column(name): float(known_metrics.find(name).measure(finished))
           for name in study.metric_names},
    }  # fmt: skip


def _recorded(folder: Folder, run: int) -> dict[str, Any]:
    """The row that was kept, without what only tells of the code; empty where it was not run."""
    if not folder.part(run // folder.study.chunk_size).exists():
        return {}
    table = folder.results()
    kept = table.filter(np.array(table["run"]) == run).to_pylist()
    return {k: v for k, v in kept[0].items() if k not in (*rows.LABELS, "simulated", "seed")}


def _picture(reading: CameraReading, loop: Loop) -> np.ndarray:
    """What the camera saw, drawn where it sees exactly."""
    image = reading.image
    if image is None:
        image = cameras.draw(reading.outline, loop.plant.camera)
    if image.ndim == 2 or image.shape[2] == 1:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    return image[..., ::-1].copy() if reading.encoding.startswith("bgr") else image


def write(shown: Replay, out: Path) -> list[Path]:
    """The report, with video.mp4 where there are pictures; StudyError where it cannot."""
    try:
        written = write_report([record(shown)], out, ("png",))
        if shown.pictures:
            written.append(_video(shown, out / "video.mp4"))
    except OSError as error:
        raise StudyError(f"cannot write into {out}: {error.strerror or error}") from None
    return written


def record(shown: Replay, name: str = "") -> Record:
    """The run as a report takes it, with what is not as it was recorded for a note."""
    found = record_of(
        name or f"run {shown.number}", shown.finished, shown.details, shown.pictures,
        f"run {shown.number} of the study {shown.study}",
    )  # fmt: skip
    found.notes += [
        f"not as it was recorded: {key} was {old}, is {new}"
        for key, (old, new) in shown.changed.items()
    ]
    return found


def _video(shown: Replay, path: Path) -> Path:
    stamp = shown.finished.run.stamp
    rate = 1.0 / float(np.median(np.diff(stamp))) if len(stamp) > 1 else 30.0
    height, width = shown.pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
    if not writer.isOpened():
        raise StudyError(f"cannot write the video {path}")
    for picture in shown.pictures:
        writer.write(np.ascontiguousarray(picture[..., ::-1]))
    writer.release()
    return path
