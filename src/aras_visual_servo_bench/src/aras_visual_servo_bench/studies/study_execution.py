"""Run the missing chunks (groups of runs) of a study in a pool of workers, and write their results.
"""

from __future__ import annotations

import contextlib
import io
import json
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from ..errors import ExperimentError, StudyError
from ..metrics.formatting import format_count
from ..metrics.metrics import success
from ..setup.assembly import check
from . import image_table, run_rows
from .chunk_execution import StudyChunk
from .columns import find_column_name
from .pools import Pool
from .study import Study
from .study_folder import StudyFolder
from .study_progress import StudyProgress, format_duration

SHOWN_RUNS = 3  # number of runs whose settings a dry run prints
# approximate number of a study's experiments that are checked before the first run
MAX_TRIALS = 200


@dataclass(frozen=True)
class ExecutionSummary:
    """Result of running a study.

    runs: number of stored runs.
    new_runs: number of these runs that this call computed.
    failed: number of new runs without success.
    stopped: row of the failed run that stopped the study; None if the study was not stopped.
    seconds: wall time of this call, s.
    """

    runs: int
    new_runs: int
    failed: int
    stopped: dict[str, Any] | None
    seconds: float


def check_study(study: Study) -> None:
    """Check the values of a study without running it.

    Raises:
        StudyError: a value is wrong, or a combination of values is not possible.
    """
    image_table.check_images(study)
    trials = study.make_trials()
    for experiment in trials[:: max(len(trials) // MAX_TRIALS, 1)]:
        try:
            check(experiment)
        except ExperimentError as error:
            raise StudyError(str(error)) from error


def is_success(values: dict[str, object], judged: str = success.name) -> bool:
    """Return True if a run was a success.

    Args:
        values: row of the results.
        judged: name of the metric that is 1 for a success.
    """
    return (
        values.get(find_column_name(judged), 1.0) == 1.0
        and values["outcome"] not in run_rows.FAILURES
    )


def run_in_folder(
    study: Study, path: Path, make_pool: Callable[[], AbstractContextManager[Pool]],
    out: TextIO | None,
) -> StudyFolder:  # fmt: skip
    """Run the missing runs of a study in a folder, which is created if necessary.

    Args:
        study: settings of the study.
        path: folder of the study.
        make_pool: function that makes the workers; it is called only if a run is missing.
        out: stream of the progress bar; None: no bar.

    Raises:
        StudyError: the folder contains another study or was written with other code, the workers
            are lost, or results cannot be written.
    """
    folder = StudyFolder.create(path, study)
    folder.check_code()
    with folder.lock():
        run_missing(folder, make_pool, out)
    return folder


def run_missing(
    folder: StudyFolder,
    make_pool: Callable[[], AbstractContextManager[Pool]],
    out: TextIO | None,
    fail_fast: bool = False,
    can_mix_code: bool = False,
) -> ExecutionSummary:
    """Run the missing chunks (groups of runs) of a study, and write their results to its folder.

    The caller holds the folder's lock.

    Args:
        folder: folder of the study.
        make_pool: function that makes the workers; it is called only if a run is missing.
        out: stream of the progress bar; None: no bar.
        fail_fast: whether to start no more chunks after a run without success.
        can_mix_code: whether to continue a study that was started with a different version of the
            code.

    Raises:
        StudyError: the connection to the workers is lost, or results cannot be written. Results
            that have already been written remain valid.
    """
    study = folder.study
    todo = deque(folder.find_missing_chunks())
    if not todo:
        folder.finish()
        return ExecutionSummary(study.run_count, 0, 0, None, 0.0)
    stored = study.run_count - study.count_runs(todo)
    text = json.dumps(study.to_mapping())
    known = None if can_mix_code else tuple(folder.manifest["versions"].items())
    progress = StudyProgress(study.run_count, stored, out or io.StringIO())
    running = failed = 0
    stopped = None
    with make_pool() as pool, contextlib.closing(progress):
        start = time.monotonic()
        while todo or running:
            while todo and not stopped and pool.has_room:
                pool.submit(StudyChunk(text, todo.popleft(), versions=known))
                running += 1
            if not running:
                break
            task, chunk_rows = pool.wait_for_chunk()
            # the worker has died, so the pool repeats this chunk in child processes
            if chunk_rows is None:
                pool.submit(task)
                continue
            running -= 1
            folder.write_chunk(task.chunk, chunk_rows)
            bad = [values for values in chunk_rows.values if not is_success(values, study.judged)]
            failed += len(bad)
            progress.add_runs(len(chunk_rows.values), len(bad), chunk_rows.times, pool.workers)
            if fail_fast and bad:
                stopped = stopped or bad[0]
    if not todo:
        folder.finish()
    runs = study.run_count - study.count_runs(todo)
    return ExecutionSummary(runs, runs - stored, failed, stopped, time.monotonic() - start)


def dry_run(study: Study, workers: int) -> list[str]:
    """Return lines that describe a study: number of runs, estimated time, settings of some runs.

    workers: number of parallel workers on which the estimated time is based.
    """
    # The first computation of run 0 also loads libraries, so the shorter of two times is used.
    tried = [run_rows.compute_row(study, 0) for _ in range(2)]
    wall_times = [one.times[0]["wall"] for one in tried]
    seconds = min(wall_times) * study.run_count / max(workers, 1)
    lines = [
        f"{format_count(study.run_count, 'run')}: {format_count(study.point_count, 'point')}, "
        f"{study.repeats} of each; "
        f"{format_count(study.chunk_count, 'chunk')} of {study.chunk_size}",
        f"about {format_duration(seconds)} on {workers} core{'s' if workers > 1 else ''}: a run "
        f"takes {min(wall_times):.2g} s here",
    ]
    for run in range(min(SHOWN_RUNS, study.run_count)):
        settings = study.make_settings(run // study.repeats)
        text = ", ".join(f"{k}={v}" for k, v in settings.items())
        lines.append(f"run {run}: {text or 'base experiment'}; seed {study.compute_seed(run)}")
    first = tried[-1].values[0]
    # run 0 ended early, so its time is no estimate of the study's time
    if first["outcome"] in (run_rows.REFUSED, run_rows.FAULT):
        lines.append(f"run 0 as tried: {first['outcome']}: {first['reason']}")
    return lines
