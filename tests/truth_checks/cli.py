"""The command line of `tests/truth`."""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from pathlib import Path

from outcome_campaign.table import section_of

from . import (  # noqa: F401 (they enter their checks)
    calibration,
    dynamics,
    gripping,
    interaction,
    joints,
    light,
    motion,
    repeats,
    sensor,
    storms,
    vision,
    whole_runs,
)
from .check import CHECKS, Check, Row
from .result import with_result

TOP = Path(__file__).parents[2]
TABLE = TOP / "docs" / "truth.md"
_HEAD = """# What is true, and how it is known

Made by `tests/truth --write`. Each line compares the simulator with software that shares no code
with it, or with a closed form; *measured* is the worst that was found, *bound* what it may be.
`tests/truth NAME ...` repeats some, `tests/truth --quick` the short choice that CI runs.

| check | against | compared | expected | measured | bound | |
|---|---|---|---|---|---|---|
"""
_TAIL = """
## What is not exact, and how far off it is

All of it where Bullet makes the steps, that is where something can touch something or a base flies.

- *Sliding aslant to a long box's edges* is right to 1 % for loose bodies (see "contact friction"):
  what Bullet, whose two directions of friction weigh differently, got wrong in one step is given
  back in the next. Bodies with joints that slide without standing keep Bullet's friction: up to a
  fifth too little on a foot of 0.6 x 0.1 m, and bends its path.
- *Stops of robots whose base is free and does not stand*: passed by what the joint travels in one
  step (see "joint stops of a free base"), and given back in the next ones. Stops of bolted
  robots, and of those that stand, are not passed.
- *The smaller of two friction coefficients* is what acts between any two links. Bullet keeps one
  number a link and multiplies; where links touch each other in a ring whose smallest coefficients
  no such numbers have as their products, the nearest are taken, in least squares of logarithms.
- *What strikes a standing base* rebounds for one step as from a wall: its speed after is wrong by
  the share its mass has of the base's, at most 1 %, since no base is held while anything heavier
  than a hundredth of it is loose. Momentum is kept.
- *Wheels given as meshes* are the prisms that their triangles make, and bump.
- *Models with joints that fall* leave with up to 14 % of their speed, for Bullet pushes them out of
  what they sank into within a step; loose bodies are put where they strike (see "drops"), and
  alone bounce where a file asks for it.
- *A robot that something touches* is Bullet's for as long as that is near: its joints are off by
  1e-6 rad then, and by what other bodies that are near it, too, do to Bullet's sweeps.
"""


def main(arguments: list[str] | None = None) -> int:
    """0: all within bounds; 1: something is not; 2: no such check."""
    options = _parser().parse_args(arguments)
    unknown = set(options.names) - set(CHECKS)
    if unknown:
        print(f"truth: no check '{min(unknown)}' among {', '.join(CHECKS)}", file=sys.stderr)
        return 2
    chosen = [c for c in CHECKS.values()
              if c.name in (options.names or CHECKS) and (c.quick or not options.quick)]
    if options.list:
        for check in chosen:
            print(f"{check.name:32}{'quick' if check.quick else '':8}{check.against}")
        return 0
    logging.disable(logging.WARNING)  # of limits that act
    found = []
    for check in chosen:
        began = time.process_time()
        for row in check.rows():
            found.append((check, row))
            print(line(check, row), flush=True)
        print(f"    {time.process_time() - began:.1f} s", flush=True)
    if options.write:
        before = TABLE.read_text(encoding="utf-8") if TABLE.exists() else ""
        page = _HEAD + _rows(found, before) + _TAIL + section_of(before)
        TABLE.write_text(with_result(page), encoding="utf-8")
    failed = [f"{c.name}: {r.what}" for c, r in found if not r.passed]
    print(json.dumps({"rows": len(found), "failed": failed}))
    return 1 if failed else 0


def _rows(found: list[tuple[Check, Row]], before: str) -> str:
    """Lines of the table: those found, and of the other checks those of the page before."""
    own = {check.name: [] for check, _ in found}
    for check, row in found:
        own[check.name].append(markdown(check, row))
    for line in before.splitlines(keepends=True):
        name = line.split(" | ")[0].removeprefix("| ")
        if name in CHECKS and name not in {check.name for check, _ in found}:
            own.setdefault(name, []).append(line)
    return "".join(line for name in CHECKS for line in own.get(name, ()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="tests/truth", description="Compare physics and "
                                     "sensors with independent software.",
                                     epilog="example: tests/truth 'joint stops' stack")
    parser.add_argument("names", nargs="*", help="checks, as --list names them; all")
    parser.add_argument("--quick", action="store_true", help="only what CI runs")
    parser.add_argument("--list", action="store_true", help="names only")
    parser.add_argument("--write", action="store_true", help="write docs/truth.md; rows "
                        "of checks that are not made stay")
    return parser


def number(value: float, unit: str) -> str:
    """Two digits and the unit."""
    return f"{value:.2g} {unit}".strip()


def line(check: Check, row: Row) -> str:
    """The row for a terminal."""
    return (f"{'ok  ' if row.passed else 'FAIL'} {check.name:24} {row.what:52} "
            f"{number(row.measured, row.unit):>16} (<= {number(row.bound, row.unit)})")


def markdown(check: Check, row: Row) -> str:
    """The row for the documentation."""
    return (f"| {check.name} | {check.against} | {row.what} | {row.expected} | "
            f"{number(row.measured, row.unit)} | {number(row.bound, row.unit)} | "
            f"{'' if row.passed else '**no**'} |\n")
