#!/usr/bin/env python3
"""Kill processes of a running study, and check that resuming gives the same bytes as without.

    python3 tests/benchmarks/study_kills.py [--only client] [--runs 300]

Cases: a worker, the client (with its own scheduler in it), a scheduler of its own, a run that
kills its process, and a full disk (a tmpfs of 200 kB in a mount namespace; left out where that is
not allowed). Prints a line a case and, as its last line, JSON.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import checkout

SOURCES = os.pathsep.join(str(p) for p in sorted(checkout.ROOT.glob("src/*/src")))
FEWEST = 60  # runs: some parts of 10 have to be there when the kill comes
ENVIRONMENT = {
    **os.environ, "PYTHONPATH": os.pathsep.join([SOURCES, str(Path(__file__).parent)]),
}  # fmt: skip
BENCH = [sys.executable, "-m", "aras_visual_servo_bench"]
STUDY = """\
experiment: {{plant: free, duration: 0.1}}
vary: {{gain: [1.0, 2.0]}}
repeats: {repeats}
chunk: 10
"""


def bench(*words: str | Path, **options: object) -> subprocess.Popen[str]:
    """Start the command `bench`."""
    return subprocess.Popen(
        [*BENCH, *map(str, words)], env=ENVIRONMENT, text=True, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, **options,
    )  # fmt: skip


def parts(folder: Path) -> list[Path]:
    """Return the existing result files."""
    return sorted((folder / "parts").glob("*.parquet"))


def digest(folder: Path) -> str:
    """Return a digest of all result files and the manifest."""
    found = hashlib.sha256((folder / "manifest.json").read_bytes())
    for path in parts(folder):
        found.update(path.read_bytes())
    return found.hexdigest()[:16]


def wait_for_parts(folder: Path, count: int, timeout: float = 120.0) -> None:
    """Wait until there are `count` result files."""
    end = time.monotonic() + timeout
    while len(parts(folder)) < count:
        if time.monotonic() > end:
            raise TimeoutError(f"{folder} has no {count} parts after {timeout} s")
        time.sleep(0.02)


def descendants(pid: int) -> list[int]:
    """Return all child processes of a process, with their children."""
    listed = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True)
    parent = {int(p): int(q) for p, q in (line.split() for line in listed.stdout.splitlines())}
    found, grown = {pid}, True
    while grown:
        more = {p for p, q in parent.items() if q in found} - found
        grown, found = bool(more), found | more
    return sorted(found - {pid})


def workers(pid: int) -> list[int]:
    """Return the worker processes of a process, found by their command lines."""
    def is_worker(child: int) -> bool:
        try:
            line = Path(f"/proc/{child}/cmdline").read_bytes()
        except OSError:
            return False
        return b"spawn_main" in line

    return [child for child in descendants(pid) if is_worker(child)]


def kill_worker(study: Path, out: Path) -> str:
    """Kill one worker by its id while it runs a chunk."""
    client = bench("run", study, "--out", out, "--workers", "2")
    wait_for_parts(out, 3)
    os.kill(workers(client.pid)[0], signal.SIGKILL)
    told = client.communicate(timeout=300)[0]
    assert client.returncode == 0, told
    return told.splitlines()[-1]


def kill_client(study: Path, out: Path) -> str:
    """Kill the client with its scheduler; its workers must then end by themselves."""
    client = bench("run", study, "--out", out, "--workers", "2")
    wait_for_parts(out, 3)
    below = descendants(client.pid)
    client.kill()
    client.wait()
    kept = len(parts(out))
    end = time.monotonic() + 60.0
    while any(Path(f"/proc/{p}").exists() for p in below):
        assert time.monotonic() < end, f"workers stay: {below}"
        time.sleep(0.2)
    resume(out)
    return f"{kept} parts were kept, its workers ended"


def kill_scheduler(study: Path, out: Path) -> str:
    """Kill a separate scheduler: the client reports it, and the study continues with a new one."""
    dask = [sys.executable, "-m", "distributed.cli.dask_"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": ENVIRONMENT}
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "scheduler.json"
        scheduler = subprocess.Popen(
            [*dask[:-1], dask[-1] + "scheduler", "--host", "127.0.0.1", "--port", "0",
             "--no-dashboard", "--scheduler-file", str(file)], **quiet)  # fmt: skip
        end = time.monotonic() + 60.0
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.1)
        worker = subprocess.Popen(
            [*dask[:-1], dask[-1] + "worker", "--scheduler-file", str(file), "--nthreads", "1",
             "--nworkers", "2", "--no-dashboard", "--death-timeout", "20",
             "--local-directory", scratch], **quiet)  # fmt: skip
        try:
            address = json.loads(file.read_text())["address"]
            time.sleep(4.0)
            client = bench("run", study, "--out", out, "--scheduler", address)
            wait_for_parts(out, 3)
            scheduler.kill()
            told = client.communicate(timeout=120)[0]
        finally:
            for process in (worker, scheduler):
                if process.poll() is None:
                    process.terminate()
                process.wait(30)
    assert client.returncode == 1, told
    last = told.strip().splitlines()[-1]
    assert "connection to the scheduler is lost" in last and "bench resume" in last, told
    resume(out)
    return last


def fill_disk(study: Path, out: Path) -> str:
    """Fill the disk after some results, then free space again."""
    script = """
set -e
mount -t tmpfs -o size=200k tmpfs "$1"; shift
exec "$@"
"""
    out.mkdir()
    kept = out.with_name("kept")
    kept.mkdir()
    words = [*BENCH, "run", str(study), "--out", str(out / "study"), "--in-process"]
    copy = f"{' '.join(words)}; code=$?; cp -r {out}/study {kept}; exit $code"
    done = subprocess.run(
        ["unshare", "-m", "bash", "-c", script, "bash", str(out), "bash", "-c", copy],
        env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    told = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else ""
    if "mount" in told or "unshare" in told:
        return "left out: no mount namespace here"
    assert done.returncode == 1 and "is full" in told, done.stderr
    shutil.rmtree(out)
    shutil.move(kept / "study", out)
    count = len(parts(out))
    assert count, "nothing was kept"
    resume(out)
    return f"{count} parts were kept: {told}"


def resume(out: Path) -> None:
    """Resume the study until its end."""
    again = bench("resume", out, "--workers", "2")
    told = again.communicate(timeout=300)[0]
    assert again.returncode == 0, told


CASES: dict[str, Callable[[Path, Path], str]] = {
    "worker": kill_worker, "client": kill_client, "scheduler": kill_scheduler, "disk": fill_disk,
}  # fmt: skip


def main() -> int:
    """Run the cases and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=[*CASES])
    parser.add_argument("--runs", type=int, default=300)
    options = parser.parse_args()
    if options.runs < FEWEST:
        parser.error(f"--runs is {options.runs}, must be {FEWEST} or more")
    results = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        study = folder / "study.yaml"
        study.write_text(STUDY.format(repeats=options.runs // 2))
        whole = bench("run", study, "--out", folder / "whole", "--in-process")
        told = whole.communicate(timeout=600)[0]
        assert whole.returncode == 0, told
        expected = digest(folder / "whole")
        for name in [options.only] if options.only else CASES:
            out = folder / name
            try:
                told = CASES[name](study, out)
                if told.startswith("left out"):
                    results[name] = None
                else:
                    results[name] = digest(out) == expected
            except (AssertionError, TimeoutError, subprocess.TimeoutExpired) as error:
                told, results[name] = f"FAILED: {error}", False
            same = {True: "same bytes", False: "NOT the same", None: ""}[results[name]]
            print(f"{name:<10} {same}  {told}", flush=True)
    print(json.dumps(results))
    return int(False in results.values())


if __name__ == "__main__":
    sys.exit(main())
