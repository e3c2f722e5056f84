"""Execute the runs of a chunk one after the other in a worker, directly or in child processes."""

from __future__ import annotations

import contextlib
import functools
import gc
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass

from ..errors import StudyError
from . import run_rows, versions
from .study import Study

# Environment variables that limit libraries (BLAS, OpenMP, numba, OpenCV, Mesa) to one thread per
# process. By default, these libraries use one thread per core.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1",
    "BLIS_NUM_THREADS": "1", "VECLIB_MAXIMUM_THREADS": "1", "NUMEXPR_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1", "LP_NUM_THREADS": "1",
}  # fmt: skip
# Number of new objects after which Python searches for garbage. A run creates 2 000 objects that
# exist until its end. With Python's 700, a run without images takes 5 % longer, one of the arm 4 %.
OBJECTS_PER_COLLECTION = 20_000
# time allowed for the start of a child process, added to the time limit of a run, s
GRACE_TIME = 60.0
# Maximum number of attempts of a run whose process dies. The process may have been killed from
# outside, so a second attempt can succeed.
MAX_TRIES = 2


@dataclass(frozen=True)
class StudyChunk:
    """Chunk (group of runs) of a study that a worker executes.

    study: result of `Study.to_mapping`, as JSON.
    chunk: number of the chunk.
    is_isolated: whether to run the chunk in a child process, so that a crash does not end the
        worker.
    versions: required versions of the code; None: any version.
    """

    study: str
    chunk: int
    is_isolated: bool = False
    versions: tuple[tuple[str, str], ...] | None = None

    @property
    def runs(self) -> range:
        """Numbers of the runs of the chunk."""
        return _load_study(self.study).list_chunk_runs(self.chunk)


def carry_out(task: StudyChunk) -> run_rows.RunRows:
    """Execute all runs of a chunk and return their rows.

    Raises:
        StudyError: the code of this process differs from that of the process that started the
            study.
    """
    if task.versions is not None:
        current = versions.read_study_versions(json.loads(task.study))
        difference = versions.describe_difference(dict(task.versions), current)
        if difference:
            raise StudyError(
                f"a worker has other versions: {difference}; install the same versions there"
            )
    # Called for each chunk, because this function does not know whether the worker process is new.
    prepare_process()
    return _run_isolated_chunk(task) if task.is_isolated else _run_directly(task)


def prepare_process() -> None:
    """Limit OpenCV to one thread, and collect garbage less often.

    For other libraries than OpenCV, environment variables set the limit.
    """
    import cv2

    cv2.setNumThreads(1)
    gc.set_threshold(OBJECTS_PER_COLLECTION)


@functools.lru_cache(maxsize=4)
def _load_study(text: str) -> Study:
    return Study.from_mapping(json.loads(text))


def _run_directly(task: StudyChunk) -> run_rows.RunRows:
    study, worker = _load_study(task.study), make_worker_name()
    chunk_rows = run_rows.RunRows()
    for run in task.runs:
        chunk_rows.add(run_rows.compute_row(study, run, worker))
    return chunk_rows


def make_worker_name() -> str:
    """Return the name of this process for the table of wall times."""
    return f"{socket.gethostname()}:{os.getpid()}"


def _run_isolated_chunk(task: StudyChunk) -> run_rows.RunRows:
    """Execute a chunk in child processes; a run that crashes its process has the outcome DIED."""
    study = _load_study(task.study)
    chunk_rows, tries, end = run_rows.RunRows(), 0, ""
    todo = task.runs
    while len(todo):
        finished, end = _run_child(task.study, todo, study.limit + GRACE_TIME)
        chunk_rows.add(finished)
        todo = todo[len(finished.values):]
        tries = 1 if finished.values else tries + 1
        if len(todo) and (tries >= MAX_TRIES or end is None):
            death = {"outcome": run_rows.DIED, "reason": end}
            result = death if end else run_rows.describe_timeout(study)
            lost = {**run_rows.make_blank_row(study, todo[0]), **result}
            times = {"run": todo[0], "worker": make_worker_name()}
            chunk_rows.add(run_rows.RunRows([lost], [times]))
            todo, tries = todo[1:], 0
    return chunk_rows


def _run_child(study: str, todo: range, limit: float) -> tuple[run_rows.RunRows, str | None]:
    """Execute several runs in a child process.

    Args:
        study: settings of the study, as JSON.
        todo: numbers of the runs.
        limit: maximum time for a run, s; then the child process is killed.

    Returns:
        The rows from the child process, and a description of how it ended; the description is None
        if it was killed because of `limit`.
    """
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(sys.path)}
    child = subprocess.Popen(
        [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        env=environment,
    )  # fmt: skip
    child_rows, is_killed = run_rows.RunRows(), threading.Event()

    def kill_child() -> None:
        is_killed.set()
        child.kill()

    watchdog = threading.Timer(limit, kill_child)
    watchdog.start()
    try:
        # The child process may end before it has read its task, or while it writes a row.
        with contextlib.suppress(BrokenPipeError, EOFError, pickle.UnpicklingError):
            with child.stdin as pipe:
                pickle.dump((study, todo.start, todo.stop), pipe)
            output = child.stdout
            while True:
                child_rows.add(pickle.load(output))
                watchdog.cancel()
                watchdog = threading.Timer(limit, kill_child)
                watchdog.start()
    finally:
        code = child.wait()
        watchdog.cancel()
    return child_rows, None if is_killed.is_set() else _describe_exit(code)


def _describe_exit(code: int) -> str:
    if code < 0:
        return f"the process of the run was ended by {signal.Signals(-code).name}"
    return f"the process of the run ended with exit code {code}"


def _run_as_child() -> None:
    """Execute the runs whose numbers the standard input gives; write rows to the standard output.

    All other output is written to the standard error.
    """
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    text, start, stop = pickle.load(sys.stdin.buffer)
    prepare_process()
    study = _load_study(text)
    for run in range(start, stop):
        pickle.dump(run_rows.compute_row(study, run, make_worker_name()), output)
        output.flush()


if __name__ == "__main__":
    # The import gives the module its full name instead of __main__, so that the parent process can
    # unpickle the rows.
    from aras_visual_servo_bench.studies import chunk_execution

    chunk_execution._run_as_child()
