"""Groups of runs for figures of studies: a figure has one curve, box, bar or map per group."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ..experiment.experiment_keys import find_unit
from ..metrics.formatting import format_heading, format_quantity, format_value
from ..metrics.metrics import final_distance
from ..studies.results import Results
from .style import escape_math, is_paper

MAX_GROUPS = 24  # largest number of boxes in a panel for which their labels are legible
MAX_CURVES = 8
# largest number of success maps in a figure for the screen, and in a figure for a paper
MAX_MAPS, MAX_PAPER_MAPS = 12, 6


class RunGroup(NamedTuple):
    """Runs of a study with the same values of some settings.

    name: label of the group.
    results: results of the study.
    rows: (n,) indices of the rows of the group's runs in the results.
    """

    name: str
    results: Results
    rows: np.ndarray


def find_values(all_results: Iterable[Results], key: str) -> list:
    """Return the distinct values of a column of the results, in the order in which they appear."""
    return list(dict.fromkeys(v for r in all_results for v in r.read_column(key)))


def find_varied_keys(all_results: Sequence[Results]) -> list[str]:
    """Return the settings of the studies that have several values."""
    return [
        k for k in all_results[0].parameters if len(set(map(str, find_values(all_results, k)))) > 1
    ]


def limit_groups(
    all_results: Sequence[Results], keys: Sequence[str], max_groups: int
) -> Sequence[str]:
    """Return as many of the first keys as possible without too many groups of runs.

    Grouping the runs by the values of the returned keys gives at most `max_groups` groups.
    """
    while keys and sum(len(r.group_rows(keys)) for r in all_results) > max_groups:
        keys = keys[:-1]
    return keys


def find_map_limit() -> int:
    """Return the largest number of success maps in a figure of the current style."""
    return MAX_PAPER_MAPS if is_paper() else MAX_MAPS


def find_pooled_keys(kind: str, all_results: Sequence[Results]) -> list[str]:
    """Return the settings with several values by which a figure does not group the runs.

    Runs that differ only in these settings are in the same group of the figure, because there would
    otherwise be too many groups.

    kind: kind of the figure, such as 'boxes'.
    """
    keys = find_varied_keys(all_results)
    if kind == "success":
        keys, limit = keys[:-2], find_map_limit()
    else:
        limit = MAX_CURVES if kind == "distributions" else MAX_GROUPS
    shown = limit_groups(all_results, keys, limit)
    return [key for key in keys if key not in shown]


def list_groups(
    all_results: Sequence[Results], keys: Sequence[str], is_long: bool = False
) -> list[RunGroup]:
    """Group the runs of each study by the values of some keys.

    is_long: whether the name of a group contains keys and units; False: only values.
    """
    found = []
    for results in all_results:
        for values, rows in results.group_rows(keys).items():
            parts = zip(keys, map(format_setting, values), strict=True)
            name = ", ".join(
                f"{escape_math(k)} {format_quantity(v, find_unit(k))}" if is_long else v
                for k, v in parts
            )
            if len(all_results) > 1 or not name:
                name = f"{escape_math(results.name)} {name}".strip()
            found.append(RunGroup(name, results, rows))
    return found


def group_runs(all_results: Sequence[Results], max_groups: int = MAX_GROUPS) -> list[RunGroup]:
    """Group the runs of each study by the settings with several values.

    If there would be more than `max_groups` groups, the last of these settings are ignored. In a
    figure for a paper, the name of a group contains only values; `label_groups` gives the settings.
    """
    keys = limit_groups(all_results, find_varied_keys(all_results), max_groups)
    return list_groups(all_results, keys, is_long=not is_paper())


def label_groups(all_results: Sequence[Results], max_groups: int = MAX_GROUPS) -> str:
    """Return the settings by whose values `group_runs` names the groups in figures for a paper.

    In figures for the screen, return '', because the names contain the settings.
    """
    keys = limit_groups(all_results, find_varied_keys(all_results), max_groups)
    return ", ".join(map(label_setting, keys)) if is_paper() else ""


def has_final_distance(all_results: Sequence[Results]) -> bool:
    """Return whether every study has at least one run with a known final distance."""
    name = final_distance.name
    return all(
        name in r.table.column_names and np.isfinite(r.read_numbers(name)).any()
        for r in all_results
    )  # fmt: skip


def find_distance_tolerance(all_results: Sequence[Results]) -> float | None:
    """Return the tolerance of the final distance, m; None if it is not the same for all runs."""
    distances = {pair[0] for results in all_results for pair in results.tolerance.pairs}
    return distances.pop() if len(distances) == 1 else None


def label_setting(key: str) -> str:
    """Return the label of a setting with its unit."""
    return escape_math(format_heading(key, find_unit(key)))


def format_setting(value: object) -> str:
    """Return the value of a setting as text for a figure."""
    return escape_math(format_value(value))
