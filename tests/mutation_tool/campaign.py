"""One run over an area: record which tests cover what, plant each fault, see what finds it."""

from __future__ import annotations

import hashlib
import json
import os
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

from . import trees
from .areas import Area
from .coverage_map import CoverageMap
from .faults import Fault
from .graph import Graph, GraphError

LIBRARIES = (
    "numpy", "numba", "cv2", "yaml", "pybullet", "scipy.spatial", "scipy.optimize",
    "collada", "pinocchio", "coverage", "pytest",
)
Task = TypeVar("Task")
MISSED, NO_TEST = "missed", "no test"


class CampaignError(Exception):
    """The tests cannot be run as they are."""


@dataclass(frozen=True)
class Outcome:
    """What became of a fault: `how` is 'missed', 'no test', or how it was found."""

    key: str
    how: str
    by: str
    ran: int
    seconds: float
    tests: str  # digest of the tests and sources that it ran with

    @property
    def found(self) -> bool:
        return self.how not in (MISSED, NO_TEST)


class Worker:
    """A copy of the workspace and the process that runs tests in it."""

    def __init__(self, top: Path, folder: Path, libraries: tuple[str, ...]) -> None:
        copy, self._lock = trees.free_copy(folder)
        trees.update(top, copy)
        self._libraries = libraries
        self._process: subprocess.Popen[str] | None = None
        self.copy = copy

    def ask(self, task: dict) -> dict:
        """Run a task of `worker.py`; raises CampaignError if the process is gone."""
        if self._process is None:
            environment = os.environ | {
                "PYTHONPATH": str(Path(__file__).parents[1]), "OMP_NUM_THREADS": "1",
                "OPENBLAS_NUM_THREADS": "1", "LP_NUM_THREADS": "1",
                "MUTATION_PYTHONPATH": os.environ.get("PYTHONPATH", ""),
            }
            self._process = subprocess.Popen(
                [sys.executable, "-m", "mutation_tool.worker", str(self.copy), *self._libraries],
                text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
            )
            self._process.stdout.readline()
        print(json.dumps(task), file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        if not line:
            raise CampaignError(f"the process that runs tests in {self.copy} has ended")
        return json.loads(line)

    def output(self) -> str:
        """What the tests of the last task printed."""
        file = self.copy / ".output.txt"
        return file.read_text(errors="replace") if file.is_file() else ""

    def close(self) -> None:
        if self._process is not None:
            self._process.stdin.close()
            self._process.wait()
        self._lock.close()


class Campaign:
    """The recordings, outcomes and copies of one area, kept in `folder` between runs.

    Args:
        top: the checkout.
        folder: where the copies and what was learnt are kept.
        deadline: time.monotonic() after which nothing new is begun.
        patience: processor seconds that a faulty run may take besides four times what its tests
            took without the fault; in wall time, as others may use the machine, thrice as much.
        libraries: what the tests import that takes long.
        skip: regular expression of test files that are left out, the slow ones maybe.
        graph: also run the area's integration tests, where its unit tests find nothing.
    """

    def __init__(
        self, area: Area, top: Path, folder: Path, jobs: int, deadline: float,
        say: Callable[[str], None], patience: float = 40.0,
        libraries: tuple[str, ...] = LIBRARIES, graph: bool = False, skip: str = "",
    ) -> None:
        self._area, self._top, self._folder = area, top, folder / area.name
        self._deadline, self._say, self._patience = deadline, say, patience
        self._folder.mkdir(parents=True, exist_ok=True)
        self._workers = [Worker(top, folder / "copies", libraries) for _ in range(jobs)]
        self._names = trees.tracked(top)
        self.sources = {
            name: (top / name).read_bytes() for name in self._names
            if name.startswith("src/") and name.endswith(".py")
        }
        self._digests = {
            name: hashlib.sha256(source).hexdigest()[:16] for name, source in self.sources.items()
        }
        tests = [str(f.relative_to(top)) for f in area.test_files(top)]
        self._tests = [test for test in tests if not (skip and re.search(skip, test))]
        self._graph_tests = [test for test in area.graph if (top / test).is_file()] if graph else []
        self._sound: set[str] = set()  # tests seen to pass without a fault
        self._graph = Graph(top, folder / "graphs")

    def close(self) -> None:
        for worker in self._workers:
            worker.close()

    @property
    def late(self) -> bool:
        return time.monotonic() > self._deadline

    # -- what covers what --------------------------------------------------------------------

    def record(self) -> CoverageMap | None:
        """Run the area's tests where they are not recorded as they are; None if time is up.

        Raises:
            CampaignError: tests fail without any fault.
        """
        tests = (*self._tests, *self._graph_tests)
        files = {test: self._folder.parent / "recordings" / self._recording(test) for test in tests}
        missing = [test for test, file in files.items() if not self._holds(file)]
        if missing:
            self._say(f"recording what {len(missing)} of {len(files)} test files cover")
            next(iter(files.values())).parent.mkdir(exist_ok=True)

        def work(worker: Worker, test: str) -> None:
            self._record(worker, test, files[test])

        for _ in self._spread(missing, work):
            pass
        if not all(self._holds(file) for file in files.values()):
            return None
        recordings = {test: json.loads(file.read_text()) for test, file in files.items()}
        used = {name for recording in recordings.values() for name in recording["lines"]}
        names = sorted({*used, *(file.name for file in files.values())})
        self.digest = hashlib.sha256("".join(
            self._digests.get(name, name) for name in names
        ).encode()).hexdigest()[:16]
        texts = {test: (self._top / test).read_bytes() for test in tests}
        return CoverageMap(recordings, self.sources, texts)

    def _recording(self, test: str) -> str:
        """Name of the recording: of this test file, its helpers, and the data that tests read."""
        folder = f"{Path(test).parent}/"
        read = [
            name for name in self._names
            if name == test or name in ("tests/conftest.py", "pyproject.toml")
            or name.startswith(folder) and "/test_" not in name
            or name.startswith("src/") and not name.endswith((".py", ".md", ".rst"))
        ]
        return f"{Path(test).stem}-{trees.digest(self._top, read)}.json"

    def _holds(self, file: Path) -> bool:
        """Whether there is such a recording, of sources that are still what they were."""
        if not file.is_file():
            return False
        ran = json.loads(file.read_text())["sources"]
        return all(self._digests.get(name) == digest for name, digest in ran.items())

    def _record(self, worker: Worker, test: str, file: Path) -> None:
        if test in self._graph_tests:
            try:
                answer = self._graph.record(test)
            except GraphError as error:
                raise CampaignError(str(error)) from error
            self._keep(answer, file)
            return
        answer = worker.ask({"record": test, "cpu": 900, "wall": 1800})
        if answer["status"] != "ended" or answer.get("code") not in (0, 5):
            raise CampaignError(
                f"{test} fails without any fault ({answer['status']}):\n{worker.output()[-3000:]}"
            )
        self._keep(answer, file)

    def _keep(self, recording: dict, file: Path) -> None:
        # Scripts without .py run too, but no fault is planted in them.
        recording["lines"] = {n: v for n, v in recording["lines"].items() if n in self._digests}
        recording["sources"] = {name: self._digests[name] for name in recording["lines"]}
        part = file.with_suffix(f".{os.getpid()}")
        part.write_text(json.dumps(recording))
        part.rename(file)

    # -- faults ------------------------------------------------------------------------------

    def known(self) -> dict[str, Outcome]:
        """Outcomes of earlier runs that still hold: a miss only for the same tests and sources."""
        known = {}
        if self._results.is_file():
            for line in self._results.read_text().splitlines():
                outcome = Outcome(**json.loads(line))
                if outcome.found or outcome.tests == self.digest:
                    known[outcome.key] = outcome
        return known

    def forget(self) -> None:
        """Begin anew."""
        self._results.unlink(missing_ok=True)

    def run(self, faults: Iterable[Fault], cover: CoverageMap) -> Iterable[tuple[Fault, Outcome]]:
        """Plant each fault by itself; yields them as they end, and stops when time is up."""
        def plant(worker: Worker, fault: Fault) -> tuple[Fault, Outcome]:
            outcome = self._plant(worker, fault, cover)
            with self._results.open("a") as file:
                print(json.dumps(asdict(outcome)), file=file, flush=True)
            return fault, outcome

        yield from self._spread(list(faults), plant)

    def _plant(self, worker: Worker, fault: Fault, cover: CoverageMap) -> Outcome:
        order = cover.tests_of(fault)
        if not order:
            return Outcome(fault.key, NO_TEST, "", 0, 0.0, self.digest)
        outcome = Outcome(fault.key, MISSED, "", 0, 0.0, self.digest)
        if quick := [test for test in order if test not in self._graph_tests]:
            task = self._task(fault, quick, cover)
            answer = worker.ask(task)
            if answer["status"].startswith("crash"):  # counts if it does so again
                self._say(f"{answer['status']}, again: {worker.output()[-1000:]}")
                answer = worker.ask(task)
            outcome = _judged(fault, answer, self.digest)
            if outcome.how == "test":
                self._vouch(worker, outcome.by)
        for test in order[len(quick):] if not outcome.found else ():
            answer = self._graph.run(self._task(fault, [test], cover))
            outcome = _judged(fault, answer, self.digest, outcome)
            if outcome.found:
                break
        return outcome

    def _vouch(self, worker: Worker, test: str) -> None:
        """Once for each test that found something: it passes without a fault, and without
        coverage; raises CampaignError where it does not."""
        if test in self._sound:
            return
        alone = worker.ask({"order": [test], "stop": True, "cpu": 900, "wall": 1800})
        if alone["status"] != "ended" or alone.get("code") != 0:
            raise CampaignError(
                f"{test} passes under coverage only ({alone['status']}):\n"
                f"{worker.output()[-3000:]}"
            )
        self._sound.add(test)

    def _task(self, fault: Fault, order: list[str], cover: CoverageMap) -> dict:
        limit = self._patience + 4.0 * cover.total(order)
        return {
            "file": fault.file, "text": fault.apply(self.sources[fault.file]).decode(),
            "compiled": fault.compiled, "names": fault.names, "order": order, "stop": True,
            "cpu": int(limit), "wall": 3.0 * limit,
        }

    @property
    def _results(self) -> Path:
        return self._folder / "results.jsonl"

    def _spread(
        self, tasks: list[Task], work: Callable[[Worker, Task], object]
    ) -> Iterable[object]:
        """Do the tasks on all workers; yields what `work` returns, raises what it raises."""
        todo: queue.SimpleQueue[Task] = queue.SimpleQueue()
        done: queue.SimpleQueue[tuple[object, BaseException | None]] = queue.SimpleQueue()
        for task in tasks:
            todo.put(task)
        stop = threading.Event()

        def serve(worker: Worker) -> None:
            try:
                while not stop.is_set() and not self.late:
                    done.put((work(worker, todo.get_nowait()), None))
            except queue.Empty:
                pass
            except BaseException as error:  # the caller raises it
                done.put((None, error))
            done.put((threading.current_thread(), None))

        threads = [threading.Thread(target=serve, args=(w,), daemon=True) for w in self._workers]
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


def _judged(fault: Fault, answer: dict, digest: str, before: Outcome | None = None) -> Outcome:
    """How the fault was found, and by which test; or that it was missed."""
    if answer["status"] != "ended":
        how, by = answer["status"].partition(" ")[0], ""
    elif answer.get("failed"):
        how, by = "test", answer["failed"][0]
    elif answer.get("code") == 0:
        how, by = MISSED, ""
    else:
        how, by = "import", ""  # the tests could not even be collected, or pytest itself fell
    ran, seconds = answer.get("ran", 0), answer["seconds"]
    if before is not None:
        ran, seconds = ran + before.ran, seconds + before.seconds
    return Outcome(fault.key, how, by, ran, seconds, digest)
