"""One run of a study again, with its pictures, for a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..asked.experiment import Experiment
from ..errors import ExperimentError, StudyError
from ..recording.film import picture_of, with_pictures
from ..recording.run import Run
from ..running.loop import Loop
from ..setup.assembly import assemble
from . import rows
from .folder import Folder
from .versions import code, versions


def replay(
    folder: Folder, number: int, name: str = ""
) -> tuple[Run, dict[str, tuple[Any, Any]]]:
    """Carry a run out once more, with its pictures, for a report.

    Returns:
        The run, and what is not as it was recorded, old and new by column: notes tell it as well.

    Raises:
        StudyError: there is no such run, or it cannot be run.
    """
    study = folder.study
    if not 0 <= number < study.runs:
        raise StudyError(f"there is no run {number}: {folder.path} has runs 0 to {study.runs - 1}")
    try:
        run = with_all_pictures(study.experiment_of(number))
        now = {**rows.blank(study, number), **rows.told(study, run)}
    except ExperimentError as error:
        raise StudyError(f"run {number}: {error}") from error
    except Exception as error:  # its outcome was a fault, in a user's code most often
        raise StudyError(f"run {number}: {type(error).__name__}: {error}") from error
    recorded = _recorded(folder, number)
    changed = {
        key: (recorded[key], value) for key, value in now.items()
        if key in recorded and recorded[key] != value
        and not (recorded[key] != recorded[key] and value != value)
    }  # fmt: skip
    run = _for_report(run, name or f"run {number}", f"run {number} of the study {folder.path}")
    run.notes += [
        f"not as it was recorded: {key} was {old}, is {new}"
        for key, (old, new) in changed.items()
    ]
    return run, changed


def run_with_images(
    experiment: Experiment | Mapping[str, Any] | str | Path, name: str = "run", source: str = ""
) -> Run:
    """Run an experiment and keep every image that the loop answered, for a report.

    `run` computes the same numbers faster and keeps no images.

    Args:
        experiment: itself, its keys with values, or the path of its YAML file.
        name: of the run in legends.
        source: where the experiment is from, as text for the report.

    Raises:
        ExperimentError: it cannot be run. A failure during the run is an outcome.
    """
    return _for_report(with_all_pictures(Experiment.of(experiment)), name, source)


def with_all_pictures(experiment: Experiment) -> Run:
    """A run with rgb of every image that was answered."""
    parts = assemble(experiment)
    pictures: list[tuple[float, np.ndarray]] = []
    loop = Loop(experiment, parts, filmed=True)
    try:
        while not loop.over:
            before = loop.reading
            loop.to_image()
            if loop.reading is not None and loop.reading is not before:
                seen = picture_of(loop.reading, loop.plant.camera)
                pictures.append((loop.reading.stamp, seen))
        run = with_pictures(loop.result(), pictures)
        run.arm_places = loop.plant.places(run.measured)
        return run
    finally:
        loop.close()


def _for_report(run: Run, name: str, source: str) -> Run:
    return replace(run, name=name, source=source, versions={**versions(), "code": code()})


def _recorded(folder: Folder, run: int) -> dict[str, Any]:
    """The row that was kept, without what only tells of the code; empty where it was not run."""
    if not folder.part(run // folder.study.chunk_size).exists():
        return {}
    table = folder.results()
    kept = table.filter(np.array(table["run"]) == run).to_pylist()
    return {k: v for k, v in kept[0].items() if k not in (*rows.LABELS, "simulated", "seed")}
