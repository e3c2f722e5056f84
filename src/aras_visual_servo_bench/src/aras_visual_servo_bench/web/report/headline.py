"""Title of a report, and its main results: one row per run, or per group of runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ...metrics import statistics
from ...metrics.formatting import (
    NO_NUMBER,
    choose_unit,
    format_count,
    format_heading,
    make_number_format,
)
from ...metrics.metrics import METRICS
from ...metrics.statistics import Estimate
from ...metrics.summary import Quantity
from ...recording.presentable_run import describe_experiment, list_experiment_parts
from ...recording.run import Run
from ...recording.verdict import REACHED

COLUMNS = (
    ("final_distance", "final distance"), ("final_angle", "final angle"),
    ("settled", "settling time"),
)  # fmt: skip
# largest number of runs that have their own rows, for comparison at a glance; more are grouped
MAX_ROWS = 8
MAX_GROUPS = 24  # largest number of groups of runs, for comparison without scrolling far
# Settings that do not make two runs different experiments: the seed, and the command that launched
# a recorded run.
REPETITION_KEYS = ("seed", "launched by")
# When a report opens, its plots end at the settling time multiplied by SETTLING_MARGIN, or show the
# whole runs if this is more than the fraction MAX_TRANSIENT of the longest run.
SETTLING_MARGIN, MAX_TRANSIENT = 1.5, 0.5
# Largest number of schemes, plants or targets that a title lists; if more, it gives their number.
MAX_LISTED = 3


@dataclass(frozen=True)
class Headline:
    """Main results of several runs, as texts of a table.

    Attributes:
        headings: headings of the columns with numbers, with their units.
        runs: one row per run.
        groups: one row per group of runs; empty if there are at most MAX_ROWS runs.
    """

    headings: list[str]
    runs: list[dict[str, object]]
    groups: list[dict[str, object]]


def make_title(runs: Sequence[Run]) -> str:
    """Return the title of a report: scheme, plant, target and outcome, as far as they are known."""
    if len(runs) == 1:
        (run,) = runs
        verdict = f", {run.verdict.name.replace('_', ' ')}" if run.verdict.name else ""
        outcome = run.outcome.replace("_", " ") or "unknown outcome"
        return f"{describe_experiment(run) or run.name}: {outcome}{verdict}"
    parts: dict[str, list[str]] = {}
    for run in runs:
        for part, value in list_experiment_parts(run).items():
            parts.setdefault(part, []).append(value)
    found = []
    for part, values in parts.items():
        known = list(dict.fromkeys(values))
        text = " and ".join(known) if len(known) <= MAX_LISTED else f"{len(known)} {part}s"
        found.append(text if part == "scheme" or len(known) > MAX_LISTED else f"{part} {text}")
    good = sum(run.is_success for run in runs)
    return (f"Comparison of {format_count(len(runs), 'run')}: {', '.join(found)}; "
            f"{good} of {len(runs)} succeeded")  # fmt: skip


def make_headline(runs: Sequence[Run], summaries: Sequence[Sequence[Quantity]]) -> Headline:
    """Return the main results of several runs.

    The rates of groups have Wilson's interval; distance, angle and settling time are medians with
    confidence intervals. A run that has not settled has no settling time.
    """
    values = [{q.key: q.value for q in quantities} for quantities in summaries]
    columns = [[float(row[key]) for row in values] for key, _ in COLUMNS]
    units = [choose_unit(METRICS[key].unit, column)
             for (key, _), column in zip(COLUMNS, columns, strict=True)]  # fmt: skip
    scaled = [[v / size for v in column] for column, (_, size) in zip(columns, units, strict=True)]
    formats = [make_number_format(column) for column in scaled]
    headings = [format_heading(text, unit)
                for (_, text), (unit, _) in zip(COLUMNS, units, strict=True)]  # fmt: skip
    rows = [
        {"number": i, "name": run.name, "outcome": run.outcome or "unknown outcome",
         "converged": run.is_held_at_goal,
         "reached": {"": "unknown", REACHED: "yes"}.get(run.verdict.name, "no"),
         "reason": "" if run.is_success else "; ".join(filter(None, (run.reason, run.remedy))),
         "cells": [show(column[i]) for show, column in zip(formats, scaled, strict=True)]}
        for i, run in enumerate(runs)
    ]  # fmt: skip
    groups = []
    for name, members in (_group_runs(runs) if len(runs) > MAX_ROWS else {}).items():
        reached = statistics.rate([float(values[i]["reached"]) for i in members])
        groups.append({
            "name": name, "count": len(members), "reached": _describe_rate(reached),
            "converged": sum(runs[i].converged for i in members),
            "cells": [_describe_estimate(statistics.median([column[i] for i in members]), show)
                      for show, column in zip(formats, scaled, strict=True)],
        })  # fmt: skip
    return Headline(headings, rows, groups)


def _describe_rate(rate: Estimate) -> str:
    if not rate.count:
        return "unknown"
    low, high = (f"{100 * part:.0f}" for part in (rate.low, rate.high))
    return f"{round(rate.value * rate.count)} of {rate.count} [{low}, {high}] %"


def _describe_estimate(found: Estimate, show: Callable[[float], str]) -> str:
    if math.isnan(found.value):
        return NO_NUMBER
    interval = "" if math.isnan(found.low) else f" [{show(found.low)}, {show(found.high)}]"
    return show(found.value) + interval


def _group_runs(runs: Sequence[Run]) -> dict[str, list[int]]:
    """Group the indices of runs by the settings that differ between the runs.

    Settings in REPETITION_KEYS, such as the seed, do not count. If there would be more than
    MAX_GROUPS groups, or only one run in each, the last settings are not used.
    """
    settings = [{**list_experiment_parts(run), **run.settings} for run in runs]
    known = dict.fromkeys(key for one in settings for key in one if key not in REPETITION_KEYS)
    keys = [key for key in known if len({one.get(key) for one in settings}) > 1]
    while True:
        groups: dict[str, list[int]] = {}
        for i, one in enumerate(settings):
            name = ", ".join(f"{key} {one.get(key, 'unknown')}" for key in keys)
            groups.setdefault(name or "all runs", []).append(i)
        if not keys or len(groups) <= min(MAX_GROUPS, len(runs) // 2):
            return groups
        keys = keys[:-1]


def find_transient(summaries: Sequence[Sequence[Quantity]], end: float) -> float | None:
    """Return the time until which a page shows the runs when it opens, s; None for the whole runs.

    It is the latest settling time of the runs that have settled, multiplied by SETTLING_MARGIN.

    Args:
        summaries: metrics of each run.
        end: end of the longest run, s.
    """
    times = [float(q.value) for quantities in summaries for q in quantities
             if q.key in ("settled", "error_settled") and math.isfinite(q.value)]  # fmt: skip
    part = SETTLING_MARGIN * max(times, default=0.0)
    return part if 0.0 < part <= MAX_TRANSIENT * end else None


def list_remarks(
    runs: Sequence[Run], find: Callable[[Run], Sequence[str]]
) -> Mapping[str, str]:
    """Return each text that `find` gives for a run; the value is the runs' names, or their number.
    """
    found: dict[str, list[str]] = {}
    for run in runs:
        for text in find(run):
            found.setdefault(text, []).append(run.name)
    return {text: ", ".join(names) if len(names) <= MAX_LISTED else format_count(len(names), "run")
            for text, names in found.items()}  # fmt: skip
