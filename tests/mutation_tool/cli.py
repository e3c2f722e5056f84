"""The command line of `tests/mutation`."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from . import changed
from .areas import AREAS, UnknownAreaError, area_named
from .campaign import Campaign, CampaignError, Outcome
from .equivalents import Equivalents, EquivalentsError
from .faults import Fault, sample
from .report import Report

TOP = Path(__file__).parents[2]


def main(arguments: list[str] | None = None) -> int:
    """0: the score is reached; 1: it is not, or time was up; 2: bad arguments or failing tests."""
    options = _parser().parse_args(arguments)
    try:
        return _run(options)
    except (UnknownAreaError, EquivalentsError, CampaignError) as error:
        print(f"mutation: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tests/mutation",
        description="Plant single faults in an area, one at a time, and see whether its tests "
        "find them. Works on copies under out/mutation.",
        epilog="example: tests/mutation vision --limit 50; tests/mutation changed --since main; "
        f"areas: {', '.join(AREAS)}",
    )
    parser.add_argument("area", help=f"see below, or {changed.NAME}: the lines that are new")
    parser.add_argument("--since", default="", metavar="COMMIT",
                        help="for changed: new since HEAD left this branch or commit "
                        f"({' or '.join(changed.BRANCHES)})")
    parser.add_argument("--limit", type=int, default=200, metavar="N", help="faults (200)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="which ones (1)")
    parser.add_argument("--only", default="", metavar="REGEX",
                        help="only faults whose 'file function line' has a match")
    parser.add_argument("--list", action="store_true", help="print the faults, run nothing")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (2)")
    parser.add_argument("--resume", action="store_true",
                        help="keep what was found before, and misses if nothing has changed")
    parser.add_argument("--record", action="store_true",
                        help="record tests anew that ran sources which have changed since")
    parser.add_argument("--minutes", type=float, default=1e6, metavar="M",
                        help="begin nothing new after M minutes; go on with --resume")
    parser.add_argument("--graph", action=argparse.BooleanOptionalAction, default=True,
                        help="also run the integration tests that the area names (yes)")
    parser.add_argument("--skip", default="", metavar="REGEX",
                        help="leave test files out whose path has a match")
    parser.add_argument("--budget", type=float, default=10.0, metavar="S",
                        help="processor seconds that a fault's tests take at most (10)")
    parser.add_argument("--goal", type=float, default=0.85, help="share to be found (0.85)")
    parser.add_argument("--folder", type=Path, default=TOP / "out" / "mutation",
                        help="for copies and results (out/mutation)")
    return parser


def _run(options: argparse.Namespace) -> int:
    lines = None
    if options.area == changed.NAME:
        lines = changed.changed_lines(TOP, options.since)
        area = changed.area_of(TOP, lines)
    else:
        area = area_named(options.area)
    sources = {str(f.relative_to(TOP)): f.read_bytes() for f in area.source_files(TOP)}
    faults = sample(sources, options.limit, options.seed, options.only, lines)
    if not faults:
        among = f"that matches --only {options.only}" if options.only else "can be planted"
        raise UnknownAreaError(f"area {area.name}: no fault {among}")
    if options.list:
        for fault in faults:
            print(f"{fault.key} {fault.file}:{fault.line} {fault.function}, {fault.operator}\n"
                  f"  - {fault.was}\n  + {fault.now}")
        return 0
    equivalents = Equivalents.load()
    deadline = time.monotonic() + 60.0 * options.minutes
    campaign = Campaign(
        area, TOP, options.folder, options.jobs, deadline, _say, graph=options.graph,
        skip=options.skip, budget=options.budget,
    )
    try:
        report = _campaign(campaign, faults, equivalents, options)
    finally:
        campaign.close()
    if report is None:
        _say("time is up while the tests are recorded; go on with --resume")
        return 1
    print(report.text(area.name))
    return 0 if report.reached(options.goal) else 1


def _campaign(
    campaign: Campaign, faults: list[Fault], equivalents: Equivalents,
    options: argparse.Namespace,
) -> Report | None:
    cover = campaign.record(options.record)
    if cover is None:
        return None
    if not options.resume:
        campaign.forget()
    report = Report(faults, {f.key for f in faults if equivalents.reason(f)}, cover)
    known = campaign.known()
    for fault in report.open:
        if fault.key in known:
            report.outcomes[fault.key] = known[fault.key]
    todo = [fault for fault in report.open if fault.key not in report.outcomes]
    _say(f"{len(faults)} faults, {len(report.equivalent)} equivalent, {len(todo)} to plant")
    for number, (fault, outcome) in enumerate(campaign.run(todo, cover), 1):
        report.outcomes[fault.key] = outcome
        _say(_line(number, len(todo), fault, outcome))
    return report


def _line(number: int, count: int, fault: Fault, outcome: Outcome) -> str:
    by = f" by {outcome.by.rpartition('/')[2]}" if outcome.by else ""
    return (f"[{number}/{count}] {outcome.how}{by}, {outcome.seconds:.1f} s: "
            f"{fault.file.rpartition('/')[2]}:{fault.line} {fault.operator}: {fault.now}")


def _say(text: str) -> None:
    print(text, flush=True)
