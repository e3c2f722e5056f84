"""Carries out what of a study is missing: chunks go out in a sliding window, parts come in."""

from __future__ import annotations

import json
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from ..errors import ExperimentError, StudyError
from ..metrics.metrics import success
from ..setup.assembly import check
from . import images, rows
from .pools import Pool
from .progress import Progress, format_count, format_duration
from .study import Study
from .study_folder import StudyFolder
from .work import StudyTask

SHOWN_RUNS = 3  # runs that a dry run shows
MAX_TRIALS = 200  # values of a grid that are tried before the first run, spread over all


@dataclass(frozen=True)
class StudySummary:
    """What has come of it. runs: kept now, of all. failed: of those done now, without success.

    stopped: the row of the run that stopped it; None where it was not.
    """

    runs: int
    failed: int
    stopped: dict[str, Any] | None
    seconds: float


def check_study(study: Study) -> None:
    """Try every value that the study names, without running: StudyError naming what is wrong."""
    images.check_images(study)
    trials = study.make_trials()
    for experiment in trials[:: max(len(trials) // MAX_TRIALS, 1)]:
        try:
            check(experiment)
        except ExperimentError as error:
            raise StudyError(str(error)) from error


def is_success(values: dict[str, object], judged: str = success.name) -> bool:
    """Whether a row's run did what it was to do, by the metric that judges it."""
    return values.get(judged, 1.0) == 1.0 and values["outcome"] not in (
        rows.REFUSED, rows.FAULT, rows.DIED, rows.LATE,
    )  # fmt: skip


def carry_out(
    folder: StudyFolder,
    pool: Pool,
    progress: Progress,
    fail_fast: bool = False,
    can_mix_code: bool = False,
) -> StudySummary:
    """Run what is missing.

    Args:
        fail_fast: send nothing more once a run did not succeed.
        mix: the study may have been begun with other code.

    Raises:
        StudyError: the workers are gone, or what they gave cannot be written. What was done
            before is kept.
    """
    began = time.monotonic()
    study = folder.study
    text = json.dumps(study.to_mapping())
    known = None if can_mix_code else tuple(folder.manifest["versions"].items())
    todo = deque(folder.find_missing_chunks())
    out = failed = 0
    stopped = None
    while todo or out:
        while todo and not stopped and pool.has_room:
            pool.submit(StudyTask(text, todo.popleft(), versions=known))
            out += 1
        if not out:
            break
        task, done = pool.wait_for_chunk()
        if done is None:  # its worker died: once more, run by run
            pool.submit(task)
            continue
        out -= 1
        folder.write_chunk(task.chunk, done)
        bad = [values for values in done.values if not is_success(values, study.judged)]
        failed += len(bad)
        progress.add_runs(len(done.values), len(bad), done.times, pool.workers)
        if fail_fast and bad:
            stopped = stopped or bad[0]
    if not todo:
        folder.finish()
    left = sum(len(study.list_chunk_runs(chunk)) for chunk in todo)
    return StudySummary(study.run_count - left, failed, stopped, time.monotonic() - began)


def dry_run(study: Study, workers: int) -> list[str]:
    """What would be done, in lines: how many runs, how long, and the first of them."""
    tried = [rows.compute_row(study, 0) for _ in range(2)]  # the first loads things
    timed = [one.times[0]["wall"] for one in tried]
    seconds = min(timed) * study.run_count / max(workers, 1)
    lines = [
        f"{format_count(study.run_count, 'run')}: {format_count(study.point_count, 'point')}, "
        f"{study.repeats} of each; "
        f"{format_count(study.chunk_count, 'chunk')} of {study.chunk_size}",
        f"about {format_duration(seconds)} on {workers} core{'s' if workers > 1 else ''}: a run "
        "takes "
        f"{min(timed):.2g} s here",
    ]
    for run in range(min(SHOWN_RUNS, study.run_count)):
        told = ", ".join(f"{k}={v}" for k, v in study.make_settings(run // study.repeats).items())
        lines.append(f"run {run}: {told or 'as it is'}; seed {study.compute_seed(run)}")
    first = tried[-1].values[0]
    if first["outcome"] in (rows.REFUSED, rows.FAULT):  # its time says nothing of the others'
        lines.append(f"run 0 as tried: {first['outcome']}: {first['reason']}")
    return lines
