"""Repeat runs and store all of their images, for reports."""

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
from . import run_rows
from .columns import LABEL_COLUMNS
from .study_folder import StudyFolder
from .versions import read_commit, read_versions


def replay(
    folder: StudyFolder, number: int, name: str = ""
) -> tuple[Run, dict[str, tuple[Any, Any]]]:
    """Repeat a run of a study and store all of its images, for a report.

    Args:
        folder: folder of the study.
        number: number of the run.
        name: name of the run in legends; '': its number.

    Returns:
        The run, and for each column that differs from the stored results, the old and the new
        value. The notes of the run contain these differences, too.

    Raises:
        StudyError: there is no such run, or it cannot be repeated.
    """
    study = folder.study
    if not 0 <= number < study.run_count:
        raise StudyError(
            f"there is no run {number}: {folder.path} has runs 0 to {study.run_count - 1}"
        )
    try:
        run = run_with_all_images(study.make_experiment(number))
        new = {**run_rows.make_blank_row(study, number), **run_rows.make_result_columns(study, run)}
    except ExperimentError as error:
        raise StudyError(f"run {number}: {error}") from error
    except Exception as error:  # an unexpected exception, usually from the user's scheme or metric
        raise StudyError(f"run {number}: {type(error).__name__}: {error}") from error
    stored = _read_stored_row(folder, number)
    changed = {
        key: (stored[key], value) for key, value in new.items()
        if key in stored and stored[key] != value
        and not (stored[key] != stored[key] and value != value)
    }  # fmt: skip
    run = _prepare_for_report(
        run, name or f"run {number}", f"run {number} of the study {folder.path}"
    )
    run.notes += [
        f"differs from the stored result: {key} was {old}, is {new}"
        for key, (old, new) in changed.items()
    ]
    return run, changed


def run_with_images(
    experiment: Experiment | Mapping[str, Any] | str | Path, name: str = "run", source: str = ""
) -> Run:
    """Run an experiment and store every image that the loop processes, for a report.

    `run` computes the same numbers faster, but stores no images.

    Args:
        experiment: an Experiment, a mapping of its keys, or the path of its YAML file.
        name: name of the run in legends.
        source: origin of the experiment, as text for the report.

    Raises:
        ExperimentError: the experiment cannot be run. A failure during the run is an outcome.
    """
    return _prepare_for_report(run_with_all_images(Experiment.load(experiment)), name, source)


def run_with_all_images(experiment: Experiment) -> Run:
    """Run an experiment and store every image that the loop processes, in RGB."""
    parts = assemble(experiment)
    images: list[tuple[float, np.ndarray]] = []
    loop = Loop(experiment, parts, records_films=True)
    try:
        while not loop.is_over:
            before = loop.reading
            loop.run_to_image()
            if loop.reading is not None and loop.reading is not before:
                image = make_image(loop.reading, loop.plant.camera)
                images.append((loop.reading.stamp, image))
        run = with_images(loop.make_run(), images)
        run.joint_origins = loop.plant.joint_origins(run.measured_positions)
        return run
    finally:
        loop.close()


def _prepare_for_report(run: Run, name: str, source: str) -> Run:
    return replace(
        run, name=name, source=source, versions={**read_versions(), "code": read_commit()}
    )


def _read_stored_row(folder: StudyFolder, run: int) -> dict[str, Any]:
    """Return the stored results of a run by column; {} if the run is not stored.

    The columns that describe the code are omitted."""
    if not folder.find_part(run // folder.study.chunk_size).exists():
        return {}
    table = folder.read_results()
    stored = table.filter(np.array(table["run"]) == run).to_pylist()[0]
    return {k: v for k, v in stored.items() if k not in (*LABEL_COLUMNS, "simulated", "seed")}
