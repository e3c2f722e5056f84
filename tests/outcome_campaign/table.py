"""The campaign's table, its numbers and their bounds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from truth_checks.result import with_result

from .kinds import KINDS
from .trial import REFUSED, Judged

TABLE = Path(__file__).parents[2] / "docs" / "truth.md"
TITLE = "## What the loop says of its runs"
ALL, EACH = 0.95, 0.85  # least parts that are told right, of all runs and of each kind
REMEDIED, HELPED = 0.8, 0.7  # least parts of failed runs with a remedy, and of remedies that help
EXCEEDED, WORST = 0.005, 1.5  # of what is left open: part of the runs, and times of it
WIDTH = 3.0  # times the median error that the median of what is left open may be


def summary(found: Sequence[Judged]) -> dict[str, float]:
    """The numbers that the bounds are for."""
    by_kind = {name: [f.right for f in found if f.kind == name] for name in KINDS}
    there = [f for f in found if f.converged]
    excess = np.array([f.excess for f in there])
    followed = [f.helped for f in found if f.helped is not None]
    failed = [f for f in found if not f.converged and f.said != REFUSED]
    numbers = {
        "runs": len(found),
        "right": _part([f.right for f in found]),
        "least_kind": min(_part(rights) for rights in by_kind.values() if rights),
        "converged": len(there),
        "exceeded": _part(list(excess > 1.0)),
        "worst": float(excess.max(initial=0.0)),
        "failed": len(failed),
        "remedied": _part([bool(f.remedy) for f in failed]),
        "remedies_followed": len(followed),
        "remedies_helped": _part(followed),
        **by_faults(found),
    }
    for part in ("distance", "angle"):
        errors = np.array([getattr(f, part) for f in there])
        bounds = np.array([getattr(f, f"open_{part}") for f in there])
        if len(there):
            numbers[f"median_{part}"] = float(np.median(errors))
            numbers[f"median_open_{part}"] = float(np.median(bounds))
    return numbers


def by_faults(found: Sequence[Judged]) -> dict[str, float]:
    """Parts of the runs, by the number of faults provoked, that are told right; 'plain': of those
    without a fault, before targets of one pose that are exact enough, that are called 'converged'
    and no more."""
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
    """The bounds that are not met, in words."""
    checks = {
        f"right in {ALL:.0%} of all": numbers["right"] >= ALL,
        f"right in {EACH:.0%} of each kind": numbers["least_kind"] >= EACH,
        f"left open exceeded in {EXCEEDED:.1%} at most": numbers["exceeded"] <= EXCEEDED,
        f"left open never exceeded {WORST:g} times": numbers["worst"] <= WORST,
        f"a remedy in {REMEDIED:.0%} of the failed runs": numbers["remedied"] >= REMEDIED,
        f"{HELPED:.0%} of the remedies help": numbers["remedies_helped"] >= HELPED,
    }
    for part in ("distance", "angle"):
        if f"median_{part}" in numbers:
            width = numbers[f"median_open_{part}"] / max(numbers[f"median_{part}"], 1e-9)
            checks[f"{part} left open within {WIDTH:g} times the median error"] = width <= WIDTH
    return [name for name, met in checks.items() if not met]


def markdown(found: Sequence[Judged]) -> str:
    """A row for each kind, and a sentence of what is left open."""
    rows = [
        "| provoked | right is | said | right | remedy followed |",
        "|---|---|---|---|---|",
    ]
    for name, kind in KINDS.items():
        of_kind = [f for f in found if f.kind == name]
        if not of_kind:
            continue
        said = Counter("converged" if f.converged else f.said for f in of_kind)
        words = ", ".join(f"{word} {count}" for word, count in said.most_common())
        advice = _followed(of_kind)
        text = kind.text.replace("\n    ", " ")
        rows.append(
            f"| {text} | {' or '.join(kind.right)} | {words} | "
            f"{sum(f.right for f in of_kind)} of {len(of_kind)} | {advice} |"
        )
    numbers = summary(found)
    text = "\n".join(rows)
    if parts := by_faults(found):
        words = {
            "fault_free": "without a fault", "plain": "plainly converged of those that must be",
            "one_fault": "with one fault", "two_faults": "with two faults",
        }  # fmt: skip
        text += "\n\nRight, by faults provoked: " + ", ".join(
            f"{parts[name]:.1%} {word}" for name, word in words.items() if name in parts
        ) + "."
    if "median_distance" in numbers:
        text += (
            f"\n\nRight in {numbers['right']:.1%} of {numbers['runs']} runs. Of "
            f"{numbers['converged']} that were called converged, {numbers['exceeded']:.1%} were "
            f"farther from the goal than was left open, {numbers['worst']:.2f} times at most. "
            f"Median error {1e3 * numbers['median_distance']:.2f} mm and "
            f"{np.degrees(numbers['median_angle']):.3f} degrees, median of what is left open "
            f"{1e3 * numbers['median_open_distance']:.2f} mm and "
            f"{np.degrees(numbers['median_open_angle']):.3f} degrees."
        )
    return f"{text}\n\n{_remedies(found)}"


def _remedies(found: Sequence[Judged]) -> str:
    """A row for each outcome of a run that failed: how many had a remedy, and what it achieved."""
    rows = ["| outcome | failed runs | with a remedy | remedy followed |", "|---|---|---|---|"]
    failed = [f for f in found if not f.converged]
    for said, count in Counter(f.said for f in failed).most_common():
        of_kind = [f for f in failed if f.said == said]
        given = sum(bool(f.remedy) for f in of_kind)
        rows.append(f"| {said} | {count} | {given} | {_followed(of_kind)} |")
    return "\n".join(rows)


def _followed(found: Sequence[Judged]) -> str:
    """How many of the runs whose remedy was applied converge with it, as text."""
    helped = [f.helped for f in found if f.helped is not None]
    return f"{sum(helped)} of {len(helped)} then converge" if helped else ""


def section(text: str, found: Sequence[Judged], seeds: Sequence[int]) -> str:
    """A page's text with this campaign's section, its last, in place of the one before."""
    before = text.partition(TITLE)[0].rstrip()
    head = (
        f"{TITLE}\n\nMade by `tests/outcomes --write`, seeds {' and '.join(map(str, seeds))}. "
        "Faults of known kinds are provoked; which outcomes are right is written down before the "
        "run. *converged* is right only where the camera stands within what is left open.\n\n"
    )
    return with_result(f"{before}\n\n{head}{markdown(found)}\n")


def section_of(text: str) -> str:
    """This campaign's section of a page, with the empty line before; empty where it has none."""
    _, title, section = text.partition(TITLE)
    return f"\n{title}{section}" if title else ""


def _part(values: Sequence[bool]) -> float:
    return float(np.mean(values)) if len(values) else 1.0
