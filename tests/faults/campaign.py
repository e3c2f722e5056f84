#!/usr/bin/env python3
"""Inject faults into the running graph and report what is lost: ./test.sh --faults [--help].

Starts the shipped launch files on a master of its own, and after each fault looks whether robot,
controllers, clock, joint states, images and nodes are as before. At the end a table, and a line of
JSON; the status is 1 where anything was lost, hung or leaked.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "integration")]

from ros_graph import GraphError  # noqa: E402

from faults import clocks, disk, models, processes, services, servoing, traffic  # noqa: E402
from faults.bed import Bed, Group, UnansweredError  # noqa: E402
from faults.outcome import Outcome, summary, table  # noqa: E402

GROUPS: tuple[Group, ...] = (
    *traffic.GROUPS, *services.GROUPS, *models.GROUPS, *clocks.GROUPS, *disk.GROUPS,
    *servoing.GROUPS, *processes.GROUPS,
)  # fmt: skip


def run(directory: Path, groups: tuple[Group, ...], scale: float, seed: int) -> list[Outcome]:
    """Inject the groups, one after another, into a graph of its own; where one of them cannot go
    on, that is its result, and the next one gets a new graph."""
    outcomes = []
    bed = Bed(directory)
    try:
        bed.start()
        for group in groups:
            began = time.monotonic()
            print(f"{group.__name__} ...", end=" ", flush=True)
            try:
                outcomes.append(group(bed, scale, seed))
            except (GraphError, UnansweredError, OSError) as error:
                outcomes.append(Outcome(group.__name__, 1, hung=[f"could not go on: {error}"]))
                bed.start_anew()
            print(f"{outcomes[-1].survived}/{outcomes[-1].injected} in "
                  f"{time.monotonic() - began:.0f} s", flush=True)  # fmt: skip
    finally:
        bed.close()
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(prog="./test.sh --faults", description=__doc__.splitlines()[0],
                                     epilog="example: ./test.sh --faults --only 'flood|garbage'")
    parser.add_argument("--only", default="", metavar="REGEX", help="groups whose name matches")
    parser.add_argument("--scale", type=float, default=1.0, help="part of the faults (default 1)")
    parser.add_argument("--seed", type=int, default=0, help="of all that is drawn (default 0)")
    parser.add_argument("--logs", type=Path, metavar="DIR", help="keep there what the nodes print")
    parser.add_argument("--list", action="store_true", help="print the groups and what they do")
    given = parser.parse_args()
    if not 0.0 < given.scale <= 100.0:
        parser.error(f"--scale must be above 0 and at most 100, not {given.scale}")
    chosen = tuple(group for group in GROUPS if re.search(given.only, group.__name__))
    if not chosen:
        parser.error(f"no group matches '{given.only}': {', '.join(g.__name__ for g in GROUPS)}")
    if given.list:
        for group in chosen:
            print(f"{group.__name__:18} {' '.join(group.__doc__.split())}")
        return 0
    with tempfile.TemporaryDirectory() as directory:
        if given.logs:
            given.logs.mkdir(parents=True, exist_ok=True)
        logs = given.logs.resolve() if given.logs else Path(directory)
        outcomes = run(logs, chosen, given.scale, given.seed)
    print(f"\n{table(outcomes)}\n{summary(outcomes)}")
    return 0 if all(outcome.clean for outcome in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
