"""Result of a group of faults: counts, and output as a table and as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field


@dataclass
class Outcome:
    """Of one group of faults.

    Attributes:
        name: of the group.
        injected: faults. survived: after how many everything was as before.
        recovered: longest time until it was, s of wall time.
        lost: state that did not come back, in words. hung: what did not answer.
        leaked: what grew and stayed.
        note: figures of the group's own.
    """

    name: str
    injected: int = 0
    survived: int = 0
    recovered: float = 0.0
    lost: list[str] = field(default_factory=list)
    hung: list[str] = field(default_factory=list)
    leaked: list[str] = field(default_factory=list)
    note: str = ""

    @property
    def clean(self) -> bool:
        return self.survived == self.injected and not (self.lost or self.hung or self.leaked)


COLUMNS = ("fault", "injected", "survived", "recovered after", "lost", "hung", "leaked")


def table(outcomes: Sequence[Outcome]) -> str:
    """Return a table with one line per group, followed by what was lost, did not answer or leaked.
    """
    rows = [
        (o.name, str(o.injected), str(o.survived), f"{o.recovered:.1f} s",
         str(len(o.lost)), str(len(o.hung)), str(len(o.leaked)))
        for o in outcomes
    ]  # fmt: skip
    widths = [max(len(row[i]) for row in (COLUMNS, *rows)) for i in range(len(COLUMNS))]

    def line(cells: Sequence[str]) -> str:
        return "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ).rstrip()

    lines = [line(COLUMNS), line(["-" * width for width in widths])]
    for outcome, row in zip(outcomes, rows, strict=True):
        lines.append(line(row))
        if outcome.note:
            lines.append(f"    {outcome.note}")
        for kind in ("lost", "hung", "leaked"):
            lines += [f"    {kind}: {what}" for what in getattr(outcome, kind)]
    return "\n".join(lines)


def summary(outcomes: Sequence[Outcome]) -> str:
    return json.dumps({
        "injected": sum(o.injected for o in outcomes),
        "survived": sum(o.survived for o in outcomes),
        "clean": all(o.clean for o in outcomes),
        "groups": [asdict(o) for o in outcomes],
    })  # fmt: skip
