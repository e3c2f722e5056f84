"""A run as a row: what was set, how it went, its metrics; and a chunk of rows as a table."""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from aras_visual_servo_base.memory import release_freed_memory

from ..asked.experiment import Experiment
from ..errors import ExperimentError
from ..numbers import metrics as known_metrics
from ..recording.run import Run
from ..running.loop import NS, Loop
from ..setup.assembly import assemble
from . import images
from .study import Study
from .variations import Axis, Draw

# Outcomes that are no loop's: a run whose values do not go together, one that raised, one that
# ended its process, one that took too long.
REFUSED, FAULT, DIED, LATE = "refused", "fault", "process_died", "time_limit"
LONGEST_REASON = 500
FIXED = {
    "run": pa.int64(), "point": pa.int64(), "repeat": pa.int64(), "seed": pa.int64(),
    "outcome": pa.string(), "verdict": pa.string(), "reason": pa.string(), "remedy": pa.string(),
    "images": pa.int64(), "simulated": pa.float64(),
}  # fmt: skip
LABELS = ("code", "versions")  # the same in all rows of a study
TIMES = pa.schema([
    ("run", pa.int64()), ("wall", pa.float64()), ("processor", pa.float64()),
    ("worker", pa.string()),
])  # fmt: skip


@dataclass
class Rows:
    """Rows of some runs: results by column, wall times apart, and images if they are kept."""

    values: list[dict[str, Any]] = field(default_factory=list)
    times: list[dict[str, Any]] = field(default_factory=list)
    images: list[dict[str, Any]] = field(default_factory=list)

    def add(self, other: Rows) -> None:
        """The rows of another behind these."""
        self.values += other.values
        self.times += other.times
        self.images += other.images


def row_of(study: Study, run: int, worker: str = "") -> Rows:
    """Carry out one run. Whatever goes wrong is its outcome; only the process's end is not seen."""
    began, used = time.perf_counter(), time.process_time()
    values = blank(study, run)
    kept: list[dict[str, Any]] = []
    try:
        experiment = study.experiment_of(run)
        with limited(study.limit):
            values |= _finished(study, experiment, run, kept)
    except OverTime:
        values |= over_time(study)
        kept = []
    except ExperimentError as error:
        values |= {"outcome": REFUSED, "reason": _line(error)}
    except Exception as error:  # a fault of the code, or of a user's: the other runs go on
        values |= {"outcome": FAULT, "reason": _line(f"{type(error).__name__}: {error}")}
    release_freed_memory()
    times = {
        "run": run, "wall": time.perf_counter() - began,
        "processor": time.process_time() - used, "worker": worker,
    }  # fmt: skip
    return Rows([values], [times], kept)


class OverTime(BaseException):
    """A run takes longer than it may; no Exception, so that no scheme's own handler takes it."""


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise OverTime in what takes longer (s of wall time).

    Signals come to a process's main thread alone: in a worker of Dask, which runs chunks in
    another thread, the process is ended; the chunk is then repeated, each run in a child process.
    """
    if threading.current_thread() is not threading.main_thread():
        with open(os.devnull, "w", encoding="utf-8") as nowhere:
            faulthandler.dump_traceback_later(seconds, exit=True, file=nowhere)
            try:
                yield
            finally:
                faulthandler.cancel_dump_traceback_later()
        return

    def over(number: int, frame: object) -> None:
        raise OverTime

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def over_time(study: Study) -> dict[str, Any]:
    """What is told of a run that took too long."""
    return {
        "outcome": LATE, "reason": f"not done after {study.limit:g} s of wall time",
        "remedy": "look for what hangs, or give the study a greater limit",
    }  # fmt: skip


def blank(study: Study, run: int) -> dict[str, Any]:
    """A row before anything is known of how it goes."""
    point, repeat = divmod(run, study.repeats)
    return {
        "run": run, "point": point, "repeat": repeat, "seed": study.seed_of(run),
        **{key: _cell(value) for key, value in study.settings(point).items() if key != "seed"},
        "outcome": "", "verdict": "", "reason": "", "remedy": "", "images": 0, "simulated": 0.0,
        **{column(name): float("nan") for name in study.metric_names},
    }  # fmt: skip


def _finished(
    study: Study, experiment: Experiment, run: int, kept: list[dict[str, Any]]
) -> dict[str, Any]:
    pictured = study.pictures != "none"
    seen = images.Keeper(pictured)
    parts = assemble(experiment, watched=pictured, depth=study.depth)
    loop = Loop(experiment, parts, watch=seen.add if study.keeps_images else None)
    try:
        if study.pictures == "first":
            loop.to_image()
        else:
            loop.to_end()
        result, simulated = loop.result(), loop.plant.time_ns / NS
        if study.keeps_images:
            kept += seen.rows(run, result, simulated)
    finally:
        loop.close()
    return {"seed": experiment.seed, "simulated": simulated, **told(study, result)}


def told(study: Study, run: Run) -> dict[str, Any]:
    """How a run went, by column."""
    return {
        "outcome": run.outcome,
        "verdict": run.verdict.word,
        "reason": _line(run.reason),
        "remedy": _line(run.remedy),
        "images": len(run.stamp),
        **{column(name): float(known_metrics.find(name).measure(run))
           for name in study.metric_names},
    }  # fmt: skip


def column(metric: str) -> str:
    """The column of a metric that is given by name or as 'package.module:function'."""
    return metric.rpartition(":")[2]


def schema(study: Study, labels: Mapping[str, str]) -> pa.Schema:
    """Columns of the results and their types, the same for all parts of a study."""
    fixed = list(FIXED.items())
    parameters = [(key, _type(study, key)) for key in study.keys if key != "seed"]
    measured = [(column(name), pa.float64()) for name in study.metric_names]
    # The same word in every row takes no room as a dictionary of one.
    words = [(name, pa.dictionary(pa.int32(), pa.string())) for name in labels]
    return pa.schema([*fixed[:4], *parameters, *fixed[4:], *measured, *words])


def table(study: Study, rows: Sequence[Mapping[str, Any]], labels: Mapping[str, str]) -> pa.Table:
    """Rows as a table."""
    wanted = schema(study, labels)
    columns = []
    for column_field in wanted:
        name = column_field.name
        given = [labels[name] if name in labels else row.get(name) for row in rows]
        columns.append(pa.array(given, type=column_field.type))
    return pa.Table.from_arrays(columns, schema=wanted)


def _type(study: Study, key: str) -> pa.DataType:
    if key in study.case_axes:
        return pa.string()
    values: list[Any] = [case.set[key] for case in study.combinations if key in case.set]
    for varied in (*study.axes, *study.draws):
        if varied.key == key:
            values += _values(varied)
    cells = [_cell(value) for value in values if value is not None]
    for kinds, kind in (((bool,), pa.bool_()), ((int,), pa.int64()), ((int, float), pa.float64())):
        if all(isinstance(c, kinds) and (kinds == (bool,)) >= isinstance(c, bool) for c in cells):
            return kind
    return pa.string()


def _values(varied: Axis | Draw) -> tuple[Any, ...]:
    return varied.values if isinstance(varied, Axis) else (*varied.ends, varied.value(0.4))


def _cell(value: Any) -> Any:
    """A value that a column can hold: numbers and words as they are, the rest as JSON."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    return json.dumps(value, sort_keys=True, default=dict)


def _line(text: object) -> str:
    return " ".join(str(text).split())[:LONGEST_REASON]
