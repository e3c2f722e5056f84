"""Rows of the results: a row contains the settings, outcome and metrics of a run."""

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

from aras_visual_servo_base.errors import NumbaUnavailableError
from aras_visual_servo_base.memory import release_freed_memory
from aras_visual_servo_controller.observation.frame import NANOSECONDS

from ..errors import ExperimentError, StudyError
from ..experiment.experiment import Experiment
from ..metrics import metrics as known_metrics
from ..recording.run import Run
from ..runner.loop import Loop
from ..setup.assembly import assemble
from . import image_table
from .columns import FIXED_COLUMNS, find_column_name
from .study import Study

# Outcomes that do not come from the control loop: the settings were refused, an error was raised,
# the process of the run died, the run exceeded its time limit.
REFUSED, FAULT, DIED, LATE = FAILURES = "refused", "fault", "process_died", "time_limit"
MAX_REASON_LENGTH = 500
TIMES_SCHEMA = pa.schema([
    ("run", pa.int64()), ("wall", pa.float64()), ("processor", pa.float64()),
    ("worker", pa.string()),
])  # fmt: skip


@dataclass
class RunRows:
    """Rows of several runs, for three tables: results, wall times and images."""

    values: list[dict[str, Any]] = field(default_factory=list)
    times: list[dict[str, Any]] = field(default_factory=list)
    images: list[dict[str, Any]] = field(default_factory=list)

    def add(self, other: RunRows) -> None:
        """Append the rows of another Rows object."""
        self.values += other.values
        self.times += other.times
        self.images += other.images


def compute_row(study: Study, run: int, worker: str = "") -> RunRows:
    """Execute one run of a study and return its rows.

    An error or a timeout is returned as the outcome of the run.

    Args:
        study: settings of the study.
        run: number of the run.
        worker: name of this process, for the table of wall times.

    Raises:
        StudyError: Numba cannot be imported, so no run is possible.
    """
    wall_start, processor_start = time.perf_counter(), time.process_time()
    values = make_blank_row(study, run)
    image_rows: list[dict[str, Any]] = []
    try:
        experiment = study.make_experiment(run)
        with limit_time(study.limit):
            values |= _run_experiment(study, experiment, run, image_rows)
    except RunTimeoutError:
        values |= describe_timeout(study)
        image_rows = []
    except NumbaUnavailableError as error:
        raise StudyError(str(error)) from error
    except ExperimentError as error:
        values |= {"outcome": REFUSED, "reason": _to_line(error)}
    except Exception as error:  # a programming error in this project or in the user's code
        values |= {"outcome": FAULT, "reason": _to_line(f"{type(error).__name__}: {error}")}
    release_freed_memory()
    times = {
        "run": run, "wall": time.perf_counter() - wall_start,
        "processor": time.process_time() - processor_start, "worker": worker,
    }  # fmt: skip
    return RunRows([values], [times], image_rows)


class RunTimeoutError(BaseException):
    """Timeout of a run.

    It is a BaseException, so that `except Exception` in a scheme does not catch it."""


@contextlib.contextmanager
def limit_time(seconds: float) -> Iterator[None]:
    """Raise a RunTimeoutError if the `with` block takes longer than `seconds` of wall time.

    In the main thread, a signal raises the error. Other threads, such as the one in which a worker
    of Dask executes runs, do not receive signals. There the timeout ends the process, and its runs
    are repeated, each in a child process.
    """
    if threading.current_thread() is not threading.main_thread():
        with open(os.devnull, "w", encoding="utf-8") as null_file:
            faulthandler.dump_traceback_later(seconds, exit=True, file=null_file)
            try:
                yield
            finally:
                faulthandler.cancel_dump_traceback_later()
        return

    def raise_timeout(number: int, frame: object) -> None:
        raise RunTimeoutError

    previous = signal.signal(signal.SIGALRM, raise_timeout)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)


def describe_timeout(study: Study) -> dict[str, Any]:
    """Return the outcome, reason and remedy of a run that exceeded the time limit."""
    return {
        "outcome": LATE, "reason": f"not finished after {study.limit:g} s of wall time",
        "remedy": "find the code that hangs, or increase `limit` of the study",
    }  # fmt: skip


def make_blank_row(study: Study, run: int) -> dict[str, Any]:
    """Make the row of a run with its settings and without results."""
    point, repeat = divmod(run, study.repeats)
    return {
        "run": run, "point": point, "repeat": repeat, "seed": study.compute_seed(run),
        **{key: _to_cell(value) for key, value in study.make_settings(point).items()
            if key != "seed"},
        "outcome": "", "verdict": "", "reason": "", "remedy": "", "images": 0, "simulated": 0.0,
        "distance_tolerance": float("nan"), "angle_tolerance": float("nan"),
        **{find_column_name(name): float("nan") for name in study.metric_names},
    }  # fmt: skip


def _run_experiment(
    study: Study, experiment: Experiment, run: int, image_rows: list[dict[str, Any]]
) -> dict[str, Any]:
    has_images = study.pictures != "none"
    recorder = image_table.ImageRecorder(has_images)
    parts = assemble(
        experiment, has_unread_cameras=has_images, has_depth=study.depth,
        goal_images=study.goal_images,
    )  # fmt: skip
    loop = Loop(experiment, parts, on_frame=recorder.add_frame if study.has_image_rows else None)
    try:
        if study.pictures == "first":
            loop.run_to_image()
        else:
            loop.run_to_end()
        result, simulated = loop.make_run(), loop.plant.time_ns / NANOSECONDS
        if study.has_image_rows:
            image_rows += recorder.make_rows(run, result, simulated)
    finally:
        loop.close()
    return {"seed": experiment.seed, "simulated": simulated, **make_result_columns(study, result)}


def make_result_columns(study: Study, run: Run) -> dict[str, Any]:
    """Return the results of a run, by column."""
    return {
        "outcome": run.outcome,
        "verdict": run.verdict.name,
        "reason": _to_line(run.reason),
        "remedy": _to_line(run.remedy),
        "images": len(run.stamp),
        "distance_tolerance": run.verdict.tolerance[0],
        "angle_tolerance": run.verdict.tolerance[1],
        **{find_column_name(name): float(known_metrics.find_metric(name).measure(run))
           for name in study.metric_names},
    }  # fmt: skip


def make_schema(study: Study, labels: Mapping[str, str]) -> pa.Schema:
    """Return the names and types of the columns of the results, equal for all files of a study.

    labels: text of each column that has the same value in all rows, by name.
    """
    fixed = list(FIXED_COLUMNS.items())
    parameters = [(key, _find_type(study, key)) for key in study.keys if key != "seed"]
    metrics = [(find_column_name(name), pa.float64()) for name in study.metric_names]
    # A constant column of type `dictionary` stores its text only once.
    constants = [(name, pa.dictionary(pa.int32(), pa.string())) for name in labels]
    return pa.schema([*fixed[:4], *parameters, *fixed[4:], *metrics, *constants])


def make_table(
    study: Study, rows: Sequence[Mapping[str, Any]], labels: Mapping[str, str]
) -> pa.Table:
    """Make a table of the results of several runs, which are given as rows.

    labels: text of each column that has the same value in all rows, by name.
    """
    schema = make_schema(study, labels)
    columns = []
    for column_field in schema:
        name = column_field.name
        values = [labels[name] if name in labels else row.get(name) for row in rows]
        columns.append(pa.array(values, type=column_field.type))
    return pa.Table.from_arrays(columns, schema=schema)


def _find_type(study: Study, key: str) -> pa.DataType:
    if key in study.case_axes:
        return pa.string()
    values: list[Any] = [case.set[key] for case in study.combinations if key in case.set]
    values += [value for axis in study.axes if axis.key == key for value in axis.values]
    for varied in study.random_variations:
        if varied.key == key:
            values += [*varied.ends, varied.value(0.4)]
    cells = [_to_cell(value) for value in values if value is not None]
    for kinds, kind in (((bool,), pa.bool_()), ((int,), pa.int64()), ((int, float), pa.float64())):
        if all(isinstance(c, kinds) and (kinds == (bool,)) >= isinstance(c, bool) for c in cells):
            return kind
    return pa.string()


def _to_cell(value: Any) -> Any:
    """Convert a value for a column of the results; if it is not a number or text, it becomes JSON.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    return json.dumps(value, sort_keys=True, default=dict)


def _to_line(text: object) -> str:
    return " ".join(str(text).split())[:MAX_REASON_LENGTH]
