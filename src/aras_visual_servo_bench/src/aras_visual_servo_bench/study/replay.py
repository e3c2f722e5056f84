"""One run of a study again, with its pictures: a report and a video."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from .. import cameras
from ..assembly import assemble
from ..errors import ExperimentError, StudyError
from ..plants import CameraReading
from ..report import plots
from ..report.recording import Images, MomentsTrack, Recording, States
from ..run import Run
from ..runner import Loop
from . import metrics as known_metrics
from . import rows
from .folder import Folder
from .metrics import Finished
from .tables import number


@dataclass(frozen=True)
class Replay:
    """The run again. pictures: rgb (rows, columns, 3) of every image. changed: what is not as it
    was recorded, by column."""

    number: int
    finished: Finished
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
    pictures: list[np.ndarray] = []
    try:
        experiment = study.experiment_of(run)
        parts = assemble(experiment)
    except ExperimentError as error:
        raise StudyError(f"run {run}: {error}") from error
    loop = Loop(experiment, parts)
    try:
        while not loop.over:
            before = loop.reading
            loop.to_image()
            if loop.reading is not None and loop.reading is not before:
                pictures.append(_picture(loop.reading, loop))
        finished = Finished(experiment, parts, loop.result())
    finally:
        loop.close()
    now = _row(folder, run, finished)
    recorded = _recorded(folder, run)
    changed = {
        key: (recorded[key], value) for key, value in now.items()
        if key in recorded and recorded[key] != value
        and not (recorded[key] != recorded[key] and value != value)
    }  # fmt: skip
    return Replay(run, finished, pictures, now, changed)


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
    """report.md with its plots, summary.json and video.mp4; StudyError where it cannot."""
    result = shown.finished.run
    recording = recorded(result, shown.finished.parts.plant.camera, shown.pictures)
    drawings: dict[str, Callable[[], Figure]] = {}
    if len(result.stamp) > 1 and result.names:
        drawings = {
            "feature_errors": lambda: plots.feature_errors(recording),
            "camera_twist": lambda: plots.camera_twist(recording),
            "joint_positions": lambda: plots.joint_positions(recording),
        }
        if shown.finished.experiment.target.shape == "aras":
            drawings["camera_path"] = lambda: plots.camera_path(recording, result.goal_pose)
    try:
        out.mkdir(parents=True, exist_ok=True)
        written = plots.write_images(recording, out)
        with plt.rc_context(plots.STYLE):
            for name, draw in drawings.items():
                figure = draw()
                written.append(out / f"{name}.png")
                figure.savefig(written[-1])
                plt.close(figure)
        if shown.pictures:
            written.append(_video(shown, out / "video.mp4"))
        (out / "summary.json").write_text(json.dumps(shown.row, indent=1) + "\n")
        (out / "report.md").write_text(_report(shown, written), encoding="utf-8")
    except OSError as error:
        raise StudyError(f"cannot write into {out}: {error.strerror or error}") from None
    return [out / "report.md", out / "summary.json", *written]


def recorded(result: Run, camera: Any, pictures: list[np.ndarray]) -> Recording:
    """A run of the runner's as the report's plots take it."""
    sent = np.searchsorted(result.joint_stamp, result.stamp).clip(max=len(result.joint_stamp) - 1)
    states = States(
        result.stamp, list(result.phases), list(result.reasons), result.names, result.features,
        result.desired, result.error, result.asked, result.joint_names, result.commanded[sent],
        result.smallest[:, None],
    )  # fmt: skip
    images = Images(
        result.stamp, result.stamp, pictures[0] if pictures else None,
        pictures[-1] if pictures else None, camera,
    )  # fmt: skip
    none = MomentsTrack(np.zeros(0), 3, np.zeros((0, 0)), np.zeros((0, 0)))
    return Recording(
        states, result.joint_stamp, result.measured, result.joint_stamp, result.true_pose, images,
        none, result.outcome, result.reason, result.mend,
    )  # fmt: skip


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


def _report(shown: Replay, written: list[Path]) -> str:
    result = shown.finished.run
    lines = [f"# Run {shown.number}", "", f"{result.outcome}, {result.verdict.word}"]
    lines[-1] += f": {result.reason}" if result.reason else ""
    if shown.changed:
        lines += ["", "Not as it was recorded: " + "; ".join(
            f"{key} was {old}, is {new}" for key, (old, new) in shown.changed.items())]  # fmt: skip
    lines += ["", "| metric | value | unit | what | source |", "|---|---|---|---|---|"]
    for name in [key for key in shown.row if key in known_metrics.BUILT_IN]:
        m = known_metrics.BUILT_IN[name]
        lines.append(f"| {name} | {number(shown.row[name])} | {m.unit} | {m.text} | {m.source} |")
    lines.append("")
    for path in written:
        mark = "!" if path.suffix == ".png" else ""
        lines.append(f"{mark}[{path.stem.replace('_', ' ')}]({path.name})\n")
    return "\n".join(lines)
