"""Reports of runs, computed when they are asked for, each by a process of its own, and kept.

The process is `bench analyze DIR:RUN`, so a run that hangs or ends its process harms nobody here.
The report stays in the study's folder, where `bench show` puts its own: show-RUN/report.html; of
a folder that cannot be written, or leads elsewhere by a link, among the temporary files.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from ...errors import StudyError
from .studies import FoundStudy

TOGETHER = 2  # reports that are computed at a time
BEYOND = 120.0  # s that a report may take, beside the study's limit of a run
PAGE = "report.html"


@dataclass
class Job:
    """A report that is being computed."""

    process: subprocess.Popen
    words: IO[bytes]
    out: Path
    limit: float
    began: float = field(default_factory=time.monotonic)

    @property
    def seconds(self) -> float:
        """Since it was begun."""
        return time.monotonic() - self.began


class Reports:
    """Reports that are there, and that are on their way.

    Attributes:
        jobs: those that are being computed, by the study's path and the run's number.
    """

    def __init__(self) -> None:
        self.jobs: dict[tuple[Path, int], Job] = {}
        self._kept: dict[tuple[Path, int], Path] = {}
        self._lock = threading.Lock()
        self._elsewhere: tempfile.TemporaryDirectory | None = None

    def ask(self, seen: FoundStudy, run: int) -> Path | float:
        """The report's page, or for how long (s) it has been computed.

        Raises:
            StudyError: there is no such run, it cannot be computed, or others are first.
        """
        if seen.folder is None or not 0 <= run < seen.of:
            raise StudyError(f"{seen.name} has no run {run}")
        key = (seen.path, run)
        with self._lock:
            job = self.jobs.get(key)
            if job is not None:
                return self._looked_at(key, job)
            page = self._kept.get(key, seen.path / f"show-{run}" / PAGE)
            part = seen.folder.part(run // seen.folder.study.chunk_size)
            if _newer(page, part) and (key in self._kept or _within(page, seen.path)):
                return page
            if len(self.jobs) >= TOGETHER:
                for other in list(self.jobs):
                    with contextlib.suppress(StudyError):
                        self._looked_at(other, self.jobs[other])
            if len(self.jobs) >= TOGETHER:
                raise StudyError(f"{TOGETHER} reports are being computed: wait for one of them")
            self.jobs[key] = self.begun(seen, run)
            return 0.0

    def close(self) -> None:
        """End what is on its way."""
        with self._lock:
            for job in self.jobs.values():
                job.process.kill()
                job.process.wait()
            self.jobs.clear()
            if self._elsewhere is not None:
                self._elsewhere.cleanup()

    def begun(self, seen: FoundStudy, run: int) -> Job:
        """Begin one beside the study, or elsewhere where nothing can be written there."""
        out = seen.path / f"show-{run}"
        if not (os.access(seen.path, os.W_OK) and _within(out, seen.path)):
            self._elsewhere = self._elsewhere or tempfile.TemporaryDirectory(prefix="reports")
            out = Path(tempfile.mkdtemp(dir=self._elsewhere.name))
        words = tempfile.TemporaryFile()  # noqa: SIM115, closed when the job is over
        process = subprocess.Popen(
            [sys.executable, "-m", "aras_visual_servo_bench", "analyze", f"{seen.path}:{run}",
             "--out", str(out), "--formats", ""],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=words,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )  # fmt: skip
        return Job(process, words, out, seen.folder.study.limit + BEYOND)

    def _looked_at(self, key: tuple[Path, int], job: Job) -> Path | float:
        """What has become of it."""
        status = job.process.poll()
        if status is None and job.seconds < job.limit:
            return job.seconds
        del self.jobs[key]
        with job.words:
            if status is None:
                job.process.kill()
                job.process.wait()
                raise StudyError(f"the report was not there after {job.limit:.0f} s")
            job.words.seek(0)
            lines = job.words.read().decode(errors="replace").strip().splitlines()
        page = job.out / PAGE
        if status != 0 or not page.is_file():
            why = lines[-1].removeprefix("bench: ") if lines else f"its process ended with {status}"
            raise StudyError(f"no report of run {key[1]}: {why}")
        self._kept[key] = page
        return page


def _newer(page: Path, part: Path) -> bool:
    """Whether the page is there and was made after the run's row was written."""
    try:
        made = page.stat().st_mtime
        return not part.exists() or made >= part.stat().st_mtime
    except OSError:
        return False


def _within(page: Path, folder: Path) -> bool:
    """Whether no link leads out of the folder."""
    return page.resolve().is_relative_to(folder)
