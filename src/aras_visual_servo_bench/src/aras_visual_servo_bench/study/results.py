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

from aras_visual_servo_base.names import nearest

from ..errors import StudyError, writing
from ..numbers import metrics
from ..numbers.metrics import Metric
from . import folder as folders
from . import rows
from .folder import Folder
from .study import Study

REAL_TIME = Metric(
    "real_time_multiple", "", metrics.GREATER, "wall time of the worker, in a file of its own",
    lambda finished: float("nan"),
)  # fmt: skip


WITHIN = 0.01  # of a published number


def met(value: Any, published: Any) -> bool:
    """Whether a value is as published; see Case."""
    if value is None or isinstance(value, str) or isinstance(published, str):
        return value == published
    if isinstance(published, list | tuple):
        return published[0] <= value <= published[1]
    if isinstance(published, int):
        return value == published
    return abs(value - published) <= WITHIN * abs(published)


def _with_published(study: Study, table: pa.Table) -> pa.Table:
    """What is published of each run, and whether all of it is met, where the study says it."""
    if not any(case.published for case in study.combinations):
        return table
    told, held = [], []
    for row in table.to_pylist():
        wanted = study.combination(row["point"]).published
        told.append(", ".join(f"{key} {value}" for key, value in wanted.items()))
        held.append(all(met(row.get(k), v) for k, v in wanted.items()) if wanted else None)
    table = table.append_column("published", pa.array(told, pa.string()))
    return table.append_column("met", pa.array(held, pa.bool_()))


def _numbers(column: pa.ChunkedArray) -> np.ndarray:
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
        return cls.of(Folder.open(path))

    @classmethod
    def of(cls, folder: Folder) -> Results:
        """Of a folder that is open; see `read`."""
        table, times = folder.results(), folder.results(folders.TIMES)
        runs, timed = table["run"].to_numpy(), times["run"].to_numpy()
        at = np.minimum(np.searchsorted(timed, runs), len(timed) - 1)  # both in order of runs
        wall = np.where(timed[at] == runs, _numbers(times["wall"])[at], np.nan)
        simulated = _numbers(table["simulated"])
        multiple = np.divide(simulated, wall, out=np.full(len(runs), np.nan), where=wall > 0.0)
        table = table.append_column(REAL_TIME.name, pa.array(multiple, pa.float64()))
        table = _with_published(folder.study, table)
        return cls(folder.path.resolve().name, folder.study, table)

    def write_csv(self, path: Path) -> int:
        """A row a run, without what is the same in all; answers how many."""
        columns = [name for name in self.table.column_names if name not in rows.LABELS]
        with writing(path):
            write_csv(self.table.select(columns), path)
        return self.table.num_rows

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """Those that its rows have."""
        return (*(metrics.find(name) for name in self.study.metric_names), REAL_TIME)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Keys that take few values: those of the grid and of the cases."""
        drawn = {draw.key for draw in self.study.draws}
        return tuple(key for key in self.study.keys if key not in drawn)

    def column(self, name: str) -> list[Any]:
        """Values of a column; StudyError with the nearest name where there is none."""
        return self._column(name).to_pylist()

    def _column(self, name: str) -> pa.ChunkedArray:
        if name not in self.table.column_names:
            raise StudyError(f"no column '{name}': {nearest(name, self.table.column_names)}")
        return self.table[name]

    def numbers(self, name: str) -> np.ndarray:
        """A column (n,) of numbers; StudyError where it holds words."""
        found = self._column(name)
        if pa.types.is_string(found.type):
            raise StudyError(f"{name} holds words, not numbers")
        return _numbers(found)

    def successes(self) -> np.ndarray:
        """(n,) 0 or 1, as the study is judged; what was refused, failed or died is none."""
        if self.study.judged in self.table.column_names:
            found = self.numbers(self.study.judged)
            return np.where(np.isnan(found), 0.0, found)
        none = pa.array([rows.REFUSED, rows.FAULT, rows.DIED, rows.LATE])
        return _numbers(pc.invert(pc.is_in(self._column("outcome"), none)))

    def ends(self) -> list[str]:
        """How each run ended, in a word; with the verdict where the loop holds to be there."""
        return self.end_column().to_pylist()

    def end_column(self) -> pa.ChunkedArray:
        """`ends`, as a column."""
        outcome, verdict = self._column("outcome"), self._column("verdict")
        both = pc.binary_join_element_wise(outcome, verdict, ", ")
        return pc.if_else(pc.starts_with(outcome, "converged"), both, outcome)

    def groups(self, keys: Sequence[str]) -> dict[tuple, np.ndarray]:
        """Rows (n,) int of each combination of the keys' values, in order of appearance."""
        columns = [self.column(key) for key in keys]
        found: dict[tuple, list[int]] = {}
        for row in range(self.table.num_rows):
            found.setdefault(tuple(column[row] for column in columns), []).append(row)
        return {values: np.array(indices) for values, indices in found.items()}

    def chosen(self, names: Sequence[str]) -> tuple[Metric, ...]:
        """The metrics of these names; empty: all but success, which is told apart."""
        by_name = {m.name: m for m in self.metrics if m.name != metrics.success.name}
        for name in names:
            if name not in by_name:
                raise StudyError(f"no metric '{name}' in {self.name}: {nearest(name, by_name)}")
        return tuple(by_name[name] for name in names) if names else tuple(by_name.values())
