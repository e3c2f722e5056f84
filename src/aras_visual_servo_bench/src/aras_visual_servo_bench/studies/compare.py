"""Two studies held against each other: which of the differences are more than chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import StudyError
from ..metrics.formatting import make_number_format
from ..metrics.metrics import GREATER, SMALLER
from ..metrics.statistics import Comparison, compare_rates, compare_values, holm
from .results import REAL_TIME_MULTIPLE, Results

SIGNIFICANCE_LEVEL = 0.05
# What the second is. DIFFERS: of a metric that is neither good nor bad, or by more than the median.
BETTER, WORSE, DIFFERS, CHANCE = "better", "WORSE", "differs", "chance"


@dataclass(frozen=True)
class Difference:
    """One question. group: settings it was asked for. metric: of what. p: corrected by Holm.

    verdict: BETTER, WORSE or DIFFERS, CHANCE where p leaves that open.
    """

    group: str
    metric: str
    comparison: Comparison
    p: float
    verdict: str


def find_differences(
    first: Results, second: Results, by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> list[Difference]:
    """Success and every metric that both have, in every group of settings that both have.

    Runs are paired where settings and seeds are the same in both. By chance alone one of twenty
    questions would look answered, so the answers are corrected for how many were asked.

    Raises:
        StudyError: nothing can be compared.
    """
    keys = tuple(by) or tuple(k for k in first.parameters if k in second.parameters)
    one, two = _index_rows(first, keys), _index_rows(second, keys)
    groups = [values for values in one if values in two]
    if not groups:
        raise StudyError(f"{first.name} and {second.name} have no settings of {keys} in common")
    shared = {m.name for m in second.metrics} - {REAL_TIME_MULTIPLE.name}
    chosen = [m for m in first.select_metrics(metrics) if m.name in shared]
    questions: list[tuple[str, str, str, Comparison]] = []
    for values in groups:
        told = ", ".join(f"{k}={v}" for k, v in zip(keys, values, strict=True)) or "all"
        a, b, paired = _pair_rows(one[values], two[values])
        rates = compare_rates(first.compute_successes()[a], second.compute_successes()[b], paired)
        questions.append((told, "success", GREATER, rates))
        for m in chosen:
            found = compare_values(
                first.read_numbers(m.name)[a], second.read_numbers(m.name)[b], paired
            )
            questions.append((told, m.name, m.better, found))
    corrected = holm([found.p for *_, found in questions])
    return [
        Difference(
            group,
            name,
            found,
            p,
            _find_verdict(better, found) if p < SIGNIFICANCE_LEVEL else CHANCE,
        )
        for (group, name, better, found), p in zip(questions, corrected, strict=True)
    ]


def describe_differences(differences: Sequence[Difference], is_verbose: bool) -> str:
    """The differences in lines, the surest first; those that chance explains are only counted."""
    sure = [d for d in differences if d.verdict != CHANCE]
    shown = list(differences) if is_verbose else sorted(sure, key=lambda d: d.p)
    lines = []
    for d in shown:
        number = make_number_format((d.comparison.before, d.comparison.after))
        pairs = f"{d.comparison.count} {'pairs' if d.comparison.paired else 'runs'}"
        lines.append(
            f"{d.verdict:<7} {d.metric:<18} {number(d.comparison.before)} -> "
            f"{number(d.comparison.after)}  "
            f"p {d.p:.2g}  {pairs}  {d.group}"
        )
    lines.append(
        f"{len(sure)} of {len(differences)} comparisons are more than chance (Holm, "
        f"{SIGNIFICANCE_LEVEL:g} over all)"
    )
    return "\n".join(lines)


def _index_rows(results: Results, keys: Sequence[str]) -> dict[tuple, dict[tuple, int]]:
    """By settings, then by what tells a run among those of the same settings: its row."""
    drawn = {draw.key for draw in results.study.random_variations}
    others = sorted(key for key in results.study.keys if key not in (*keys, "seed"))
    columns = {key: results.read_column(key) for key in ("seed", *others)}
    varied = [found for key, found in columns.items()
              if key == "seed" or key in drawn or len(set(found)) > 1]  # fmt: skip
    return {
        values: {tuple(column[row] for column in varied): int(row) for row in rows}
        for values, rows in results.group_rows(keys).items()
    }


def _pair_rows(
    first: dict[tuple, int], second: dict[tuple, int]
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Rows of both; paired where at least nine of ten have a partner."""
    both = [key for key in first if key in second]
    if both and len(both) >= 0.9 * max(len(first), len(second)):
        return np.array([first[k] for k in both]), np.array([second[k] for k in both]), True
    return np.array(list(first.values())), np.array(list(second.values())), False


def _find_verdict(better: str, comparison: Comparison) -> str:
    if better not in (GREATER, SMALLER) or comparison.after == comparison.before:
        return DIFFERS
    return BETTER if (comparison.after > comparison.before) == (better == GREATER) else WORSE
