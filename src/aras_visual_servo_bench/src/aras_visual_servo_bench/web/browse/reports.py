"""Reports of single runs, which are computed on request and stored.

Each report is computed by a separate process, `bench analyze DIR:RUN`, so that a run that hangs or
crashes does not affect the server. The report is stored as show-RUN/report.html in the study's
folder, where `bench show` stores it, too. If this folder is not writable, or if show-RUN is a link
to another folder, the report is stored in a temporary folder.
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
from .studies import StudyEntry

MAX_JOBS = 2  # largest number of reports that are made at the same time
EXTRA_TIME = 120.0  # time allowed for making a report, added to the study's time limit for a run, s
PAGE_FILE = "report.html"


@dataclass
class ReportJob:
    """A report that is being computed."""

    process: subprocess.Popen
    error_output: IO[bytes]
    out: Path
    limit: float
    start_time: float = field(default_factory=time.monotonic)

    @property
    def seconds(self) -> float:
        """Time since the start of the job, s."""
        return time.monotonic() - self.start_time


class Reports:
    """Stored reports, and reports that are being computed.

    Attributes:
        jobs: reports that are being computed, by the path of the study and the number of the run.
    """

    def __init__(self) -> None:
        self.jobs: dict[tuple[Path, int], ReportJob] = {}
        self._pages: dict[tuple[Path, int], Path] = {}
        self._lock = threading.Lock()
        self._temporary_folder: tempfile.TemporaryDirectory | None = None

    def find_or_start(self, entry: StudyEntry, run: int) -> Path | float:
        """Return the path of a run's report, or the time since the start of its computation, s.

        The computation is started if necessary.

        Raises:
            StudyError: the run does not exist, the computation of its report has failed, or too
                many other reports are being computed.
        """
        if entry.folder is None or not 0 <= run < entry.run_count:
            raise StudyError(f"study {entry.name} has no run {run}")
        key = (entry.path, run)
        with self._lock:
            job = self.jobs.get(key)
            if job is not None:
                return self._poll_job(key, job)
            page = self._pages.get(key, entry.path / f"show-{run}" / PAGE_FILE)
            part = entry.folder.find_part(run // entry.folder.study.chunk_size)
            if _is_current(page, part) and (key in self._pages or _is_within(page, entry.path)):
                return page
            if len(self.jobs) >= MAX_JOBS:
                for other in list(self.jobs):
                    with contextlib.suppress(StudyError):
                        self._poll_job(other, self.jobs[other])
            if len(self.jobs) >= MAX_JOBS:
                raise StudyError(
                    f"{MAX_JOBS} reports are being computed: wait until one of them is finished"
                )
            self.jobs[key] = self.start_job(entry, run)
            return 0.0

    def close(self) -> None:
        """Kill the processes that compute reports, and delete the temporary folder."""
        with self._lock:
            for job in self.jobs.values():
                job.process.kill()
                job.process.wait()
            self.jobs.clear()
            if self._temporary_folder is not None:
                self._temporary_folder.cleanup()

    def start_job(self, entry: StudyEntry, run: int) -> ReportJob:
        """Start to compute the report of a run, if possible in the study's folder."""
        out = entry.path / f"show-{run}"
        if not (os.access(entry.path, os.W_OK) and _is_within(out, entry.path)):
            self._temporary_folder = self._temporary_folder or tempfile.TemporaryDirectory(
                prefix="reports"
            )
            out = Path(tempfile.mkdtemp(dir=self._temporary_folder.name))
        error_output = tempfile.TemporaryFile()  # noqa: SIM115, closed at the end of the job
        process = subprocess.Popen(
            [sys.executable, "-m", "aras_visual_servo_bench", "analyze", f"{entry.path}:{run}",
             "--out", str(out), "--formats", ""],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=error_output,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )  # fmt: skip
        return ReportJob(process, error_output, out, entry.folder.study.limit + EXTRA_TIME)

    def _poll_job(self, key: tuple[Path, int], job: ReportJob) -> Path | float:
        """Return the page of a finished job, or the time since the start of a running job, s.

        Raises:
            StudyError: the job failed or exceeded its time limit.
        """
        status = job.process.poll()
        if status is None and job.seconds < job.limit:
            return job.seconds
        del self.jobs[key]
        with job.error_output:
            if status is None:
                job.process.kill()
                job.process.wait()
                raise StudyError(
                    f"the report was not finished after {job.limit:.0f} s, so it was cancelled"
                )
            job.error_output.seek(0)
            lines = job.error_output.read().decode(errors="replace").strip().splitlines()
        page = job.out / PAGE_FILE
        if status != 0 or not page.is_file():
            why = lines[-1].removeprefix("bench: ") if lines else f"its process ended with {status}"
            raise StudyError(f"the report of run {key[1]} could not be made: {why}")
        self._pages[key] = page
        return page


def _is_current(page: Path, part: Path) -> bool:
    """Return whether the report of a run exists and is newer than the results of this run.

    Args:
        page: path of the report.
        part: path of the Parquet file with the results of the run.
    """
    try:
        modified = page.stat().st_mtime
        return not part.exists() or modified >= part.stat().st_mtime
    except OSError:
        return False


def _is_within(page: Path, folder: Path) -> bool:
    """Return whether a path is inside a folder after all its links are resolved."""
    return page.resolve().is_relative_to(folder)
