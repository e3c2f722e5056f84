"""Command line of `tests/outcomes`."""

from __future__ import annotations

import argparse
import json
import logging
import multiprocessing
import secrets
import sys
import time
from collections.abc import Iterable, Iterator
from functools import partial

from . import unfamiliar  # noqa: F401  it enters its kinds
from .kinds import KINDS, Trial
from .table import TABLE, failures, markdown, section, summary
from .trial import Judged, judged

KEPT = 2016  # the seed that is kept; the other one is drawn anew at each run of the command
FOLLOWED = 4  # the remedy of one trial in so many is applied, without --follow


def main(arguments: list[str] | None = None) -> int:
    """Run the campaign; return 0 if all bounds are met, 1 if not, 2 for an unknown kind."""
    options = _parser().parse_args(arguments)
    unknown = set(options.kinds) - set(KINDS)
    if unknown:
        print(f"outcomes: no kind '{min(unknown)}' among {', '.join(KINDS)}", file=sys.stderr)
        return 2
    if options.list:
        for kind in KINDS.values():
            print(f"{kind.name:32}{' or '.join(kind.right):32}{kind.text}")
        return 0
    logging.disable(logging.CRITICAL)  # what the loops say of their faults
    began = time.monotonic()
    drawn = secrets.randbelow(2**31) if options.seed is None else options.seed
    seeds = (KEPT,) if options.kept else (KEPT, drawn)
    print(f"seeds {', '.join(map(str, seeds))}; {options.runs} runs per kind", flush=True)
    found = []
    every = 1 if options.follow else FOLLOWED
    chosen = trials(seeds, options.runs, options.kinds)
    for result in carried_out(chosen, options.workers, every):
        found.append(result)
        if not result.right or result.helped is False or options.verbose:
            print(_line(result), flush=True)
    numbers = summary(found)
    print(markdown(found))
    if options.write:
        TABLE.write_text(section(TABLE.read_text(encoding="utf-8"), found, seeds),
                         encoding="utf-8")  # fmt: skip
    missed = failures(numbers)
    print(json.dumps({**numbers, "seconds": round(time.monotonic() - began), "missed": missed}))
    return 1 if missed else 0


def trials(seeds: Iterable[int], runs: int, names: Iterable[str] = ()) -> list[Trial]:
    """Return `runs` trials of each kind; with two seeds, half of them with each seed."""
    seeds = tuple(seeds)
    chosen = [KINDS[name] for name in names or KINDS]
    return [kind.trial(seeds[i % len(seeds)], i) for i in range(runs) for kind in chosen]


def carried_out(chosen: list[Trial], workers: int, every: int = FOLLOWED) -> Iterator[Judged]:
    """Yield results of trials as they finish; the remedy of one trial in `every` is applied."""
    judge = partial(_judged, every)
    if workers <= 1:
        yield from map(judge, chosen)
        return
    context = multiprocessing.get_context("fork")
    with context.Pool(workers, maxtasksperchild=200) as pool:
        yield from pool.imap_unordered(judge, chosen, chunksize=4)


def _judged(every: int, trial: Trial) -> Judged:
    return judged(trial, follow=trial.number % every == 0)


def _line(result: Judged) -> str:
    word = "ok   " if result.right else "WRONG"
    if result.helped is False:
        word = "ADVICE" if result.right else "BOTH "
    helped = {None: "", True: " (helps)", False: " (does not help)"}[result.helped]
    return (
        f"{word} {result.kind} {result.number}: {result.said} ({result.reason}); "
        f"{1e3 * result.distance:.2f} mm off; {result.remedy}{helped}"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tests/outcomes",
        description="Inject faults and compare the outcomes of the loop with the truth.",
        epilog="example: tests/outcomes target_drifts --runs 8 --kept",
    )
    parser.add_argument("kinds", nargs="*", help="kinds of faults, see --list (default: all)")
    parser.add_argument("--runs", type=int, default=30, help="runs of each kind (default 30)")
    parser.add_argument("--seed", type=int, help="second seed (default: random)")
    parser.add_argument("--kept", action="store_true", help="use only the fixed seed")
    parser.add_argument("--workers", type=int, default=multiprocessing.cpu_count(),
                        help="parallel processes (default: one per core)")  # fmt: skip
    parser.add_argument("--list", action="store_true", help="print kinds and correct outcomes")
    parser.add_argument("--follow", action="store_true", help="apply the remedy of every run that "
                        "fails (default: of one in four), and count whether it helps")
    parser.add_argument("--verbose", action="store_true", help="print one line per run")
    parser.add_argument("--write", action="store_true", help="write the table to docs/truth.md")
    return parser
