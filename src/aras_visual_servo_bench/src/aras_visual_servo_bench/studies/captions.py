"""Sentences for the captions of tables and figures: definitions, tolerances, missing values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ..metrics import metrics
from ..metrics.metric import Metric
from .columns import find_column_name
from .results import REAL_TIME_MULTIPLE, Results

RATES = "Rates with Wilson's 95 % interval."
MEDIANS = "Medians with a bootstrap 95 % interval."
QUARTILES = "Quartiles: median [lower, upper quartile]."
ALL_RUNS = "runs"
MAX_LISTED = 4  # maximum number of groups that a sentence about missing values names


def describe_success(all_results: Sequence[Results], shown: Sequence[Metric] = ()) -> list[str]:
    """Return sentences that define success and the binary metrics in `shown`, with their tolerance.
    """
    lines, used = [], [m for m in shown if m.is_binary]
    judged = {results.judged_metric.name: results for results in all_results}
    for name, results in judged.items():
        if find_column_name(name) in results.table.column_names:
            used.insert(0, results.judged_metric)
            text = _define(results.judged_metric)
            also = "" if name == metrics.success.name else f" ({name})"
        else:
            text = f"the run was not refused and did not fail ({name} was not measured)"
            also = ""
        of = f" in {results.name}" if len(judged) > 1 else ""
        lines.append(f"Success{of}{also}: {text}.")
    named = {m.name for m in used} & set(judged)
    lines += [f"{m.name}: {_define(m)}." for m in used if m.name not in named]
    if any(m.has_tolerance for m in used):
        lines.append(describe_tolerances(all_results))
    return lines


def describe_tolerances(all_results: Sequence[Results]) -> str:
    """Return a sentence with each study's pose tolerance, within which a camera is at its goal."""
    texts = {r.name: r.tolerance.text for r in all_results}
    if len(set(texts.values())) == 1:
        return f"A camera is at its goal within {next(iter(texts.values()))}."
    listed = "; ".join(f"{name}: {text}" for name, text in texts.items())
    return f"Tolerance of the camera's pose at its goal: {listed}."


def _define(metric: Metric) -> str:
    return metric.text.removeprefix("1 if ").rstrip(".")


def name_group(keys: Sequence[str], values: Sequence[object]) -> str:
    """Return the name of a group of runs, such as 'scheme=points, gain=2.0'."""
    return ", ".join(f"{k}={v}" for k, v in zip(keys, values, strict=True)) or ALL_RUNS


def describe_missing(
    shown: Sequence[Metric], all_results: Sequence[Results], keys: Sequence[str]
) -> list[str]:
    """Return sentences about the groups of runs with missing values, or with only one value.

    Args:
        shown: metrics whose values a table or figure shows.
        all_results: results of one or more studies.
        keys: keys whose values define the groups of runs of each study.
    """
    groups = []
    for results in all_results:
        ends = results.make_end_column().to_pylist()
        study = results.name if len(all_results) > 1 else ""
        for values, rows in results.group_rows(keys).items():
            name = name_group(keys, values)
            if study:
                name = f"study={study}" if name == ALL_RUNS else f"study={study}, {name}"
            groups.append((name, results, rows, ends))
    return [line for metric in dict.fromkeys(shown) for line in _describe_missing(metric, groups)]


def _describe_missing(
    metric: Metric, groups: Sequence[tuple[str, Results, np.ndarray, Sequence[str]]]
) -> list[str]:
    """Return sentences about missing values of a metric, and about groups of runs with one value.

    groups: for each group of runs, its name, the results of its study, the indices of its rows, and
        the outcome of each run of the study.
    """
    missing, single, known = [], [], 0
    values: dict[int, np.ndarray] = {}  # values of the runs of each study, by id() of its Results
    for name, results, rows, ends in groups:
        if id(results) not in values:
            values[id(results)] = results.read_values(metric)
        unknown = rows[~np.isfinite(values[id(results)][rows])]
        if unknown.size:
            (end, count), = Counter(ends[i] or "unknown" for i in unknown).most_common(1)
            why = end if count == len(unknown) else f"{count} {end}"
            where = name if name == ALL_RUNS else f"runs with {name}"
            missing.append(f"{len(unknown)} of {len(rows)} {where} ({why})")
        known += len(rows) > len(unknown)
        if len(rows) - len(unknown) == 1:
            single.append(name)
    lines = [f"{metric.name} has no value in {_list(missing, '; ')}."] if missing else []
    if single and not metric.is_binary:
        where = "every group" if len(single) == known else _list(single, "; ")
        lines.append(f"{metric.name} has only one value, and so no interval, in {where}.")
    return lines


def describe_repeats(all_results: Sequence[Results]) -> list[str]:
    """Return a warning for each study in which all repeated runs of a setting have equal results.
    """
    found = []
    for results in all_results:
        points = results.table["point"].to_numpy() if "point" in results.table.column_names else []
        measured = [results.read_numbers(m.name) for m in results.metrics
                    if m.name != REAL_TIME_MULTIPLE.name]  # fmt: skip
        order = np.argsort(points, kind="stable")
        same_point = np.diff(np.asarray(points)[order]) == 0
        if not same_point.any() or not measured:
            continue
        values = np.column_stack(measured)[order]
        equal = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
        if equal.all(axis=1)[same_point].all():
            found.append(f"The repeats of each setting of {results.name} are identical, because "
                         "nothing in them is random: intervals and tests count the same run "
                         "several times.")  # fmt: skip
    return found


def _list(texts: Sequence[str], separator: str) -> str:
    more = len(texts) - MAX_LISTED
    return separator.join(texts[:MAX_LISTED]) + (f"{separator}and {more} more" if more > 0 else "")
