"""pytest plugins: which test runs which lines, and running chosen tests in a chosen order."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from coverage import Coverage

COLLECTING = "collecting"


class Recorder:
    """Switches coverage's context with each test and each fixture that several tests share."""

    def __init__(self, coverage: Coverage) -> None:
        self._coverage = coverage
        self._context = COLLECTING
        self.shared: dict[str, list[str]] = {}
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
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        before = self._context
        self._switch(_label(fixturedef))
        try:
            return (yield)
        finally:
            self._switch(before)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if not report.passed:
            self.failed.setdefault(report.nodeid, report.outcome)


def _label(definition: pytest.FixtureDef) -> str:
    return f"fixture {definition.argname} of {definition.baseid}"


class Chosen:
    """Runs these tests alone, in this order; `failed` is the first that failed."""

    def __init__(self, order: list[str]) -> None:
        self._place = {name: k for k, name in enumerate(order)}
        self.failed: list[str] = []
        self.ran = 0

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        kept = [item for item in items if item.nodeid in self._place]
        items[:] = sorted(kept, key=lambda item: self._place[item.nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.ran += report.when == "setup"
        if report.failed and report.nodeid not in self.failed:
            self.failed.append(report.nodeid)


def _options(top: Path) -> list[str]:
    return ["-q", "-p", "no:cacheprovider", "-c", str(top / "pyproject.toml"), f"--rootdir={top}"]


def record(top: Path, test_file: str, answer: Path) -> int:
    """Run one test file below `top` under coverage; writes what CoverageMap reads to `answer`."""
    coverage = Coverage(data_file=None, include=[f"{top}/src/*"], config_file=False)
    recorder = Recorder(coverage)
    coverage.start()
    coverage.switch_context(COLLECTING)
    code = pytest.main([*_options(top), str(top / test_file)], plugins=[recorder])
    coverage.stop()
    data = coverage.get_data()
    lines = {
        str(Path(file).relative_to(top)): {
            str(line): contexts for line, contexts in data.contexts_by_lineno(file).items()
        }
        for file in data.measured_files()
    }
    answer.write_text(json.dumps({
        "code": int(code), "lines": lines, "shared": recorder.shared,
        "seconds": recorder.seconds, "failed": recorder.failed,
    }))
    return int(code)


def run(top: Path, order: list[str], answer: Path, stop_at_first: bool) -> int:
    """Run these tests; writes {code, failed, ran} to `answer`."""
    chosen = Chosen(order)
    files = list(dict.fromkeys(str(top / name.partition("::")[0]) for name in order))
    stop = ["-x"] if stop_at_first else []
    code = pytest.main([*_options(top), *stop, *files], plugins=[chosen])
    answer.write_text(json.dumps(
        {"code": int(code), "failed": chosen.failed, "ran": chosen.ran}
    ))
    return int(code)
