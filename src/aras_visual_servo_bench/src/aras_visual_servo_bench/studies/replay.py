"""One run of a study again, with its pictures, for a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ExperimentError, StudyError
from ..experiment.experiment import Experiment
from ..recording.film import make_image, with_images
from ..recording.run import Run
from ..runner.loop import Loop
from ..setup.assembly import assemble
from . import rows
from .study_folder import StudyFolder
from .versions import read_commit, read_versions


def replay(
    folder: StudyFolder, number: int, name: str = ""
) -> tuple[Run, dict[str, tuple[Any, Any]]]:
    """Carry a run out once more, with its pictures, for a report.

    Returns:
        The run, and what is not as it was recorded, old and new by column: notes tell it as well.

    Raises:
        StudyError: there is no such run, or it cannot be run.
    """
    study = folder.study
    if not 0 <= number < study.run_count:
        raise StudyError(
            f"there is no run {number}: {folder.path} has runs 0 to {study.run_count - 1}"
        )
    try:
        run = run_with_all_images(study.make_experiment(number))
        now = {**rows.make_blank_row(study, number), **rows.make_result_columns(study, run)}
    except ExperimentError as error:
        raise StudyError(f"run {number}: {error}") from error
    except Exception as error:  # its outcome was a fault, in a user's code most often
        raise StudyError(f"run {number}: {type(error).__name__}: {error}") from error
    recorded = _read_stored_row(folder, number)
    changed = {
        key: (recorded[key], value) for key, value in now.items()
        if key in recorded and recorded[key] != value
        and not (recorded[key] != recorded[key] and value != value)
    }  # fmt: skip
    run = _prepare_for_report(
        run, name or f"run {number}", f"run {number} of the study {folder.path}"
    )
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
    return _prepare_for_report(run_with_all_images(Experiment.load(experiment)), name, source)


def run_with_all_images(experiment: Experiment) -> Run:
    """A run with rgb of every image that was answered."""
    parts = assemble(experiment)
    pictures: list[tuple[float, np.ndarray]] = []
    loop = Loop(experiment, parts, records_films=True)
    try:
        while not loop.is_over:
            before = loop.reading
            loop.run_to_image()
            if loop.reading is not None and loop.reading is not before:
                seen = make_image(loop.reading, loop.plant.camera)
                pictures.append((loop.reading.stamp, seen))
        run = with_images(loop.make_run(), pictures)
        run.joint_origins = loop.plant.joint_origins(run.measured_positions)
        return run
    finally:
        loop.close()


def _prepare_for_report(run: Run, name: str, source: str) -> Run:
    return replace(
        run, name=name, source=source, versions={**read_versions(), "code": read_commit()}
    )


def _read_stored_row(folder: StudyFolder, run: int) -> dict[str, Any]:
    """The row that was kept, without what only tells of the code; empty where it was not run."""
    if not folder.find_part(run // folder.study.chunk_size).exists():
        return {}
    table = folder.read_results()
    kept = table.filter(np.array(table["run"]) == run).to_pylist()
    return {k: v for k, v in kept[0].items() if k not in (*rows.LABEL_COLUMNS, "simulated", "seed")}
