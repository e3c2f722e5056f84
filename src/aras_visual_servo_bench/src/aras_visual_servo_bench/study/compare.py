"""Two studies held against each other: which of the differences are more than chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import StudyError
from ..numbers.metrics import GREATER, SMALLER
from ..numbers.printing import notation
from ..numbers.statistics import Comparison, compare_rates, compare_values, holm
from .results import REAL_TIME, Results

LEVEL = 0.05
# What the second is. DIFFERS: of a metric that is neither good nor bad, or by more than the median.
BETTER, WORSE, DIFFERS, CHANCE = "better", "WORSE", "differs", "chance"


@dataclass(frozen=True)
class Difference:
    """One question. group: settings it was asked for. metric: of what. p: corrected by Holm.

    verdict: BETTER, WORSE or DIFFERS, CHANCE where p leaves that open.
    """

    group: str
    metric: str
    found: Comparison
    p: float
    verdict: str


def differences(
    first: Results, second: Results, by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> list[Difference]:
    """Success and every metric that both have, in every group of settings that both have.

    Runs are paired where settings and seeds are the same in both. By chance alone one of twenty
    questions would look answered, so the answers are corrected for how many were asked.

    Raises:
        StudyError: nothing can be compared.
    """
    keys = tuple(by) or tuple(k for k in first.parameters if k in second.parameters)
    one, two = _indexed(first, keys), _indexed(second, keys)
    groups = [values for values in one if values in two]
    if not groups:
        raise StudyError(f"{first.name} and {second.name} have no settings of {keys} in common")
    shared = {m.name for m in second.metrics} - {REAL_TIME.name}
    chosen = [m for m in first.chosen(metrics) if m.name in shared]
    questions: list[tuple[str, str, str, Comparison]] = []
    for values in groups:
        told = ", ".join(f"{k}={v}" for k, v in zip(keys, values, strict=True)) or "all"
        a, b, paired = _pairs(one[values], two[values])
        rates = compare_rates(first.successes()[a], second.successes()[b], paired)
        questions.append((told, "success", GREATER, rates))
        for m in chosen:
            found = compare_values(first.numbers(m.name)[a], second.numbers(m.name)[b], paired)
            questions.append((told, m.name, m.better, found))
    corrected = holm([found.p for *_, found in questions])
    return [
        Difference(group, name, found, p, _verdict(better, found) if p < LEVEL else CHANCE)
        for (group, name, better, found), p in zip(questions, corrected, strict=True)
    ]


def told(found: Sequence[Difference], all_of_them: bool) -> str:
    """The differences in lines, the surest first; those that chance explains are only counted."""
    sure = [d for d in found if d.verdict != CHANCE]
    shown = list(found) if all_of_them else sorted(sure, key=lambda d: d.p)
    lines = []
    for d in shown:
        number = notation((d.found.before, d.found.after))
        pairs = f"{d.found.count} {'pairs' if d.found.paired else 'runs'}"
        lines.append(
            f"{d.verdict:<7} {d.metric:<18} {number(d.found.before)} -> {number(d.found.after)}  "
            f"p {d.p:.2g}  {pairs}  {d.group}"
        )
    lines.append(
        f"{len(sure)} of {len(found)} comparisons are more than chance (Holm, {LEVEL:g} over all)"
    )
    return "\n".join(lines)


def _indexed(results: Results, keys: Sequence[str]) -> dict[tuple, dict[tuple, int]]:
    """By settings, then by what tells a run among those of the same settings: its row."""
    drawn = {draw.key for draw in results.study.draws}
    others = sorted(key for key in results.study.keys if key not in (*keys, "seed"))
    columns = {key: results.column(key) for key in ("seed", *others)}
    varied = [found for key, found in columns.items()
              if key == "seed" or key in drawn or len(set(found)) > 1]  # fmt: skip
    return {
        values: {tuple(column[row] for column in varied): int(row) for row in rows}
        for values, rows in results.groups(keys).items()
    }


def _pairs(
    one: dict[tuple, int], two: dict[tuple, int]
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Rows of both; paired where at least nine of ten have a partner."""
    both = [key for key in one if key in two]
    if both and len(both) >= 0.9 * max(len(one), len(two)):
        return np.array([one[k] for k in both]), np.array([two[k] for k in both]), True
    return np.array(list(one.values())), np.array(list(two.values())), False


def _verdict(better: str, found: Comparison) -> str:
    if better not in (GREATER, SMALLER) or found.after == found.before:
        return DIFFERS
    return BETTER if (found.after > found.before) == (better == GREATER) else WORSE
