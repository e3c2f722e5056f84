"""Results of a study, read from its folder: one row per run, and groups of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow.csv import write_csv

from aras_visual_servo_base.lazy_imports import import_later
from aras_visual_servo_base.names import suggest

from ..errors import StudyError, catch_write_errors
from ..experiment.experiment_keys import find_unit
from ..metrics import metrics
from ..metrics.formatting import format_count, format_rows
from ..metrics.metric import GREATER, Metric
from ..metrics.run_tables import import_pandas
from . import run_rows
from . import study_folder as folders
from .columns import LABEL_COLUMNS, find_column_name
from .study import Study
from .study_folder import StudyFolder
from .tolerance import SuccessTolerance, find_tolerance

if TYPE_CHECKING:
    import pandas

SHOWN_ENDS = 4  # largest number of different outcomes that the text of a Results object lists
REAL_TIME_MULTIPLE = Metric(
    "real_time_multiple", "", GREATER,
    "simulated time divided by the worker's wall time; stored in a separate file",
    lambda finished: float("nan"),
)  # fmt: skip


# maximum difference between a value and the published value, relative to the published value
RELATIVE_TOLERANCE = 0.01


def is_met(value: Any, published: Any) -> bool:
    """Return whether a value agrees with a published one by the rules of VariationCase."""
    if value is None or isinstance(value, str) or isinstance(published, str):
        return value == published
    if isinstance(published, list | tuple):
        return published[0] <= value <= published[1]
    if isinstance(published, int):
        return value == published
    return abs(value - published) <= RELATIVE_TOLERANCE * abs(published)


def _add_published(study: Study, table: pa.Table) -> pa.Table:
    """Add a column with the published values of each run, and a column 'met'.

    'met' is True if the run agrees with all of its published values. If the study has no published
    values, no columns are added.
    """
    if not any(case.published for case in study.combinations):
        return table
    texts, met = [], []
    for row in table.to_pylist():
        published = study.find_combination(row["point"]).published
        texts.append(", ".join(f"{key} {value}" for key, value in published.items()))
        met.append(all(is_met(row.get(k), v) for k, v in published.items()) if published else None)
    table = table.append_column("published", pa.array(texts, pa.string()))
    return table.append_column("met", pa.array(met, pa.bool_()))


def _to_numbers(column: pa.ChunkedArray) -> np.ndarray:
    """Convert a column to an array (n,) of float; missing values become NaN."""
    return column.cast(pa.float64()).to_numpy()


@dataclass(frozen=True)
class Results:
    """Results of a study, one row per run, read from its folder.

    Attributes:
        name: name of the folder.
        study: settings of the study.
        table: one row per run, in the order of the run numbers: settings, outcome, verdict and
            metrics.
    """

    name: str
    study: Study
    table: pa.Table

    @classmethod
    def read(cls, path: str | Path) -> Results:
        """Read the finished runs in the folder of a study.

        Raises:
            StudyError: the folder has no study or no finished run.
        """
        return cls.from_folder(StudyFolder.open(path))

    @classmethod
    def from_folder(cls, folder: StudyFolder) -> Results:
        """Read the finished runs of an open folder; see `read`."""
        table, times = folder.read_results(), folder.read_results(folders.TIMES)
        runs, timed = table["run"].to_numpy(), times["run"].to_numpy()
        # The tables of results and of wall times are sorted by run number, so a binary search finds
        # the wall time of a run.
        indices = np.minimum(np.searchsorted(timed, runs), len(timed) - 1)
        wall = np.where(timed[indices] == runs, _to_numbers(times["wall"])[indices], np.nan)
        simulated = _to_numbers(table["simulated"])
        multiple = np.divide(simulated, wall, out=np.full(len(runs), np.nan), where=wall > 0.0)
        table = table.append_column(REAL_TIME_MULTIPLE.name, pa.array(multiple, pa.float64()))
        table = _add_published(folder.study, table)
        return cls(folder.path.resolve().name, folder.study, table)

    def __repr__(self) -> str:
        """Describe the results in at most four lines."""
        count = self.table.num_rows
        ends = pc.value_counts(self.make_end_column()).to_pylist()
        ends.sort(key=lambda end: -end["counts"])
        is_judged = find_column_name(self.study.judged) in self.table.column_names
        success = f", {self.compute_successes().sum():.0f} with success" if is_judged else ""
        shown = [f"{end['values']} ({end['counts']})" for end in ends[:SHOWN_ENDS]]
        if len(ends) > SHOWN_ENDS:
            shown.append(f"{len(ends) - SHOWN_ENDS} others")
        return format_rows({
            f"Results of {self.name}": f"{count} of {format_count(self.study.run_count, 'run')}"
                                       + success,
            "ends": "; ".join(shown),
            "settings": ", ".join(self.study.keys),
            "metrics": ", ".join(m.name for m in self.metrics),
        })  # fmt: skip

    def to_pandas(self) -> pandas.DataFrame:
        """Return the table with one row per run; `attrs["units"]` has the units of its columns.

        Raises:
            BenchError: pandas is not installed.
        """
        import_pandas()
        frame = self.table.to_pandas()
        units = {key: find_unit(key) for key in self.study.keys}
        units |= {metric.name: metric.unit for metric in self.metrics}
        frame.attrs["units"] = {name: unit for name, unit in units.items() if unit}
        return frame

    def compare(
        self, other: Results | None = None, by: Sequence[str] = (), metrics: Sequence[str] = (),
        between: str = "",
    ) -> Any:  # fmt: skip
        """Test for significant differences from another study, or between cases of this study.

        Runs are paired if their seeds and the settings that are not compared are equal; p-values
        are corrected for the number of comparisons by Holm's method. `compare_studies` describes
        the tests.

        Args:
            other: results of the study that is compared with this one; None: compare cases of this
                study.
            by: keys that define the groups that are compared separately. Empty: for two studies,
                all keys of the grid and of the cases; for `between`, none, so all runs are in one
                group.
            metrics: names; empty: all.
            between: key, or axis of cases, whose values are compared with each other.

        Returns:
            A StudyComparison, which prints the significant differences.

        Raises:
            StudyError: there is nothing to compare, or a metric is unknown.
        """
        compare = import_later("aras_visual_servo_bench.studies.compare:compare_studies")
        return compare(self, other, by, metrics, between)

    def write_csv(self, path: Path) -> int:
        """Write a CSV file with one row per run; return the number of rows.

        Columns that are equal in all rows are omitted."""
        columns = [name for name in self.table.column_names if name not in LABEL_COLUMNS]
        with catch_write_errors(path):
            write_csv(self.table.select(columns), path)
        return self.table.num_rows

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """Metrics that the table of results contains."""
        return (
            *(metrics.find_metric(name) for name in self.study.metric_names),
            REAL_TIME_MULTIPLE,
        )

    @property
    def parameters(self) -> tuple[str, ...]:
        """Keys whose values are listed in the study: those of the grid and of the cases."""
        random_keys = {variation.key for variation in self.study.random_variations}
        return tuple(key for key in self.study.keys if key not in random_keys)

    def read_column(self, name: str, rows: np.ndarray | None = None) -> list[Any]:
        """Return the values of a column.

        Args:
            name: name of the column.
            rows: indices of the rows that are read; None: all.

        Raises:
            StudyError: there is no such column; the message suggests a similar name.
        """
        column = self._find_column(name)
        return (column if rows is None else column.take(rows)).to_pylist()

    def _find_column(self, name: str) -> pa.ChunkedArray:
        if name not in self.table.column_names:
            raise StudyError(f"no column '{name}': {suggest(name, self.table.column_names)}")
        return self.table[name]

    def read_numbers(self, name: str) -> np.ndarray:
        """Return a column of numbers as an array (n,).

        Raises:
            StudyError: there is no such column, or it contains text.
        """
        column = self._find_column(name)
        if pa.types.is_string(column.type):
            raise StudyError(f"column '{name}' contains text, not numbers: choose another one")
        return _to_numbers(column)

    def read_values(self, metric: Metric) -> np.ndarray:
        """Return the values (n,) of a metric.

        An unknown value is 0 if it counts as a failure, otherwise NaN.

        Raises:
            StudyError: the metric is binary, and a run has another value than 0 and 1.
        """
        return metric.complete_values(self.read_numbers(metric.name))

    @cached_property
    def tolerance(self) -> SuccessTolerance:
        """Tolerance of the pose within which the camera of a run is at its goal."""
        stored = (  # results of earlier versions do not have these two columns
            self.read_numbers(name) if name in self.table.column_names else np.zeros(0)
            for name in ("distance_tolerance", "angle_tolerance")
        )
        return find_tolerance(self.study, *stored)

    @property
    def judged_metric(self) -> Metric:
        """Metric that defines success."""
        return metrics.find_metric(self.study.judged)

    def compute_successes(self) -> np.ndarray:
        """Return an array (n,) that is 1 for a successful run and 0 for other runs.

        The metric `judged` of the study decides. A run without a value of this metric, for example
        because it raised an error or exceeded the time limit, is not successful.
        """
        judged = find_column_name(self.study.judged)
        if judged in self.table.column_names:
            return (self.read_numbers(judged) == 1.0).astype(float)
        is_failure = pc.is_in(self._find_column("outcome"), pa.array(run_rows.FAILURES))
        return _to_numbers(pc.invert(is_failure))

    def make_end_column(self) -> pa.ChunkedArray:
        """Return a text column with the outcome of each run.

        The outcome of a converged run is followed by its verdict: whether the camera is really at
        its goal.
        """
        outcome, verdict = self._find_column("outcome"), self._find_column("verdict")
        both = pc.binary_join_element_wise(outcome, verdict, ", ")
        return pc.if_else(pc.starts_with(outcome, "converged"), both, outcome)

    def group_rows(self, keys: Sequence[str]) -> dict[tuple, np.ndarray]:
        """Group the rows by the values of some keys.

        Returns:
            For each combination of values, in order of appearance, the row indices (n,).
        """
        columns = [self.read_column(key) for key in keys]
        groups: dict[tuple, list[int]] = {}
        for row in range(self.table.num_rows):
            groups.setdefault(tuple(column[row] for column in columns), []).append(row)
        return {values: np.array(indices) for values, indices in groups.items()}

    def select_metrics(self, names: Sequence[str]) -> tuple[Metric, ...]:
        """Return the metrics with these names; if no names are given, all metrics except success.

        The metric `success` can be named but is not returned, because tables, figures and
        comparisons always contain it.

        Raises:
            StudyError: the results have no such metric.
        """
        success = metrics.success.name
        by_name = {m.name: m for m in self.metrics if m.name != success}
        for name in names:
            if name not in by_name and name != success:
                known = [success, *by_name]
                raise StudyError(f"no metric '{name}' in {self.name}: {suggest(name, known)}")
        chosen = tuple(name for name in names if name != success) if names else tuple(by_name)
        return tuple(by_name[name] for name in chosen)
