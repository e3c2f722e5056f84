"""A study carried out from Python."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from . import engine
from .pools import DaskPool, InProcessPool
from .progress import Progress
from .results import Results
from .study import Study
from .study_folder import StudyFolder


def run_study(
    study: Study | Mapping[str, Any] | str | Path, folder: str | Path, workers: int = 1
) -> Results:
    """Carry out the runs of a study that its folder does not hold yet, and return all results.

    The results do not depend on the number of workers, nor on interruptions: the same call
    continues a study that was interrupted.

    Args:
        study: itself, its keys with values, or the path of its YAML file.
        folder: where the results are kept; new, or of the same study.
        workers: processes of this machine; 1: this process; 0: one a core.

    Returns:
        One row a run, with its settings, outcome, verdict and metrics.

    Raises:
        StudyError: the study cannot be run as it is written, the folder holds another one, or one
            that was started with other code.
    """
    if not isinstance(study, Study):
        mapping = isinstance(study, Mapping)
        study = Study.from_mapping(study) if mapping else Study.from_yaml(study)
    engine.check_study(study)
    text = yaml.safe_dump(study.to_mapping(), sort_keys=False)
    kept = StudyFolder.create(Path(folder), study, text)
    kept.check_code()
    with kept.lock():
        done = kept.count_stored_runs()
        if done < study.run_count:
            progress = Progress(study.run_count, done)
            workers = workers or os.cpu_count() or 1
            try:
                with InProcessPool() if workers == 1 else DaskPool(workers) as pool:
                    engine.carry_out(kept, pool, progress)
            finally:
                progress.close()
        else:
            kept.finish()
    return Results.from_folder(kept)
