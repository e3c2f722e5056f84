"""Folders of studies whose rows are made up."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from aras_visual_servo_bench.metrics.metric import metric
from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_folder import StudyFolder


@metric("", "smaller", "these tests")
def hanging(finished):
    """Never comes back at a gain of 2."""
    time.sleep(1e6 if finished.experiment.gain == 2.0 else 0.0)
    return 0.0


def write_study(path: Path, study: Study, make: Callable[[Study, int], dict[str, Any]],
                missing: tuple[int, ...] = (), **times: Any) -> Path:  # fmt: skip
    """Store a study, all but some chunks; make: values of the row of a run. Return the folder.

    times: of each run in place of 1 s, a function of its number for each.
    """
    folder = StudyFolder.create(path, study, yaml.safe_dump(study.to_mapping()))
    for chunk in set(folder.find_missing_chunks()) - set(missing):
        runs = study.list_chunk_runs(chunk)
        made = [{**rows.make_blank_row(study, run), **make(study, run)} for run in runs]
        took = [{"run": run, "wall": 1.0, "processor": 1.0, "worker": "w",
                 **{name: value(run) for name, value in times.items()}} for run in runs]
        folder.write_chunk(chunk, rows.RunRows(
            [{**row, "outcome": row["outcome"] or "refused"} for row in made], took))
    return path
