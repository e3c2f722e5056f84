"""Results read back: rows of one or more folders, in groups that belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow.csv import write_csv

from aras_visual_servo_base.names import suggest

from ..errors import StudyError, catch_write_errors
from ..metrics import metrics
from ..metrics.metrics import Metric
from . import rows
from . import study_folder as folders
from .study import Study
from .study_folder import StudyFolder

REAL_TIME_MULTIPLE = Metric(
    "real_time_multiple", "", metrics.GREATER, "wall time of the worker, in a file of its own",
    lambda finished: float("nan"),
)  # fmt: skip


RELATIVE_TOLERANCE = 0.01  # of a published number


def is_met(value: Any, published: Any) -> bool:
    """Whether a value is as published; see Case."""
    if value is None or isinstance(value, str) or isinstance(published, str):
        return value == published
    if isinstance(published, list | tuple):
        return published[0] <= value <= published[1]
    if isinstance(published, int):
        return value == published
    return abs(value - published) <= RELATIVE_TOLERANCE * abs(published)


def _add_published(study: Study, table: pa.Table) -> pa.Table:
    """What is published of each run, and whether all of it is met, where the study says it."""
    if not any(case.published for case in study.combinations):
        return table
    told, held = [], []
    for row in table.to_pylist():
        wanted = study.find_combination(row["point"]).published
        told.append(", ".join(f"{key} {value}" for key, value in wanted.items()))
        held.append(all(is_met(row.get(k), v) for k, v in wanted.items()) if wanted else None)
    table = table.append_column("published", pa.array(told, pa.string()))
    return table.append_column("met", pa.array(held, pa.bool_()))


def _to_numbers(column: pa.ChunkedArray) -> np.ndarray:
    """(n,) float; NaN where there is none."""
    return column.cast(pa.float64()).to_numpy()


@dataclass(frozen=True)
class Results:
    """The results of a study, one row a run, read from its folder.

    Attributes:
        name: of the folder.
        study: what was run.
        table: settings, outcome, verdict and metrics, in order of the runs.
    """

    name: str
    study: Study
    table: pa.Table

    @classmethod
    def read(cls, path: str | Path) -> Results:
        """Read the folder of a study, as far as it is done; StudyError if there is no run."""
        return cls.from_folder(StudyFolder.open(path))

    @classmethod
    def from_folder(cls, folder: StudyFolder) -> Results:
        """Of a folder that is open; see `read`."""
        table, times = folder.read_results(), folder.read_results(folders.TIMES)
        runs, timed = table["run"].to_numpy(), times["run"].to_numpy()
        at = np.minimum(np.searchsorted(timed, runs), len(timed) - 1)  # both in order of runs
        wall = np.where(timed[at] == runs, _to_numbers(times["wall"])[at], np.nan)
        simulated = _to_numbers(table["simulated"])
        multiple = np.divide(simulated, wall, out=np.full(len(runs), np.nan), where=wall > 0.0)
        table = table.append_column(REAL_TIME_MULTIPLE.name, pa.array(multiple, pa.float64()))
        table = _add_published(folder.study, table)
        return cls(folder.path.resolve().name, folder.study, table)

    def write_csv(self, path: Path) -> int:
        """A row a run, without what is the same in all; answers how many."""
        columns = [name for name in self.table.column_names if name not in rows.LABEL_COLUMNS]
        with catch_write_errors(path):
            write_csv(self.table.select(columns), path)
        return self.table.num_rows

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """Those that its rows have."""
        return (
            *(metrics.find_metric(name) for name in self.study.metric_names),
            REAL_TIME_MULTIPLE,
        )

    @property
    def parameters(self) -> tuple[str, ...]:
        """Keys that take few values: those of the grid and of the cases."""
        drawn = {draw.key for draw in self.study.random_variations}
        return tuple(key for key in self.study.keys if key not in drawn)

    def read_column(self, name: str) -> list[Any]:
        """Values of a column; StudyError with the nearest name where there is none."""
        return self._find_column(name).to_pylist()

    def _find_column(self, name: str) -> pa.ChunkedArray:
        if name not in self.table.column_names:
            raise StudyError(f"no column '{name}': {suggest(name, self.table.column_names)}")
        return self.table[name]

    def read_numbers(self, name: str) -> np.ndarray:
        """A column (n,) of numbers; StudyError where it holds words."""
        found = self._find_column(name)
        if pa.types.is_string(found.type):
            raise StudyError(f"{name} holds words, not numbers")
        return _to_numbers(found)

    def compute_successes(self) -> np.ndarray:
        """(n,) 0 or 1, as the study is judged; what was refused, failed or died is none."""
        if self.study.judged in self.table.column_names:
            found = self.read_numbers(self.study.judged)
            return np.where(np.isnan(found), 0.0, found)
        none = pa.array([rows.REFUSED, rows.FAULT, rows.DIED, rows.LATE])
        return _to_numbers(pc.invert(pc.is_in(self._find_column("outcome"), none)))

    def describe_ends(self) -> list[str]:
        """How each run ended, in a word; with the verdict where the loop holds to be there."""
        return self.make_end_column().to_pylist()

    def make_end_column(self) -> pa.ChunkedArray:
        """`describe_ends`, as a column."""
        outcome, verdict = self._find_column("outcome"), self._find_column("verdict")
        both = pc.binary_join_element_wise(outcome, verdict, ", ")
        return pc.if_else(pc.starts_with(outcome, "converged"), both, outcome)

    def group_rows(self, keys: Sequence[str]) -> dict[tuple, np.ndarray]:
        """Rows (n,) int of each combination of the keys' values, in order of appearance."""
        columns = [self.read_column(key) for key in keys]
        found: dict[tuple, list[int]] = {}
        for row in range(self.table.num_rows):
            found.setdefault(tuple(column[row] for column in columns), []).append(row)
        return {values: np.array(indices) for values, indices in found.items()}

    def select_metrics(self, names: Sequence[str]) -> tuple[Metric, ...]:
        """The metrics of these names; empty: all but success, which is told apart."""
        by_name = {m.name: m for m in self.metrics if m.name != metrics.success.name}
        for name in names:
            if name not in by_name:
                raise StudyError(f"no metric '{name}' in {self.name}: {suggest(name, by_name)}")
        return tuple(by_name[name] for name in names) if names else tuple(by_name.values())
