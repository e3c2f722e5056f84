"""Check that consecutive report messages of a loop are consistent with each other."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

OPEN = ("running", "converged")  # outcomes of a run that nothing speaks against
STEADY = 1.0  # s for which an outcome has been reported before it may not alternate
MOST = 5  # contradictions that are listed


class Report(NamedTuple):
    """What a ServoReport says: its stamp in s, and texts."""

    stamp: float
    outcome: str
    reason: str = ""
    remedy: str = ""
    phase: str = "servoing"

    @classmethod
    def from_message(cls, message: Any) -> Report:
        """Return what a ServoReport message says."""
        return cls(message.header.stamp.to_sec(), message.outcome, message.reason, message.remedy,
                   message.phase)  # fmt: skip


def contradictions(reports: Iterable[Report]) -> list[str]:
    """Return contradictions in reports as text, the first few.

    An outcome of a failed run has a reason and a remedy, an open one no remedy; and an outcome that
    has been reported for STEADY s does not come back within STEADY s of another one.
    """
    found: list[str] = []
    episodes: list[list[Any]] = []  # outcome, first and last stamp, of an arm that servoes
    for report in reports:
        when, kind = report.stamp, report.outcome
        is_open = kind.startswith(OPEN)
        if not is_open and not (report.reason and report.remedy):
            found.append(f"{when:.2f} s: {kind} has the reason '{report.reason}' and the remedy "
                         f"'{report.remedy}'")  # fmt: skip
        if kind == "running" and report.remedy:
            found.append(f"{when:.2f} s: running has the remedy '{report.remedy}'")
        if report.phase != "servoing":
            episodes.clear()
            continue
        if episodes and episodes[-1][0] == kind:
            episodes[-1][2] = when
            continue
        episodes.append([kind, when, when])
        if len(episodes) < 3 or episodes[-3][0] != kind or kind == "running":
            continue
        before, between = episodes[-3], episodes[-2]
        if before[2] - before[1] >= STEADY and when - between[1] < STEADY:
            found.append(f"{when:.2f} s: {kind} alternates with {between[0]}")
    return found[:MOST]
