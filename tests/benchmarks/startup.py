#!/usr/bin/env python3
"""Measure the processor time of commands, most of which is their start.

    python3 tests/benchmarks/startup.py [--before PATH] [--repeats N] [--runs N] [COMMAND ...]

Each command runs in a process of its own, once to warm the caches of Python and Numba and then N
times; the time is the median of user and system time, including that of child processes. `--before`
compares with another checkout, with its own .venv if it has one: both run in turns, and the ratio
is the median of the ratios of the turns. Prints a table and, as its last line, JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import checkout

STUDY = "experiment: {plant: free, features: exact, duration: 1.0}\nvary: {gain: [1.0, 2.0]}\n"
# A command's arguments; STUDY and OUT are replaced by folders.
COMMANDS = {
    "help": "--help",
    "run --help": "run --help",
    "table": "table STUDY",
    "diff": "diff STUDY STUDY",
    "free camera": "run plant=free features=exact duration=1",
    "arm": "run duration=1",
    "report": "run plant=free features=exact duration=1 --out OUT",
    "analyze": "analyze STUDY:0 --out OUT --formats png",
}
LIMITS = {"help": 0.1, "run --help": 0.1}  # s
RATIO_LIMITS = {"table": 0.4, "free camera": 0.65, "arm": 0.65}


class Checkout:
    """Commands of the bench in one checkout of the sources."""

    def __init__(self, root: Path, folder: Path, runs: int) -> None:
        self._folder = folder
        python = root / ".venv" / "bin" / "python"
        self._python = str(python) if python.exists() else sys.executable
        sources = [str(path) for path in sorted(root.glob("src/*/src"))]
        if not sources:
            raise SystemExit(f"{root} is no checkout: it has no src/*/src")
        self._environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        self._environment |= {"PYTHONPATH": os.pathsep.join(sources)}
        folder.mkdir()
        (folder / "study.yaml").write_text(f"{STUDY}repeats: {max(runs // 2, 1)}\n")
        self._run(["run", str(folder / "study.yaml"), "--out", str(folder / "study"),
                   "--in-process", "--no-report"])  # fmt: skip

    def measure(self, command: str) -> float:
        """Run a command, and return its processor time, s."""
        folders = {"STUDY": str(self._folder / "study"), "OUT": str(self._folder / "out")}
        for name, folder in folders.items():
            command = command.replace(name, folder)
        return self._run(command.split())

    def _run(self, arguments: list[str]) -> float:
        process = subprocess.Popen(
            [self._python, "-m", "aras_visual_servo_bench", *arguments], env=self._environment,
            cwd=self._folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        )  # fmt: skip
        errors = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{' '.join(arguments)} failed:\n{errors.decode(errors='replace')}")
        return usage.ru_utime + usage.ru_stime


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commands", nargs="*", metavar="COMMAND",
                        help=f"commands to measure (default: all): {', '.join(COMMANDS)}")
    parser.add_argument("--before", type=Path, metavar="PATH", help="checkout to compare with")
    parser.add_argument("--repeats", type=int, default=5, metavar="N",
                        help="times that each command runs (default %(default)s)")
    parser.add_argument("--runs", type=int, default=200, metavar="N",
                        help="runs of the study of `table`, `diff` and `analyze` "
                             "(default %(default)s)")
    given = parser.parse_args()
    unknown = set(given.commands) - set(COMMANDS)
    if unknown:
        parser.error(f"unknown command {sorted(unknown)[0]}: use {', '.join(COMMANDS)}")
    with tempfile.TemporaryDirectory() as temporary:
        roots = {"now": checkout.ROOT} | ({"before": given.before} if given.before else {})
        checkouts = {
            name: Checkout(root.resolve(), Path(temporary, name), given.runs)
            for name, root in roots.items()
        }
        times: dict[str, dict[str, list[float]]] = {name: {} for name in checkouts}
        for command in given.commands or COMMANDS:
            for turn in range(-1, given.repeats):
                for name, one in checkouts.items():
                    seconds = one.measure(COMMANDS[command])
                    if turn >= 0:
                        times[name].setdefault(command, []).append(seconds)
    figures = {
        name: {command: round(statistics.median(some), 3) for command, some in found.items()}
        for name, found in times.items()
    }
    if given.before:
        figures["ratio"] = {
            command: round(statistics.median(
                now / before for now, before in zip(some, times["before"][command], strict=True)
            ), 3)
            for command, some in times["now"].items()
        }  # fmt: skip
    print(f"{'processor time, s':20}" + "".join(f"{name:>10}" for name in figures))
    for command in times["now"]:
        print(f"{command:20}" + "".join(f"{found[command]:10.3f}" for found in figures.values()))
    print(json.dumps(figures))
    exceeded = [
        command
        for name, limits in (("now", LIMITS), ("ratio", RATIO_LIMITS))
        for command, limit in limits.items()
        if figures.get(name, {}).get(command, 0.0) > limit
    ]
    if exceeded:
        print(f"above the limit: {', '.join(exceeded)}", file=sys.stderr)
    return int(bool(exceeded))


if __name__ == "__main__":
    sys.exit(main())
