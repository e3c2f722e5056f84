"""Fault: the disk becomes full while a run is recorded."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

from ros_graph import GraphError

from .bed import Bed
from .outcome import Outcome
from .traffic import judged

SIZE = "2m"


def full(bed: Bed, scale: float, seed: int) -> Outcome:
    """Record to a file system of two megabytes; the rest of the graph must continue."""
    with bed.group("disk full") as outcome:
        if os.geteuid() != 0:
            outcome.note = "left out: mounting a small file system needs root"
            return outcome
        folder = Path(bed.directory) / "small"
        folder.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
        if subprocess.run(mount, check=False).returncode:
            outcome.note = "left out: no small file system can be mounted here"
            return outcome
        try:
            outcome.injected = 1
            recorder = bed.launch("record.launch", ["/record"], bag=str(folder / "run.bag"))
            end = time.monotonic() + 30.0
            while _free(folder) > 4096 and time.monotonic() < end:
                time.sleep(0.2)
            time.sleep(2.0)
            judged(bed, outcome, 1, "while the recorder's disk is full")
            bed.launches.remove(recorder)
            try:
                recorder.stop(clean=False)
            except GraphError as error:
                outcome.hung.append(str(error))
        finally:
            subprocess.run(["umount", "-l", str(folder)], check=False)
    return outcome


def _free(folder: Path) -> int:
    status = os.statvfs(folder)
    return status.f_bavail * status.f_frsize


GROUPS = (full,)
