"""What a run shows: the faults that nothing found, a table by operator, and one line of JSON."""

from __future__ import annotations

import json

from .campaign import BAD, NO_TEST, Outcome
from .coverage_map import CoverageMap
from .faults import OPERATORS, Fault

_SHOWN_TESTS = 6


class Report:
    """The sample and what became of it.

    Attributes:
        equivalent: keys of the edits that are listed as no faults.
        open: the others, in the order drawn.
        outcomes: by key, of those that were planted.
    """

    def __init__(self, faults: list[Fault], equivalent: set[str], cover: CoverageMap) -> None:
        self._faults, self._cover = faults, cover
        self.equivalent = equivalent
        self.open = [fault for fault in faults if fault.key not in equivalent]
        self.outcomes: dict[str, Outcome] = {}

    @property
    def figures(self) -> dict[str, float]:
        """What the last line says; `seconds` is the processor time of a fault on average."""
        found = sum(outcome.found for outcome in self.outcomes.values())
        missed = len(self.outcomes) - found
        return {
            "sampled": len(self.equivalent) + len(self.outcomes), "found": found,
            "missed": missed, "equivalent": len(self.equivalent), "bad": len(self._bad()),
            "score": round(found / max(found + missed, 1), 4),
            "seconds": round(
                sum(o.seconds for o in self.outcomes.values()) / max(len(self.outcomes), 1), 2),
        }

    def reached(self, goal: float) -> bool:
        """All were planted, the goal is reached, and at most a tenth is called equivalent."""
        return (
            len(self.outcomes) == len(self.open) and self.figures["score"] >= goal
            and 10 * len(self.equivalent) <= len(self._faults)
        )

    def text(self, area: str) -> str:
        figures = self.figures
        lines = [*self._survivors(), *self._table(), *self._bad(), ""]
        left = len(self.open) - len(self.outcomes)
        if left:
            lines.append(f"{left} of {len(self._faults)} not planted yet; go on with --resume")
        if 10 * len(self.equivalent) > len(self._faults):
            lines.append("more than a tenth is listed as equivalent: that is too much")
        lines.append(json.dumps({"area": area, **figures}))
        return "\n".join(lines)

    def _survivors(self) -> list[str]:
        lines = []
        for fault in self.open:
            outcome = self.outcomes.get(fault.key)
            if outcome is None or outcome.found:
                continue
            lines += ["", f"{outcome.how}: {fault.file}:{fault.line} {fault.function} "
                      f"({fault.operator}, {fault.key})", f"  - {fault.was}", f"  + {fault.now}"]
            if outcome.how != NO_TEST:
                tests = self._cover.tests_of(fault)
                shown = ", ".join(name.rpartition("/")[2] for name in tests[:_SHOWN_TESTS])
                more = f" and {len(tests) - _SHOWN_TESTS} more" if tests[_SHOWN_TESTS:] else ""
                lines.append(f"  ran: {shown}{more}")
        return lines

    def _bad(self) -> list[str]:
        """The faults that were ended, each with what it did."""
        lines = []
        for fault in self.open:
            outcome = self.outcomes.get(fault.key)
            if outcome is not None and outcome.how in BAD:
                by = f" {outcome.by}" if outcome.by else ""
                lines.append(f"{outcome.how}{by}: {fault.file}:{fault.line} {fault.now}")
        return lines

    def _table(self) -> list[str]:
        lines = ["", f"{'operator':12}{'found':>7}{'missed':>8}{'no test':>9}{'equivalent':>12}"]
        for operator in OPERATORS:
            faults = [fault for fault in self._faults if fault.operator == operator]
            if faults:
                lines.append(self._row(operator, faults))
        lines.append(self._row("all", self._faults))
        hows = [outcome.how for outcome in self.outcomes.values() if outcome.found]
        kinds = ", ".join(f"{hows.count(how)} by {how}" for how in sorted(set(hows)))
        return [*lines, f"found: {kinds}" if hows else "found: none"]

    def _row(self, name: str, faults: list[Fault]) -> str:
        outcomes = [self.outcomes[f.key] for f in faults if f.key in self.outcomes]
        found = sum(outcome.found for outcome in outcomes)
        without = sum(outcome.how == NO_TEST for outcome in outcomes)
        equivalent = sum(fault.key in self.equivalent for fault in faults)
        missed = len(outcomes) - found - without
        return f"{name:12}{found:7}{missed:8}{without:9}{equivalent:12}"
