"""Comparison of two studies: statistically significant differences of their metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import StudyError
from ..metrics.formatting import make_number_format
from ..metrics.metrics import GREATER, SMALLER
from ..metrics.run_tables import import_pandas
from ..metrics.statistics import Comparison, compare_rates, compare_values, holm
from .results import REAL_TIME_MULTIPLE, Results

if TYPE_CHECKING:
    import pandas

SIGNIFICANCE_LEVEL = 0.05
MAX_SHOWN = 20  # maximum number of differences that a printed comparison lists
# Verdicts about the second study compared with the first. DIFFERS: neither smaller nor greater
# values of the metric are better, or only the distributions differ, not the medians.
BETTER, WORSE, DIFFERS, CHANCE = "better", "WORSE", "differs", "chance"


@dataclass(frozen=True)
class Difference:
    """Result of comparing one metric of two studies in one group of settings.

    group: values of the settings that define the group, as text.
    metric: name of the metric.
    comparison: values of both studies.
    p: p-value with Holm's correction.
    verdict: BETTER, WORSE or DIFFERS; CHANCE if the difference is not significant.
    """

    group: str
    metric: str
    comparison: Comparison
    p: float
    verdict: str


@dataclass(frozen=True, repr=False)
class StudyComparison:
    """Differences between the results of two studies; printed, it lists the significant ones.

    first, second: names of the studies.
    differences: one per group of settings and metric.
    """

    first: str
    second: str
    differences: tuple[Difference, ...]

    def __repr__(self) -> str:
        """List the most significant differences."""
        *lines, last = describe_differences(self.differences, is_verbose=False).splitlines()
        if len(lines) > MAX_SHOWN:
            lines[MAX_SHOWN:] = [f"… and {len(lines) - MAX_SHOWN} more"]
        names = [f"{self.first} -> {self.second}"] if self.first != self.second else []
        return "\n".join([*names, *lines, last])

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with one row per difference.

        Raises:
            BenchError: pandas is not installed.
        """
        names = ("group", "metric", "verdict", "before", "after", "p", "count", "paired")
        rows = [(d.group, d.metric, d.verdict, d.comparison.before, d.comparison.after, d.p,
                 d.comparison.count, d.comparison.paired) for d in self.differences]  # fmt: skip
        return import_pandas().DataFrame(rows, columns=list(names))


def compare_studies(
    first: Results, second: Results, by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> StudyComparison:
    """Compare two studies; see `Results.compare`."""
    differences = tuple(find_differences(first, second, by, metrics))
    return StudyComparison(first.name, second.name, differences)


def find_differences(
    first: Results, second: Results, by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> list[Difference]:
    """Compare success and all metrics that both studies have, in each group of settings.

    Two runs are a pair if their settings and seeds are equal. Holm's method corrects the p-values
    for the number of comparisons, because at a significance level of 5 %, one of twenty comparisons
    would be significant by chance.

    Args:
        first: results of the first study.
        second: results of the second study.
        by: keys whose values define the groups; empty: all keys of the grid and of the cases.
        metrics: names of the metrics to compare; empty: all metrics.

    Raises:
        StudyError: the studies have no settings in common, or a metric is unknown.
    """
    keys = tuple(by) or tuple(k for k in first.parameters if k in second.parameters)
    one, two = _index_rows(first, keys), _index_rows(second, keys)
    groups = [values for values in one if values in two]
    if not groups:
        raise StudyError(f"{first.name} and {second.name} have no settings of {keys} in common: "
                         "compare studies with some equal values of these keys, or name other keys")
    shared = {m.name for m in second.metrics} - {REAL_TIME_MULTIPLE.name}
    chosen = [m for m in first.select_metrics(metrics) if m.name in shared]
    tests: list[tuple[str, str, str, Comparison]] = []
    for values in groups:
        group = ", ".join(f"{k}={v}" for k, v in zip(keys, values, strict=True)) or "all"
        a, b, paired = _pair_rows(one[values], two[values])
        rates = compare_rates(first.compute_successes()[a], second.compute_successes()[b], paired)
        tests.append((group, "success", GREATER, rates))
        for m in chosen:
            comparison = compare_values(
                first.read_numbers(m.name)[a], second.read_numbers(m.name)[b], paired
            )
            tests.append((group, m.name, m.better, comparison))
    corrected = holm([comparison.p for *_, comparison in tests])
    return [
        Difference(
            group,
            name,
            comparison,
            p,
            _find_verdict(better, comparison) if p < SIGNIFICANCE_LEVEL else CHANCE,
        )
        for (group, name, better, comparison), p in zip(tests, corrected, strict=True)
    ]


def describe_differences(differences: Sequence[Difference], is_verbose: bool) -> str:
    """Return the significant differences as text, sorted by p-value, and the number of comparisons.

    is_verbose: whether to list all differences.
    """
    significant = [d for d in differences if d.verdict != CHANCE]
    listed = list(differences) if is_verbose else sorted(significant, key=lambda d: d.p)
    lines = []
    for d in listed:
        number = make_number_format((d.comparison.before, d.comparison.after))
        pairs = f"{d.comparison.count} {'pairs' if d.comparison.paired else 'runs'}"
        lines.append(
            f"{d.verdict:<7} {d.metric:<18} {number(d.comparison.before)} -> "
            f"{number(d.comparison.after)}  "
            f"p {d.p:.2g}  {pairs}  {d.group}"
        )
    lines.append(
        f"{len(significant)} of {len(differences)} differences are significant (Holm, "
        f"α = {SIGNIFICANCE_LEVEL:g})"
    )
    return "\n".join(lines)


def _index_rows(results: Results, keys: Sequence[str]) -> dict[tuple, dict[tuple, int]]:
    """Return the row index of each run in a nested mapping.

    The keys of the outer mapping are the values of `keys`; the keys of an inner mapping are the
    values of all other settings that vary, such as the seed."""
    random_keys = {variation.key for variation in results.study.random_variations}
    others = sorted(key for key in results.study.keys if key not in (*keys, "seed"))
    columns = {key: results.read_column(key) for key in ("seed", *others)}
    varied = [column for key, column in columns.items()
              if key == "seed" or key in random_keys or len(set(column)) > 1]  # fmt: skip
    return {
        values: {tuple(column[row] for column in varied): int(row) for row in rows}
        for values, rows in results.group_rows(keys).items()
    }


def _pair_rows(
    first: dict[tuple, int], second: dict[tuple, int]
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the rows of both studies, and whether they are paired.

    The rows are paired if at least 90 % of the runs have a counterpart in the other study; runs
    without a counterpart are then omitted.
    """
    both = [key for key in first if key in second]
    if both and len(both) >= 0.9 * max(len(first), len(second)):
        return np.array([first[k] for k in both]), np.array([second[k] for k in both]), True
    return np.array(list(first.values())), np.array(list(second.values())), False


def _find_verdict(better: str, comparison: Comparison) -> str:
    if better not in (GREATER, SMALLER) or comparison.after == comparison.before:
        return DIFFERS
    return BETTER if (comparison.after > comparison.before) == (better == GREATER) else WORSE
