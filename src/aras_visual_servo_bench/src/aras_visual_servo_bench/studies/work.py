"""What a worker does: the runs of a chunk one after the other, or each guarded by a process."""

from __future__ import annotations

import functools
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

from ..errors import StudyError
from . import rows, versions
from .study import Study

# One thread each for what would take as many as there are cores: BLAS, OpenMP, numba, OpenCV, Mesa.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1",
    "BLIS_NUM_THREADS": "1", "VECLIB_MAXIMUM_THREADS": "1", "NUMEXPR_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1", "LP_NUM_THREADS": "1",
}  # fmt: skip
GRACE_TIME = 60.0  # s beyond a run's limit, in which a child process is begun
MAX_TRIES = 2  # of a run that ended its process: someone may have killed it by mistake


@dataclass(frozen=True)
class StudyTask:
    """A chunk to be carried out.

    study: of `Study.to_mapping`, as JSON. guarded: each run in a process that may end.
    versions: what the code must be, None for any.
    """

    study: str
    chunk: int
    is_isolated: bool = False
    versions: tuple[tuple[str, str], ...] | None = None

    @property
    def runs(self) -> range:
        """Numbers of its runs."""
        return _load_study(self.study).list_chunk_runs(self.chunk)


def carry_out(task: StudyTask) -> rows.Rows:
    """All runs of a chunk.

    Raises:
        StudyError: this process has other code than the study was begun with.
    """
    if task.versions is not None:
        here = versions.read_study_versions(json.loads(task.study))
        told = versions.describe_difference(dict(task.versions), here)
        if told:
            raise StudyError(f"a worker has another version: {told}")
    limit_threads()  # here, for a cluster's workers come at any time
    return _run_isolated_chunk(task) if task.is_isolated else _run_directly(task)


def limit_threads() -> None:
    """Keep this process to one thread, as far as can be said while it runs."""
    import cv2

    cv2.setNumThreads(1)


@functools.lru_cache(maxsize=4)
def _load_study(text: str) -> Study:
    return Study.from_mapping(json.loads(text))


def _run_directly(task: StudyTask) -> rows.Rows:
    study, here = _load_study(task.study), make_worker_name()
    done = rows.Rows()
    for run in task.runs:
        done.add(rows.compute_row(study, run, here))
    return done


def make_worker_name() -> str:
    """This process, for the times."""
    return f"{socket.gethostname()}:{os.getpid()}"


# -- guarded -------------------------------------------------------------------------------


def _run_isolated_chunk(task: StudyTask) -> rows.Rows:
    """The runs in child processes: one that ends is known, and is that run's outcome."""
    study = _load_study(task.study)
    done, tries, end = rows.Rows(), 0, ""
    todo = task.runs
    while len(todo):
        finished, end = _run_child(task.study, todo, study.limit + GRACE_TIME)
        done.add(finished)
        todo = todo[len(finished.values):]
        tries = 1 if finished.values else tries + 1
        if len(todo) and (tries >= MAX_TRIES or end is None):
            told = {"outcome": rows.DIED, "reason": end} if end else rows.describe_timeout(study)
            lost = {**rows.make_blank_row(study, todo[0]), **told}
            times = {"run": todo[0], "worker": make_worker_name()}
            done.add(rows.Rows([lost], [times]))
            todo, tries = todo[1:], 0
    return done


def _run_child(study: str, todo: range, limit: float) -> tuple[rows.Rows, str | None]:
    """The rows that a child process gave before it ended, and how it ended.

    None: it was ended here, for it gave no row for `limit`, s: it did not hear its own alarm.
    """
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(sys.path)}
    child = subprocess.Popen(
        [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        env=environment,
    )  # fmt: skip
    done, hangs = rows.Rows(), threading.Event()

    def kill_child() -> None:
        hangs.set()
        child.kill()

    watch = threading.Timer(limit, kill_child)
    watch.start()
    try:
        with child.stdin as pipe:
            pickle.dump((study, todo.start, todo.stop), pipe)
        for one in _read_pickles(child.stdout):
            done.add(one)
            watch.cancel()
            watch = threading.Timer(limit, kill_child)
            watch.start()
    except BrokenPipeError:
        pass  # it ended before it began: how is told below
    finally:
        code = child.wait()
        watch.cancel()
    return done, None if hangs.is_set() else _describe_exit(code)


def _read_pickles(pipe: BinaryIO) -> Iterator[Any]:
    """What is written into a pipe, until its end; what was cut off is left out."""
    while True:
        try:
            yield pickle.load(pipe)
        except (EOFError, pickle.UnpicklingError):
            return


def _describe_exit(code: int) -> str:
    if code < 0:
        return f"its process was ended by {signal.Signals(-code).name}"
    return f"its process ended by itself with {code}"


def _run_as_child() -> None:
    """Runs told on the standard input; rows go to the standard output, and nothing else."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    text, start, stop = pickle.load(sys.stdin.buffer)
    limit_threads()
    study = _load_study(text)
    for run in range(start, stop):
        pickle.dump(rows.compute_row(study, run, make_worker_name()), output)
        output.flush()


if __name__ == "__main__":
    # The rows must be of the classes that the parent knows, not of this module as __main__.
    from aras_visual_servo_bench.studies import work

    work._run_as_child()
