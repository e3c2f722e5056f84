"""Run a study from Python."""

from __future__ import annotations

import dataclasses
import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import StudyError
from . import study_execution
from .dask_pool import DaskPool
from .pools import InProcessPool
from .results import Results
from .study import Study


def run_study(
    study: Study | Mapping[str, Any] | str | Path, folder: str | Path | None = None,
    workers: int = 1, progress: bool = True,
) -> Results:  # fmt: skip
    """Run the missing runs of a study, and return the results of all runs.

    The results do not depend on the number of workers. If a study was interrupted, the same call
    continues it, and the results are the same as without interruption.

    Args:
        study: a Study, a mapping of its keys, or the path of its YAML file.
        folder: folder for the results: a new folder, or the folder of the same study; None: the
            results are returned without being stored.
        workers: number of worker processes on this machine; 1: run in this process; 0: one per
            core.
        progress: whether to show a progress bar on the standard error.

    Returns:
        One row per run, with its settings, outcome, verdict and metrics.

    Raises:
        StudyError: a setting of the study is wrong; no folder is given although the study stores
            images or traces; the folder contains another study; or the study was started with a
            different version of the code.
    """
    if not isinstance(study, Study):
        mapping = isinstance(study, Mapping)
        study = Study.from_mapping(study) if mapping else Study.from_yaml(study)
    if folder is None:
        if study.has_image_rows:
            raise StudyError("traces and images must be stored: give a folder")
        with tempfile.TemporaryDirectory(prefix="study_") as temporary_folder:
            results = run_study(study, temporary_folder, workers, progress)
            return dataclasses.replace(results, name="study")
    study_execution.check_study(study)
    workers = workers or os.cpu_count() or 1
    return Results.from_folder(study_execution.run_in_folder(
        study, Path(folder), lambda: InProcessPool() if workers == 1 else DaskPool(workers),
        sys.stderr if progress else None,
    ))  # fmt: skip
