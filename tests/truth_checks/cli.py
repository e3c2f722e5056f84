"""Command line of `tests/truth`."""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from outcome_campaign.table import section_of

from . import (  # noqa: F401 (importing a module registers its checks)
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
_HEAD = """# Accuracy of the simulator

The table lists comparisons of the simulator with a closed form, or with software that shares no
code with it. *Measured* is the largest deviation that was found, and *bound* is the largest
deviation that is allowed. `tests/truth NAME ...` repeats the named checks, and
`tests/truth --write` generates this page.

| check | compared with | case | expected | measured | bound | |
|---|---|---|---|---|---|---|
"""
_TAIL = """
## Known inaccuracies

These inaccuracies occur only in simulation steps that Bullet computes: steps in which bodies can
touch each other or the base of a robot is free.

- *Sliding at an angle to the edges of a long box*: for single bodies, the friction is accurate to
  1 % (see "contact friction"). For sliding models with joints, Bullet computes too little
  friction: on a foot of 0.6 x 0.1 m, the friction is up to a fifth too low, and the path is
  curved.
- *Joint stops of a robot whose base is free and moving* are exceeded by the motion of the joint in
  one step (see "joint stops of a free base"), which the following steps correct. If the base of the
  robot is fixed or at rest, the joint stops are never exceeded.
- *The friction coefficient of a contact* is the smaller one of the coefficients of the two links.
  If many links touch each other in a ring, Bullet approximates the friction coefficients of their
  contacts.
- *A body that hits a free base at rest* rebounds for one step as from a wall. The relative error of
  the body's speed is at most 1 %, because a base is held at rest only if all loose bodies are
  lighter than a hundredth of the base. Momentum is conserved.
- *Wheels that are meshes* roll over the edges of the mesh, so they do not roll smoothly.
- *Falling models with joints* rebound with up to 14 % of their speed, because Bullet pushes them
  out of the body that they penetrated during a step. Single bodies are placed at the point of
  contact (see "drops") and rebound only if their description contains a restitution coefficient.
- *A robot close to another body* is simulated by Bullet: the error of its joint positions is then
  1e-6 rad, plus the effect of other close bodies on the convergence of Bullet's solver.
"""


def main(
    arguments: list[str] | None = None, checks: Mapping[str, Check] = CHECKS, table: Path = TABLE
) -> int:
    """Run the checks; return 0 if all are within bounds, 1 if one is not, 2 for an unknown name."""
    options = _parser().parse_args(arguments)
    unknown = set(options.names) - set(checks)
    if unknown:
        print(f"truth: no check '{min(unknown)}' among {', '.join(checks)}", file=sys.stderr)
        return 2
    chosen = [c for c in checks.values()
              if c.name in (options.names or checks) and (c.quick or not options.quick)]
    if options.list:
        for check in chosen:
            print(f"{check.name:32}{'quick' if check.quick else '':8}{check.against}")
        return 0
    logging.disable(logging.WARNING)  # warnings about joint limits are expected
    found = []
    for check in chosen:
        began = time.process_time()
        for row in check.rows():
            found.append((check, row))
            print(line(check, row), flush=True)
        print(f"    {time.process_time() - began:.1f} s", flush=True)
    if options.write:
        before = table.read_text(encoding="utf-8") if table.exists() else ""
        page = _HEAD + _rows(found, before, checks) + _TAIL + section_of(before)
        table.write_text(with_result(page), encoding="utf-8")
    failed = [f"{c.name}: {r.what}" for c, r in found if not r.passed]
    print(json.dumps({"rows": len(found), "failed": failed}))
    return 1 if failed else 0


def _rows(found: list[tuple[Check, Row]], before: str, checks: Mapping[str, Check]) -> str:
    """Return the rows of the table: new ones, and the previous ones of checks that did not run."""
    own = {check.name: [] for check, _ in found}
    for check, row in found:
        own[check.name].append(markdown(check, row))
    for line in before.splitlines(keepends=True):
        name = line.split(" | ")[0].removeprefix("| ")
        if name in checks and name not in {check.name for check, _ in found}:
            own.setdefault(name, []).append(line)
    return "".join(line for name in checks for line in own.get(name, ()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="tests/truth", description="Compare physics and "
                                     "sensors with independent software.",
                                     epilog="example: tests/truth 'joint stops' stack")
    parser.add_argument("names", nargs="*", help="names of checks, see --list (default: all)")
    parser.add_argument("--quick", action="store_true", help="run only the checks that CI runs")
    parser.add_argument("--list", action="store_true", help="print names of checks and exit")
    parser.add_argument("--write", action="store_true", help="write docs/truth.md; rows "
                        "of other checks do not change")
    return parser


def number(value: float, unit: str) -> str:
    return f"{value:.2g} {unit}".strip()


def line(check: Check, row: Row) -> str:
    return (f"{'ok  ' if row.passed else 'FAIL'} {check.name:24} {row.what:52} "
            f"{number(row.measured, row.unit):>16} (<= {number(row.bound, row.unit)})")


def markdown(check: Check, row: Row) -> str:
    return (f"| {check.name} | {check.against} | {row.what} | {row.expected} | "
            f"{number(row.measured, row.unit)} | {number(row.bound, row.unit)} | "
            f"{'' if row.passed else '**no**'} |\n")
