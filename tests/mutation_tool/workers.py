"""Copies of the workspace, each with the processes that run tests in it."""

from __future__ import annotations

import json
import os
import queue
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

from . import trees

LIBRARIES = (
    "numpy", "numba", "cv2", "yaml", "pybullet", "scipy.spatial", "scipy.optimize",
    "collada", "pinocchio", "coverage", "pytest", "hypothesis", "pandas", "scipy.stats",
    "matplotlib.pyplot", "mpl_toolkits.mplot3d", "pyarrow.parquet", "pyarrow.compute", "jinja2",
    "tornado.web", "tornado.websocket", "cloudpickle", "gymnasium",
)
Task = TypeVar("Task")


class WorkerError(Exception):
    """A process that runs tests has ended, or cannot begin."""


class Worker:
    """A copy of the workspace, and two processes: one that has the tests collected, one that
    imports everything anew for each task.

    Args:
        top: the checkout.
        folder: where copies are.
        libraries: what the tests import that takes long.
    """

    def __init__(self, top: Path, folder: Path, libraries: tuple[str, ...]) -> None:
        copy, self._lock = trees.free_copy(folder)
        trees.update(top, copy)
        self._libraries = libraries
        self._processes: dict[tuple[str, ...], subprocess.Popen[str]] = {}
        self.collected: tuple[str, ...] = ()
        self.copy = copy.resolve()

    def ask(self, task: dict) -> dict:
        """Run a task of `worker.py`, on the collected tests where that is possible; raises
        WorkerError if the process is gone."""
        if self.collected and not task["anew"]:
            answer = self._ask(self.collected, task)
            if not answer.get("anew"):
                return answer
        return self._ask((), task | {"anew": True})

    def _ask(self, collect: tuple[str, ...], task: dict) -> dict:
        if collect not in self._processes:
            environment = os.environ | {
                "PYTHONPATH": str(Path(__file__).parents[1]), "OMP_NUM_THREADS": "1",
                "OPENBLAS_NUM_THREADS": "1", "LP_NUM_THREADS": "1",
                "MUTATION_PYTHONPATH": os.environ.get("PYTHONPATH", ""),
                "TMPDIR": str(self._temporary()),  # what it made while it collected stays there
            }
            process = subprocess.Popen(
                [sys.executable, "-m", "mutation_tool.worker", str(self.copy)],
                text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
                start_new_session=True,  # Ctrl-C is for this process, whose end ends that one
            )
            self._processes[collect] = process
            self._exchange(process, {"libraries": self._libraries, "collect": collect})
        return self._exchange(self._processes[collect], task)

    def _exchange(self, process: subprocess.Popen[str], message: dict) -> dict:
        print(json.dumps(message), file=process.stdin, flush=True)
        line = process.stdout.readline()
        if not line or "error" in json.loads(line):
            why = json.loads(line)["error"] if line else "its process has ended"
            raise WorkerError(f"{self.copy}: {why}:\n{self.output()[-3000:]}")
        return json.loads(line)

    def _temporary(self) -> Path:
        folder = self.copy / ".temporary"
        folder.mkdir(exist_ok=True)
        return folder

    def output(self) -> str:
        """What the tests of the last task printed."""
        file = self.copy / ".output.txt"
        return file.read_text(errors="replace") if file.is_file() else ""

    def close(self) -> None:
        for process in self._processes.values():
            process.stdin.close()
            process.wait()
            process.stdout.close()
        self._processes.clear()
        shutil.rmtree(self._temporary(), ignore_errors=True)
        self._lock.close()


def spread(
    workers: list[Worker], tasks: list[Task], work: Callable[[Worker, Task], object],
    late: Callable[[], bool],
) -> Iterable[object]:
    """Do the tasks on all workers until it is late; yields what `work` returns, raises what it
    raises."""
    todo: queue.SimpleQueue[Task] = queue.SimpleQueue()
    done: queue.SimpleQueue[tuple[object, BaseException | None]] = queue.SimpleQueue()
    for task in tasks:
        todo.put(task)
    stop = threading.Event()

    def serve(worker: Worker) -> None:
        try:
            while not stop.is_set() and not late():
                done.put((work(worker, todo.get_nowait()), None))
        except queue.Empty:
            pass
        except BaseException as error:  # the caller raises it
            done.put((None, error))
        done.put((threading.current_thread(), None))

    threads = [threading.Thread(target=serve, args=(w,), daemon=True) for w in workers]
    for thread in threads:
        thread.start()
    try:
        while threads:
            result, error = done.get()
            if error is not None:
                raise error
            if result in threads:
                threads.remove(result)
            else:
                yield result
    finally:
        stop.set()
