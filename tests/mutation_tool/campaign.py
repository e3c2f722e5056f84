"""One run over an area: record which tests cover what, plant each fault, see what finds it."""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from .areas import Area
from .baseline import Baseline, digest_of
from .coverage_map import CoverageMap
from .faults import Fault
from .graph import Graph, GraphError
from .sources import all_sources
from .workers import LIBRARIES, Worker, WorkerError, spread

MISSED, NO_TEST = "missed", "no test"
# Found, but by no test's own word.
BAD = ("import", "time-out", "memory", "write", "signal", "crash")
# Seconds of the wall's clock for a processor second, as others use the machine, and besides.
_SLOWNESS, _IDLE = 20.0, 30.0


class CampaignError(Exception):
    """The tests cannot be run as they are."""


@dataclass(frozen=True)
class Outcome:
    """What became of a fault.

    Attributes:
        key: the fault's.
        how: 'missed', 'no test', 'test', or one of BAD.
        by: the test that failed, or the file that was to be written.
        ran: how many tests were begun.
        seconds: processor time.
        tests: digest of the tests and sources that it ran with.
    """

    key: str
    how: str
    by: str
    ran: int
    seconds: float
    tests: str

    @property
    def found(self) -> bool:
        return self.how not in (MISSED, NO_TEST)


class Campaign:
    """The recordings, outcomes and copies of one area, kept in `folder` between runs.

    Args:
        top: the checkout.
        folder: where the copies and what was learnt are kept.
        deadline: time.monotonic() after which nothing new is begun.
        patience: processor seconds that a test may take besides four times what it takes without
            a fault.
        budget: processor seconds that the tests of one fault may take together without it; the
            slowest are left out beyond.
        libraries: what the tests import that takes long.
        skip: regular expression of test files that are left out.
        graph: also run the area's integration tests, where its unit tests find nothing.
    """

    def __init__(
        self, area: Area, top: Path, folder: Path, jobs: int, deadline: float,
        say: Callable[[str], None], patience: float = 5.0, budget: float = 10.0,
        libraries: tuple[str, ...] = LIBRARIES, graph: bool = False, skip: str = "",
    ) -> None:
        self._area, self._top, self._folder = area, top, folder / area.name
        self._deadline, self._say = deadline, say
        self._patience, self._budget = patience, budget
        self._folder.mkdir(parents=True, exist_ok=True)
        self.sources = all_sources(top)
        self._workers = [Worker(top, folder / "copies", libraries) for _ in range(jobs)]
        self._baseline = Baseline(top, folder, self.sources)
        tests = [str(f.relative_to(top)) for f in area.test_files(top)]
        self._tests = [test for test in tests if not (skip and re.search(skip, test))]
        self._graph_tests = [test for test in area.graph if (top / test).is_file()] if graph else []
        self._sound: set[str] = set()  # tests seen to pass without a fault
        self._unsound: set[str] = set()  # and those seen to fail
        self._graph = Graph(top, folder / "graphs")

    def close(self) -> None:
        for worker in self._workers:
            worker.close()

    @property
    def late(self) -> bool:
        return time.monotonic() > self._deadline

    # -- what covers what --------------------------------------------------------------------

    def record(self, anew: bool = False) -> CoverageMap | None:
        """Run the area's tests that are not recorded yet; None if time is up.

        anew: those too that ran sources which have changed since.

        Raises:
            CampaignError: tests fail without any fault.
        """
        tests = (*self._tests, *self._graph_tests)
        missing = [
            test for test in tests
            if not self._baseline.holds(test) or anew and self._baseline.old(test)
        ]
        if missing:
            self._say(f"recording what {len(missing)} of {len(tests)} test files cover")
        if sum(1 for _ in self._spread(missing, self._record)) < len(missing):
            return None
        recordings = {test: self._baseline.read(test) for test in tests}
        used = {name for recording in recordings.values() for name in recording["lines"]}
        parts = [f"{name} {digest_of(self.sources[name])}" for name in sorted(used)]
        parts += sorted(self._baseline.file(test).name for test in tests)
        parts.append(f"budget {self._budget}")
        self.digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
        texts = {test: (self._top / test).read_bytes() for test in tests}
        for worker in self._workers:
            worker.collected = tuple(self._tests)
        return CoverageMap(recordings, self.sources, texts)

    def _record(self, worker: Worker, test: str) -> None:
        if test in self._graph_tests:
            try:
                answer = self._graph.record(test)
            except GraphError as error:
                raise CampaignError(str(error)) from error
        else:
            answer = worker.ask({"record": test, "anew": True, "patience": 1800.0,
                                 "slowness": _SLOWNESS, "idle": _IDLE})
            if answer["status"] != "ended" or answer.get("code") not in (0, 5):
                raise CampaignError(f"{test} fails without any fault ({answer['status']}):\n"
                                    f"{worker.output()[-3000:]}")
        self._baseline.keep(test, answer)

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
        order = [test for test in cover.tests_of(fault) if test not in self._unsound]
        if not order:
            return Outcome(fault.key, NO_TEST, "", 0, 0.0, self.digest)
        outcome = Outcome(fault.key, MISSED, "", 0, 0.0, self.digest)
        quick = [test for test in order if test not in self._graph_tests]
        if affordable := cover.within(quick, self._budget):
            task = self._task(fault, affordable, cover)
            answer = worker.ask(task)
            if answer["status"].startswith("crash"):  # counts if it does so again
                self._say(f"{answer['status']}, again: {worker.output()[-1000:]}")
                answer = worker.ask(task)
            outcome = _judged(fault, answer, self.digest)
            if outcome.how == "test" and not self._passes(worker, outcome.by, cover):
                return self._plant(worker, fault, cover)
        for test in order[len(quick):] if not outcome.found else ():
            answer = self._graph.run(self._task(fault, [test], cover))
            outcome = _judged(fault, answer, self.digest, outcome)
            if outcome.found:
                break
        return outcome

    def _passes(self, worker: Worker, test: str, cover: CoverageMap) -> bool:
        """Whether a test that found something passes without a fault and without coverage; one
        that does not twice is used no more."""
        if test in self._sound:
            return True
        for left_out in ("again", "left out"):
            answer = worker.ask(self._common([test], cover, 10.0))
            if answer["status"] == "ended" and answer.get("code") == 0:
                self._sound.add(test)
                return True
            self._say(f"{left_out}, as it fails without a fault ({answer['status']}): {test}\n"
                      f"{worker.output()[-3000:]}")
        self._unsound.add(test)
        return False

    def _task(self, fault: Fault, order: list[str], cover: CoverageMap) -> dict:
        source = self.sources[fault.file]
        return self._common(order, cover) | {
            "file": fault.file, "was": source.decode(), "text": fault.apply(source).decode(),
            "compiled": fault.compiled, "names": fault.names,
            "anew": bool(fault.names) and not fault.compiled or cover.imports(fault),
            "wall": 300.0 + 10.0 * cover.total(order),  # a graph's
        }

    def _common(self, order: list[str], cover: CoverageMap, times: float = 1.0) -> dict:
        return {
            "order": order, "anew": False, "slowness": _SLOWNESS, "idle": _IDLE,
            "seconds": {test: cover.alone(test) for test in order},
            "patience": times * self._patience,
        }

    @property
    def _results(self) -> Path:
        return self._folder / "results.jsonl"

    def _spread(self, tasks: list, work: Callable[[Worker, object], object]) -> Iterable[object]:
        try:
            yield from spread(self._workers, tasks, work, lambda: self.late)
        except WorkerError as error:
            raise CampaignError(str(error)) from error


def _judged(fault: Fault, answer: dict, digest: str, before: Outcome | None = None) -> Outcome:
    """How the fault was found, and by which test; or that it was missed."""
    by = (answer.get("failed") or [""])[0]
    if answer.get("outside"):
        how, _, by = answer["outside"].partition(" ")
    elif answer["status"] != "ended":
        how = answer["status"].partition(" ")[0]
    elif answer.get("memory"):
        how = "memory"
    elif by:
        how = "test"
    elif answer.get("code") == 0:
        how = MISSED
    else:
        how = "import"  # the tests could not even be collected, or pytest itself fell
    ran, seconds = answer.get("ran", 0), answer.get("cpu", answer.get("seconds", 0.0))
    if before is not None:
        ran, seconds = ran + before.ran, seconds + before.seconds
    return Outcome(fault.key, how, by, ran, round(seconds, 3), digest)
