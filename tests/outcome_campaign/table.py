"""Table of the outcome campaign, its figures and their bounds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from truth_checks.result import with_result

from .kinds import KINDS
from .trial import REFUSED, Judged

TABLE = Path(__file__).parents[2] / "docs" / "truth.md"
TITLE = "## Accuracy of outcomes"
ALL, EACH = 0.95, 0.85  # least fractions of correct outcomes, in all runs and in each kind
# Least fraction of failed runs that have a remedy, and of remedies that help.
REMEDIED, HELPED = 0.8, 0.7
EXCEEDED, WORST = 0.005, 1.5  # uncertainty: largest fraction of runs beyond it, and largest ratio
WIDTH = 3.0  # largest ratio of the median uncertainty to the median error


def summary(found: Sequence[Judged]) -> dict[str, float]:
    by_kind = {name: [f.right for f in found if f.kind == name] for name in KINDS}
    there = [f for f in found if f.converged]
    excess = np.array([f.excess for f in there])
    followed = [f.helped for f in found if f.helped is not None]
    failed = [f for f in found if not f.converged and f.said != REFUSED]
    numbers = {
        "runs": len(found), "right": _part([f.right for f in found]),
        "least_kind": min(_part(rights) for rights in by_kind.values() if rights),
        "converged": len(there), "exceeded": _part(list(excess > 1.0)),
        "worst": float(excess.max(initial=0.0)),
        "failed": len(failed), "remedied": _part([bool(f.remedy) for f in failed]),
        "remedies_followed": len(followed), "remedies_helped": _part(followed), **by_faults(found),
    }  # fmt: skip
    for part in ("distance", "angle") if there else ():
        for name, field in ((f"median_{part}", part), (f"median_open_{part}", f"open_{part}")):
            numbers[name] = float(np.median([getattr(f, field) for f in there]))
    return numbers


def by_faults(found: Sequence[Judged]) -> dict[str, float]:
    """Return the fraction of correct outcomes, by the number of injected faults."""
    parts = {
        name: [f.right for f in found if KINDS[f.kind].faults == count]
        for count, name in enumerate(("fault_free", "one_fault", "two_faults"))
    }
    parts["plain"] = [
        f.right and f.said == "converged" for f in found
        if KINDS[f.kind].faults == 0 and KINDS[f.kind].right == ("converged",)
        and not KINDS[f.kind].alike
    ]  # fmt: skip
    return {name: _part(rights) for name, rights in parts.items() if rights}


def failures(numbers: dict[str, float]) -> list[str]:
    checks = {
        f"correct in {ALL:.0%} of all runs": numbers["right"] >= ALL,
        f"correct in {EACH:.0%} of each kind": numbers["least_kind"] >= EACH,
        f"uncertainty exceeded in {EXCEEDED:.1%} at most": numbers["exceeded"] <= EXCEEDED,
        f"uncertainty never exceeded {WORST:g} times": numbers["worst"] <= WORST,
        f"a remedy in {REMEDIED:.0%} of the failed runs": numbers["remedied"] >= REMEDIED,
        f"{HELPED:.0%} of the remedies help": numbers["remedies_helped"] >= HELPED,
    }
    for part in ("distance", "angle"):
        if f"median_{part}" in numbers:
            width = numbers[f"median_open_{part}"] / max(numbers[f"median_{part}"], 1e-9)
            name = f"uncertainty of {part} within {WIDTH:g} times the median error"
            checks[name] = width <= WIDTH
    return [name for name, met in checks.items() if not met]


def markdown(found: Sequence[Judged]) -> str:
    """Format one row for each kind, and a sentence about the uncertainty."""
    rows = ["| injected fault | correct outcomes | reported outcomes | correct | remedy applied |",
            "|---|---|---|---|---|"]  # fmt: skip
    for name, kind in KINDS.items():
        if not (of_kind := [f for f in found if f.kind == name]):
            continue
        said = Counter("converged" if f.converged else f.said for f in of_kind)
        words = ", ".join(f"{word} {count}" for word, count in said.most_common())
        text = kind.text.replace("\n    ", " ")
        rights = sum(f.right for f in of_kind)
        rows.append(f"| {text} | {' or '.join(kind.right)} | {words} | {rights}"
                    f" of {len(of_kind)} | {_followed(of_kind)} |")  # fmt: skip
    numbers, text = summary(found), "\n".join(rows)
    if parts := by_faults(found):
        words = {"fault_free": "without a fault", "one_fault": "with one fault",
                 "two_faults": "with two faults"}  # fmt: skip
        text += "\n\nThe outcome is correct in " + ", ".join(
            f"{parts[name]:.1%} of the runs {word}" for name, word in words.items() if name in parts
        ) + "."
        if "plain" in parts:
            text += (f" In {parts['plain']:.1%} of the runs without a fault that must converge, "
                     "the outcome is `converged` without a larger uncertainty.")  # fmt: skip
    if "median_distance" in numbers:
        text += (
            f"\n\nThe servo loop reports a correct outcome in {numbers['right']:.1%} of "
            f"{numbers['runs']} runs. Of {numbers['converged']} runs with the outcome `converged`, "
            f"{numbers['exceeded']:.1%} had an error above the reported uncertainty; the largest "
            f"ratio of the error to the uncertainty was {numbers['worst']:.2f}. In these runs, the "
            f"median error was {1e3 * numbers['median_distance']:.2f} mm and "
            f"{np.degrees(numbers['median_angle']):.3f} degrees, and the median uncertainty was "
            f"{1e3 * numbers['median_open_distance']:.2f} mm and "
            f"{np.degrees(numbers['median_open_angle']):.3f} degrees."
        )
    return f"{text}\n\n{_remedies(found)}"


def _remedies(found: Sequence[Judged]) -> str:
    """Format one row for each outcome of failed runs: number with a remedy, and its effect."""
    rows = ["| outcome | failed runs | with a remedy | remedy applied |", "|---|---|---|---|"]
    failed = [f for f in found if not f.converged]
    for said, count in Counter(f.said for f in failed).most_common():
        of_kind = [f for f in failed if f.said == said]
        given = sum(bool(f.remedy) for f in of_kind)
        rows.append(f"| {said} | {count} | {given} | {_followed(of_kind)} |")
    return "\n".join(rows)


def _followed(found: Sequence[Judged]) -> str:
    """Return as text how many runs converge after their remedy was applied."""
    helped = [f.helped for f in found if f.helped is not None]
    return f"{sum(helped)} of {len(helped)} converge" if helped else ""


def section(text: str, found: Sequence[Judged], seeds: Sequence[int]) -> str:
    """Return the text of a page with an updated section of this campaign, its last."""
    before = text.partition(TITLE)[0].rstrip()
    head = (
        f"{TITLE}\n\nEach row of this table describes runs with injected faults of a known "
        "kind, whose correct outcomes are defined before the run. The outcome `converged` is "
        "correct only if the error of the camera's pose is within the reported uncertainty. "
        "`tests/outcomes --write` generates the table, here with the seeds "
        f"{' and '.join(map(str, seeds))}.\n\n"
    )
    return with_result(f"{before}\n\n{head}{markdown(found)}\n")


def section_of(text: str) -> str:
    """Return this campaign's section of a page with a leading empty line, or an empty text."""
    _, title, section = text.partition(TITLE)
    return f"\n{title}{section}" if title else ""


def _part(values: Sequence[bool]) -> float:
    return float(np.mean(values)) if len(values) else 1.0
