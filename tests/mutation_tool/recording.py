"""pytest plugins: which test runs which lines, and running chosen tests in a chosen order."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from coverage import Coverage

COLLECTING = "collecting"
COMPILING = 120.0  # processor seconds that compiling a function with what it calls may take


class Recorder:
    """Switches coverage's context with each test and each fixture that several tests share.

    Attributes:
        shared: the tests of each of these fixtures. making: processor seconds that each took.
        seconds: what each test took, without those.
        failed: how, of those that did not pass.
    """

    def __init__(self, coverage: Coverage) -> None:
        self._coverage = coverage
        self._context = COLLECTING
        self._apart = 0.0  # what all fixtures took until now
        self.shared: dict[str, list[str]] = {}
        self.making: dict[str, float] = {}
        self.seconds: dict[str, float] = {}
        self.failed: dict[str, str] = {}

    def _switch(self, context: str) -> None:
        self._context = context
        self._coverage.switch_context(context)

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        for item in session.items:
            definitions = getattr(item, "_fixtureinfo").name2fixturedefs  # noqa: B009
            for several in definitions.values():
                for definition in several:
                    if definition.scope != "function":
                        self.shared.setdefault(_label(definition), []).append(item.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._switch(item.nodeid)
        began, apart = spent(), self._apart
        try:
            return (yield)
        finally:
            self.seconds[item.nodeid] = spent() - began - (self._apart - apart)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        label, before = _label(fixturedef), self._context
        self._switch(label)
        began, apart = spent(), self._apart
        try:
            return (yield)
        finally:
            self._switch(before)
            own = spent() - began - (self._apart - apart)  # it may have asked for another
            self._apart += own
            self.making[label] = max(own, self.making.get(label, 0.0))  # each parameter's

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self.failed.setdefault(report.nodeid, report.outcome)


def spent() -> float:
    """Processor seconds of this process and of its children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _label(definition: pytest.FixtureDef) -> str:
    return f"fixture {definition.argname} of {definition.baseid}"


class Chosen:
    """Runs these tests alone, in this order, until one fails.

    Args:
        order: the tests' ids.
        seconds: processor seconds that each takes without a fault.
        limit: is told before each test how many processor seconds it may take; compiling is
            not counted.
        patience: seconds that each may take besides four times what it takes without a fault.

    Attributes:
        failed: the tests that failed, the first alone where pytest stops there.
        ran: how many were begun.
        memory: one failed because there was no memory.
    """

    def __init__(
        self, order: list[str], seconds: dict[str, float], limit: Callable[[float], None],
        patience: float,
    ) -> None:
        self._place = {name: k for k, name in enumerate(order)}
        self._seconds, self._limit, self._patience = seconds, limit, patience
        self.failed: list[str] = []
        self.ran = 0
        self.memory = False
        self._importing = contextlib.ExitStack()

    def pytest_load_initial_conftests(self) -> None:
        """While test files are imported nothing is compiled: a faulty constant may be in many
        functions, of which the tests call few. Nor is garbage collected, a quarter of the time."""
        gc.disable()
        self._importing.callback(gc.enable)
        with contextlib.suppress(ImportError):
            loops = importlib.import_module("aras_visual_servo_base.compiled")
            self._importing.enter_context(loops.put_off())

    def pytest_collection_finish(self) -> None:
        self._importing.close()

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        kept = [item for item in items if item.nodeid in self._place]
        items[:] = sorted(kept, key=lambda item: self._place[item.nodeid])

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        seconds = self._patience + 4.0 * self._seconds.get(item.nodeid, 0.0)
        self._limit(seconds)
        with _compiling_apart(self._limit, seconds):
            return (yield)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.ran += report.when == "setup"
        if report.failed and report.nodeid not in self.failed:
            self.failed.append(report.nodeid)
            self.memory |= "MemoryError" in report.longreprtext
            print(report.nodeid, report.longreprtext, sep="\n")

    def answer(self, code: int) -> dict[str, object]:
        return {"code": code, "failed": self.failed, "ran": self.ran, "memory": self.memory}


def _compiling_apart(limit: Callable[[float], None], seconds: float) -> AbstractContextManager:
    """A context in which compiling does not count: where a compiled function is faulty, the first
    test that calls it compiles it and what calls it, which takes longer than any test."""
    numba = sys.modules.get("numba.core.event")
    if numba is None:
        return contextlib.nullcontext()

    class Compiling(numba.Listener):
        under_way = 0  # a function's compilation compiles those that it calls

        def on_start(self, event: object) -> None:
            if self.under_way == 0:
                limit(COMPILING)
                gc.disable()  # a fifth of its time
            self.under_way += 1

        def on_end(self, event: object) -> None:
            self.under_way -= 1
            if self.under_way == 0:
                gc.enable()
                limit(seconds)

    return numba.install_listener("numba:compile", Compiling())


def options(top: Path) -> list[str]:
    return ["-q", "-p", "no:cacheprovider", "-p", "no:rerunfailures",
            "-c", str(top / "pyproject.toml"), f"--rootdir={top}"]


def record(top: Path, test_file: str) -> dict[str, object]:
    """Run one test file below `top` under coverage; what CoverageMap reads."""
    coverage = Coverage(data_file=None, include=[f"{top}/src/*"], config_file=False)
    recorder = Recorder(coverage)
    coverage.start()
    coverage.switch_context(COLLECTING)
    code = pytest.main([*options(top), str(top / test_file)], plugins=[recorder])
    coverage.stop()
    data = coverage.get_data()
    lines = {
        str(Path(file).relative_to(top)): {
            str(line): contexts for line, contexts in data.contexts_by_lineno(file).items()
        }
        for file in data.measured_files()
    }
    return {"code": int(code), "lines": lines, "shared": recorder.shared, "making": recorder.making,
            "seconds": recorder.seconds, "failed": recorder.failed}


def run(top: Path, chosen: Chosen, order: list[str]) -> dict[str, object]:
    """Collect these tests and run them."""
    files = list(dict.fromkeys(str(top / name.partition("::")[0]) for name in order))
    return chosen.answer(pytest.main([*options(top), "-x", *files], plugins=[chosen]))
