"""Tests for significant differences between two studies, or between the cases of one study."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.names import suggest

from ..errors import StudyError
from ..metrics.formatting import (
    choose_unit,
    format_count,
    format_quantity,
    make_number_format,
)
from ..metrics.metric import GREATER, SMALLER, Metric
from ..metrics.run_tables import import_pandas
from ..metrics.statistics import Comparison, compare_rates, compare_values, holm
from .captions import name_group
from .results import REAL_TIME_MULTIPLE, Results

if TYPE_CHECKING:
    import pandas

SIGNIFICANCE_LEVEL = 0.05
MAX_SHOWN = 20  # maximum number of differences that a printed comparison lists
# a paired test needs a partner in the other study for at least this fraction of the runs
MIN_PAIRED = 0.9
SCHEME = "scheme"
# Verdicts about the second study or case, compared with the first. DIFFERS: the difference is
# significant but neither better nor worse, because the metric has no better direction or because
# the medians are equal. UNTESTED: one of the two has no values.
BETTER, WORSE, DIFFERS, CHANCE, UNTESTED = "better", "WORSE", "differs", "chance", "untested"


@dataclass(frozen=True)
class Difference:
    """Result of comparing one metric of two sets of runs.

    group: values of the settings that define the group, as text.
    metric: name of the metric.
    comparison: estimates for both sets of runs, such as their medians.
    p: p-value with Holm's correction; NaN if the difference was not tested.
    verdict: BETTER, WORSE or DIFFERS; CHANCE if the difference is not significant; or UNTESTED.
    sides: names of both sets of runs; empty if two studies are compared.
    unit: unit of the metric.
    note: why the difference is not tested or cannot be significant, and in which other settings the
        sets of runs differ; may be ''.
    """

    group: str
    metric: str
    comparison: Comparison
    p: float
    verdict: str
    sides: tuple[str, str] = ("", "")
    unit: str = ""
    note: str = ""

    @property
    def is_significant(self) -> bool:
        """True if the difference was tested and is significant."""
        return self.verdict not in (CHANCE, UNTESTED)


@dataclass(frozen=True)
class _Sample:
    """Runs on one side of a comparison: the indices of their rows, and the name of this side."""

    name: str
    results: Results
    rows: np.ndarray


@dataclass(frozen=True, repr=False)
class StudyComparison:
    """Differences between two studies or between cases; its text lists the significant ones.

    names: names of the studies.
    differences: one per group of settings, pair of cases, and metric.
    """

    names: tuple[str, ...]
    differences: tuple[Difference, ...]

    def __repr__(self) -> str:
        """List the most significant differences."""
        title = f"{' -> '.join(self.names)}\n" if len(set(self.names)) > 1 else ""
        return title + self.describe(limit=MAX_SHOWN)

    def describe(self, is_verbose: bool = False, limit: int | None = None) -> str:
        """Return the significant differences as text, sorted by p-value, and their number.

        is_verbose: whether to list all differences.
        limit: maximum number of differences that are listed; None: no limit.
        """
        significant = [d for d in self.differences if d.is_significant]
        untested = [d for d in self.differences if d.verdict == UNTESTED]
        tested = len(self.differences) - len(untested)
        listed = list(self.differences) if is_verbose else sorted(significant, key=lambda d: d.p)
        lines = [_describe_difference(d) for d in listed[:limit]]
        lines += [f"… and {len(listed) - len(lines)} more"] if len(listed) > len(lines) else []
        lines.append(
            f"{len(significant)} of {tested} differences are significant (Holm, "
            f"α = {SIGNIFICANCE_LEVEL:g})"
        )
        weak = [d for d in self.differences
                if d.verdict == CHANCE and d.comparison.least_p >= SIGNIFICANCE_LEVEL]
        if weak:
            lines.append(
                f"{len(weak)} of these differences have too few runs to be significant: repeat "
                "each setting more often (`repeats`), or compare larger groups (`by`)"
            )
        if untested:
            names = ", ".join(dict.fromkeys(d.metric for d in untested))
            lines.append(f"{len(untested)} differences of {names} are not tested, because one of "
                         "the compared groups has no values")  # fmt: skip
        if not is_verbose:
            notes = dict.fromkeys(d.note for d in significant if d.note)
            lines += [f"Note: {note}" for note in notes]
        return "\n".join(lines)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with one row per difference.

        Raises:
            BenchError: pandas is not installed.
        """
        names = ("group", "first", "second", "metric", "unit", "verdict", "before", "after", "p",
                 "count", "paired", "note")  # fmt: skip
        rows = [(d.group, *d.sides, d.metric, d.unit, d.verdict, d.comparison.before,
                 d.comparison.after, d.p, d.comparison.count, d.comparison.paired, d.note)
                for d in self.differences]  # fmt: skip
        return import_pandas().DataFrame(rows, columns=list(names))


def compare_studies(
    first: Results, second: Results | None = None, by: Sequence[str] = (),
    metrics: Sequence[str] = (), between: str = "",
) -> StudyComparison:  # fmt: skip
    """Compare success and metrics of two studies, or of the values of a key within one study.

    The tests for pairs of runs are McNemar's test for success and other binary metrics, and
    Wilcoxon's signed-rank test for other metrics. Without pairs, they are Fisher's exact test and
    the Mann-Whitney U test. Two runs are a pair if their seeds and all settings that are not
    compared are equal. If there are too few such pairs, equal settings suffice, provided that they
    identify each run. Holm's method corrects the p-values for the number of tests.

    Args:
        first: results of a study.
        second: results of another study; None: compare cases of the first study.
        by: keys whose values define the groups that are compared separately. Empty: for two
            studies, all keys of the grid and of the cases; for `between`, none, so all runs are in
            one group.
        metrics: names of the metrics to compare; empty: all metrics. Comparisons of schemes omit
            metrics that depend on the features of the scheme.
        between: key, or axis of cases, whose values are compared with each other.

    Raises:
        StudyError: there is nothing to compare, a metric is unknown, or values of different schemes
            cannot be compared.
    """
    if (second is None) == (not between):
        raise StudyError("nothing to compare: give either two studies, or one study and a key "
                         "(--between KEY)")
    if second is None:
        chosen = _select_comparable(first, between, metrics)
        pairs = _pair_cases(first, between, by)
    else:
        second.select_metrics(metrics)  # raises an error if the second study lacks a named metric
        shared = {m.name for m in second.metrics}
        chosen = [m for m in _select_compared(first, metrics) if m.name in shared]
        pairs = _pair_groups(first, second, by)
    tests: list[Difference] = []
    better: list[str] = []
    for group, one, two in pairs:
        a, b, is_paired = _pair_rows(one, two)
        sides, note = (one.name, two.name), _describe_confounding(one, two, between)
        successes = [s.results.compute_successes()[rows] for s, rows in ((one, a), (two, b))]
        found = [("success", "", GREATER, compare_rates(*successes, is_paired))]
        for m in chosen:
            compare = compare_rates if m.is_binary else compare_values
            values = [s.results.read_values(m)[rows] for s, rows in ((one, a), (two, b))]
            found.append((m.name, m.unit, m.better, compare(*values, is_paired)))
        for name, unit, direction, comparison in found:
            tests.append(Difference(group, name, comparison, comparison.p, "", sides, unit, note))
            better.append(direction)
    corrected = holm([d.p for d in tests])
    names = (first.name,) if second is None else (first.name, second.name)
    return StudyComparison(names, tuple(map(_judge, tests, corrected, better)))


def _judge(difference: Difference, p: float, better: str) -> Difference:
    """Return a difference with its corrected p-value, its verdict and a note.

    Args:
        difference: difference without a verdict.
        p: p-value after Holm's correction.
        better: GREATER or SMALLER if such values of the metric are better; '' if neither is.
    """
    comparison, notes = difference.comparison, [difference.note] if difference.note else []
    if math.isnan(p):
        verdict = UNTESTED
        middles = (comparison.before, comparison.after)
        empty = [side or number for side, number, middle in zip(
            difference.sides, ("the first", "the second"), middles, strict=True)
            if math.isnan(middle)]  # fmt: skip
        both = "no pair of runs has a value in both runs" if comparison.paired else ""
        notes.insert(0, both or f"no run of {' and '.join(empty)} has a value")
    elif p < SIGNIFICANCE_LEVEL:
        verdict = DIFFERS
        if better in (GREATER, SMALLER) and comparison.after != comparison.before:
            is_better = (comparison.after > comparison.before) == (better == GREATER)
            verdict = BETTER if is_better else WORSE
    else:
        verdict = CHANCE
        if comparison.least_p >= SIGNIFICANCE_LEVEL:
            number = format_count(comparison.count, "pair" if comparison.paired else "run")
            notes.insert(0, f"a sample of {number} is too small for p < {SIGNIFICANCE_LEVEL:g}")
        elif comparison.before == comparison.after and comparison.p == 1.0:
            notes.insert(0, "no difference")
    return replace(difference, p=p, verdict=verdict, note="; ".join(notes))


def _describe_difference(d: Difference) -> str:
    values = (d.comparison.before, d.comparison.after)
    unit, size = choose_unit(d.unit, values)
    number = make_number_format([value / size for value in values])
    before, after = (number(value / size) for value in values)
    pairs = format_count(d.comparison.count, "pair" if d.comparison.paired else "run")
    p = "p –" if math.isnan(d.p) else f"p {d.p:.2g}"
    sides = f"{' -> '.join(d.sides)}  " if any(d.sides) else ""
    note = f"  ({d.note})" if d.note else ""
    return (f"{d.verdict:<8} {d.metric:<18} {before} -> {format_quantity(after, unit)}  {p}  "
            f"{pairs}  {sides}{d.group}{note}")  # fmt: skip


def _pair_groups(
    first: Results, second: Results, by: Sequence[str]
) -> Iterator[tuple[str, _Sample, _Sample]]:
    """Yield, for each group of settings in both studies, its name and its runs in each study."""
    keys = tuple(by) or tuple(k for k in first.parameters if k in second.parameters)
    one, two = first.group_rows(keys), second.group_rows(keys)
    groups = [values for values in one if values in two]
    if not groups:
        raise StudyError(f"{first.name} and {second.name} have no settings of {keys} in common: "
                         "compare studies with some equal values of these keys, or name other keys")
    for values in groups:
        group = name_group(keys, values) if keys else "all"
        yield group, _Sample("", first, one[values]), _Sample("", second, two[values])


def _pair_cases(
    results: Results, between: str, by: Sequence[str]
) -> Iterator[tuple[str, _Sample, _Sample]]:
    """Yield each pair of values of a key in each group of runs, with the runs of both values.

    Each yielded tuple contains the name of the group, the runs with the first value, and the runs
    with the second value.

    Raises:
        StudyError: the study does not vary the key, draws it at random, or has only one value of
            it.
    """
    if between not in results.study.keys:
        known = suggest(between, results.parameters)
        raise StudyError(f"{results.name} does not vary '{between}': {known}")
    if between not in results.parameters:
        raise StudyError(f"{between} is drawn at random: --between needs a key with a list of "
                         "values, or an axis of cases")  # fmt: skip
    if between in by:
        raise StudyError(f"{between} is given in both --between and --by: remove it from one of "
                         "them")
    if len(set(map(str, results.read_column(between)))) < 2:
        value = results.read_column(between)[0]
        raise StudyError(f"all stored runs of {results.name} have {between}={value}, so there is "
                         "nothing to compare: run the missing cases first, or name another key")
    column = results.read_column(between)
    for values, rows in results.group_rows(by).items():
        group = name_group(by, values) if by else "all"
        sides: dict[object, list[int]] = {}
        for row in rows:
            sides.setdefault(column[row], []).append(int(row))
        for one, two in itertools.combinations(sides, 2):
            yield group, *(_Sample(f"{between}={value}", results, np.array(sides[value]))
                           for value in (one, two))  # fmt: skip


def _select_compared(results: Results, names: Sequence[str]) -> list[Metric]:
    """Return the named metrics; without names, all metrics except the one for the computer's speed.
    """
    return [
        m for m in results.select_metrics(names) if names or m.name != REAL_TIME_MULTIPLE.name
    ]


def _select_comparable(results: Results, between: str, names: Sequence[str]) -> list[Metric]:
    """Return the metrics that can be compared between runs with different values of a key.

    Raises:
        StudyError: `names` contains a metric that depends on the features of the scheme, but the
            compared runs have different schemes.
    """
    study = results.study
    is_scheme = between == SCHEME or any(
        SCHEME in case.set for case in study.case_axes.get(between, ())
    )
    chosen = _select_compared(results, names)
    unlike = [m.name for m in chosen if m.is_feature_based and is_scheme]
    if names and unlike:
        raise StudyError(f"{unlike[0]} depends on the features of the scheme, so that values of "
                         "different schemes cannot be compared: leave it out")  # fmt: skip
    return [m for m in chosen if m.name not in unlike]


def _pair_rows(one: _Sample, two: _Sample) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the rows of both samples, and whether they are paired.

    Two runs are paired if their seeds and settings are equal. If this does not give enough pairs,
    equal settings suffice, but only if no two runs of a sample have the same settings. At least 90
    % of the runs must be paired; the other runs are then left out. Otherwise all rows are returned
    without pairs.
    """
    varied = _find_varied_keys(one, two)
    for keys in (["seed", *varied], varied):
        if not keys:
            continue
        indices = [_index_rows(sample, keys) for sample in (one, two)]
        if any(len(index) < len(s.rows) for index, s in zip(indices, (one, two), strict=True)):
            continue
        first, second = indices
        both = [key for key in first if key in second]
        if both and len(both) >= MIN_PAIRED * max(len(first), len(second)):
            return np.array([first[k] for k in both]), np.array([second[k] for k in both]), True
    return one.rows, two.rows, False


def _index_rows(sample: _Sample, keys: Sequence[str]) -> dict[tuple, int]:
    """Return the row of each run of a sample, by the tuple of the run's values of `keys`."""
    columns = [sample.results.read_column(key, sample.rows) for key in keys]
    return {tuple(column[i] for column in columns): int(row) for i, row in enumerate(sample.rows)}


def _find_varied_keys(one: _Sample, two: _Sample) -> list[str]:
    """Return the settings, except the seed, that vary within at least one of two samples."""
    shared = [k for k in one.results.study.keys if k in two.results.study.keys and k != "seed"]
    return sorted(
        key for key in shared
        if any(len(set(s.results.read_column(key, s.rows))) > 1 for s in (one, two))
    )  # fmt: skip


def _describe_confounding(one: _Sample, two: _Sample, between: str) -> str:
    """Describe the settings, except the compared key, that differ between two cases; '' if none."""
    if not between:
        return ""
    found = []
    for key in one.results.parameters:
        if key in (between, "seed"):
            continue
        values = [set(map(str, s.results.read_column(key, s.rows))) for s in (one, two)]
        if not values[0] & values[1]:
            shown = [min(v) if len(v) == 1 else "several values" for v in values]
            found.append(f"{key} ({shown[0]}, {shown[1]})")
    return f"the compared runs also differ in {', '.join(found)}" if found else ""
