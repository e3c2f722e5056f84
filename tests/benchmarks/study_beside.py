#!/usr/bin/env python3
"""Run the same experiments in three ways: roslaunch in a loop, in lockstep, and with `bench`.

    . devel/setup.bash; python3 tests/benchmarks/study_beside.py [--starts 20]

As many starts, with two gains each, on the shipped robot with rendered pictures, until the loop
says `converged`. Prints a table (seconds, runs that converged, lines that the user writes) and, as
its last line, JSON. The loop of roslaunch is by_roslaunch.sh, on a master of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
SCRIPT = HERE / "by_roslaunch.sh"
STUDY = """experiment: {{plant: bullet, duration: 10.0, time_after_convergence: 0.0}}
vary:
  gain: [2.0, 5.0]
  start: {starts}
"""


def starts(count: int) -> list[list[float]]:
    """Return the joints of each start (m, rad), with the target in view."""
    return [
        [round(0.12 - 0.01 * (k % 8), 4), 0.0, 0.17, -0.09, -0.09, round(0.1 * k - 0.9, 4)]
        for k in range(count)
    ]


def lines_of(text: str) -> int:
    """Return the number of lines that are neither empty nor comments."""
    return sum(bool(line.strip()) and not line.strip().startswith("#") for line in text.split("\n"))


def by_roslaunch(mode: str, given: list[list[float]], folder: Path) -> dict[str, object]:
    """Return the duration (s) and the converged runs of roslaunch in a loop."""
    file, out = folder / "starts.txt", folder / f"{mode}.csv"
    file.write_text("".join(f"{joints}\n" for joints in given))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = {**os.environ, "ROS_MASTER_URI": f"http://127.0.0.1:{port}"}
    began = time.monotonic()
    subprocess.run(
        [SCRIPT, out, mode, file], env=environment, check=True, stdin=subprocess.DEVNULL,
        timeout=300.0 * len(given),
    )  # fmt: skip
    rows = out.read_text().splitlines()[1:]
    return {
        "seconds": round(time.monotonic() - began, 1), "runs": len(rows),
        "converged": sum("converged" in row for row in rows), "lines": lines_of(SCRIPT.read_text()),
    }  # fmt: skip


def by_bench(given: list[list[float]], folder: Path) -> dict[str, object]:
    """Return the duration (s) and the converged runs of `bench`, from its start to its end."""
    import pyarrow.parquet as parquet

    text = STUDY.format(starts=given)
    (folder / "study.yaml").write_text(text)
    began = time.monotonic()
    command = ["-m", "aras_visual_servo_bench", "run", folder / "study.yaml"]
    subprocess.run(
        [sys.executable, *command, "--out", folder / "out"], check=True, stdout=subprocess.DEVNULL
    )
    taken, outcomes = time.monotonic() - began, []
    for part in sorted((folder / "out" / "parts").glob("*.parquet")):
        table = parquet.read_table(part)
        if "outcome" in table.column_names:  # the others hold times
            outcomes += table["outcome"].to_pylist()
    return {
        "seconds": round(taken, 1), "runs": len(outcomes),
        "converged": sum(word == "converged" for word in outcomes), "lines": lines_of(text) + 1,
    }  # fmt: skip


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=20, help="each with two gains")
    options = parser.parse_args()
    given = starts(options.starts)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        found = {
            "bench": by_bench(given, folder),
            "roslaunch in a loop": by_roslaunch("real_time", given, folder),
            "the same in lockstep": by_roslaunch("lockstep", given, folder),
        }
    print("| | seconds | runs | converged | user lines |\n|---|---|---|---|---|")
    for name, row in found.items():
        print(f"| {name} | " + " | ".join(map(str, row.values())) + " |")
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
