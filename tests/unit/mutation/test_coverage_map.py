"""Which tests are run for a fault, and in which order."""

from __future__ import annotations

import pytest

from mutation_tool.coverage_map import CoverageMap
from mutation_tool.faults import Fault, faults_of
from mutation_tool.recording import COLLECTING

SHAPES = b"""from .limits import LIMIT
UNIT = 2.0
AREA = UNIT * 3


def area(a):
    return a * AREA


def slow(a):
    return _kernel(a) + 1


@compiled("f8(f8)")
def _kernel(a):
    return a + 2


def nobody(a):
    return a - 4


def made(a):
    return a - 5


FIVE = made(10)
"""
LIMITS = b"LIMIT = 5.0\n"
SOURCES = {"src/shapes.py": SHAPES, "src/limits.py": LIMITS}
RECORDING = {
    "lines": {
        "src/shapes.py": {
            "1": [COLLECTING], "2": [COLLECTING],
            "7": ["tests/a.py::quick", "tests/a.py::long", "fixture shared of tests/a.py"],
            "11": ["tests/a.py::other"],
            "24": [COLLECTING],
        },
        "src/limits.py": {"1": [COLLECTING]},
    },
    "shared": {"fixture shared of tests/a.py": ["tests/a.py::user"]},
    "seconds": {"tests/a.py::quick": 0.1, "tests/a.py::long": 3.0, "tests/a.py::user": 0.05,
                "tests/a.py::other": 0.2, "tests/a.py::failing": 0.1},
    "failed": {},
}
SECOND = {"lines": {"src/shapes.py": {"24": ["tests/b.py::brief"], "7": ["tests/b.py::brief"]}},
          "shared": {}, "seconds": {"tests/b.py::brief": 0.01}, "failed": {}}


def found_at(line: int, file: str = "src/shapes.py", failed: tuple[str, ...] = ()) -> list[str]:
    recordings = {"tests/a.py": RECORDING | {"failed": dict.fromkeys(failed, "skipped")},
                  "tests/b.py": SECOND}
    texts = {"tests/a.py": b"from shapes import area", "tests/b.py": b"from shapes import _kernel"}
    cover = CoverageMap(recordings, SOURCES, texts)
    fault: Fault = next(f for f in faults_of(SOURCES[file], file) if f.line == line)
    return [name.rpartition(":")[2] for name in cover.tests_of(fault)]


def test_tests_of_the_line_quick_ones_and_quick_files_first() -> None:
    assert found_at(7) == ["brief", "user", "quick", "long"]


def test_nothing_runs_an_uncovered_line() -> None:
    assert found_at(20) == []


def test_what_fails_or_is_skipped_tells_nothing() -> None:
    assert found_at(7, failed=("tests/a.py::quick",)) == ["brief", "user", "long"]


def test_a_constant_is_seen_where_it_is_used_through_other_constants() -> None:
    assert found_at(2) == ["brief", "user", "quick", "long"]


def test_a_constant_is_seen_where_it_is_an_argument_s_default() -> None:
    source = b"""STEP, LAST = 3, 4


def up(a, step=STEP,
       *, most: int | None = LAST):
    return a + step
"""
    recording = {"lines": {"a.py": {"6": ["t.py::up"]}}, "shared": {}, "failed": {},
                 "seconds": {"t.py::up": 0.01, "t.py::other": 0.01}}  # fmt: skip
    cover = CoverageMap({"t.py": recording}, {"a.py": source})
    fault = next(f for f in faults_of(source, "a.py") if f.line == 1)
    assert cover.tests_of(fault) == ["t.py::up"]


def test_a_compiled_function_is_seen_where_it_is_called_and_where_a_test_imports_it() -> None:
    assert found_at(16) == ["brief", "other"]


def test_of_a_compiled_function_those_that_call_it_through_fewest_others_come_first() -> None:
    source = b"""@compiled("f8(f8)")
def least(a):
    return a + 2


@compiled("f8(f8)")
def around(a):
    return least(a)


def far(a):
    return around(a)


def near(a):
    return least(a)
"""
    lines = {"12": ["t.py::far"], "16": ["t.py::near"]}
    recording = {"lines": {"a.py": lines}, "shared": {}, "failed": {},
                 "seconds": {"t.py::far": 0.01, "t.py::near": 0.8}}  # fmt: skip
    cover = CoverageMap({"t.py": recording}, {"a.py": source})
    fault = next(f for f in faults_of(source, "a.py") if f.line == 3)
    assert cover.tests_of(fault) == ["t.py::near", "t.py::far"]


@pytest.mark.parametrize(("name", "text"), [
    ("u.py", b"from room.shapes import Box"), ("u.py", b"from room import shapes"),
    ("u.py", b"import shapes"), ("room/test_shapes.py", b"from room import Box"),
])
def test_quick_ones_of_files_about_the_module_come_before_quicker_ones(
    name: str, text: bytes
) -> None:
    b, c = f"{name}::b", f"{name}::c"
    recording = {"lines": {"src/shapes.py": {"7": ["t.py::a", b, c]}}, "shared": {},
                 "failed": {}, "seconds": {"t.py::a": 0.01, b: 0.8, c: 1.6}}
    fault = next(f for f in faults_of(SHAPES, "src/shapes.py") if f.line == 7)
    cover = CoverageMap({"t.py": recording}, SOURCES, {"t.py": b"", name: text})
    assert cover.tests_of(fault) == [b, "t.py::a", c]


def test_those_that_run_what_is_compiled_as_plain_python_come_first() -> None:
    source = b"""LIMIT = 3


@inlined
def least(a):
    return a + LIMIT


def near(a):
    return least(a)
"""
    recording = {"lines": {"a.py": {"6": ["t.py::plain"], "10": ["t.py::plain", "t.py::near"]}},
                 "shared": {}, "failed": {}, "seconds": {"t.py::near": 0.01, "t.py::plain": 0.8}}
    cover = CoverageMap({"t.py": recording}, {"a.py": source})
    for line in (1, 6):
        fault = next(f for f in faults_of(source, "a.py") if f.line == line)
        assert cover.tests_of(fault) == ["t.py::plain", "t.py::near"]


def test_what_a_class_declares_is_nothing_to_those_that_run_compiled_code_as_plain_python() -> None:
    source = b"""class Box:
    size: int = 3


@compiled("f8(f8)")
def least(size):
    return size


def near(box):
    return box.size
"""
    lines = {"7": ["t.py::plain"], "11": ["t.py::plain", "t.py::near"]}
    recording = {"lines": {"a.py": lines}, "shared": {}, "failed": {},
                 "seconds": {"t.py::near": 0.01, "t.py::plain": 0.8}}
    cover = CoverageMap({"t.py": recording}, {"a.py": source})
    fault = next(f for f in faults_of(source, "a.py") if f.line == 2)
    assert cover.tests_of(fault) == ["t.py::near", "t.py::plain"]


def test_those_that_run_something_of_its_folder_come_first() -> None:
    sources = {"room/kernel.py": b"@inlined\ndef kernel(a):\n    return a + 2\n",
               "room/draw.py": b"from .kernel import kernel\n\n\ndef draw(a):\n    return a - 1\n",
               "other/use.py": b"from room.kernel import kernel\n\n\ndef use(a):\n"
                               b"    return kernel(a)\n"}  # fmt: skip
    lines = {"room/draw.py": {"5": ["t.py::draws"]}, "other/use.py": {"5": ["t.py::draws",
                                                                           "t.py::brief"]}}
    recording = {"lines": lines, "shared": {}, "failed": {},
                 "seconds": {"t.py::brief": 0.01, "t.py::draws": 0.8}}  # fmt: skip
    cover = CoverageMap({"t.py": recording}, sources)
    fault = next(f for f in faults_of(sources["room/kernel.py"], "room/kernel.py") if f.line == 3)
    assert cover.tests_of(fault) == ["t.py::draws", "t.py::brief"]


def test_a_constant_that_only_imports_see_gets_the_tests_that_import_it() -> None:
    assert set(found_at(1, "src/limits.py")) == {"quick", "long", "user", "other", "failing"}


def test_what_runs_when_test_files_are_imported_concerns_all_their_tests() -> None:
    assert set(found_at(24)) == {"brief", "quick", "long", "user", "other", "failing"}


def test_total_is_what_the_tests_took() -> None:
    cover = CoverageMap({"tests/a.py": RECORDING}, SOURCES)
    assert cover.total(["tests/a.py::quick", "tests/a.py::long"]) == 3.1


def test_a_shared_fixture_s_time_is_that_of_each_test_that_needs_it_and_once_a_file_s() -> None:
    quick, plain, shared = "t.py::quick", "t.py::plain", "t.py::shared"
    seconds = {shared: 0.01, quick: 0.02, plain: 1.0, "u.py::other": 0.25}
    recording = {"lines": {"src/shapes.py": {"7": [*seconds]}}, "failed": {}, "seconds": seconds,
                 "shared": {"run": [quick, shared], "folder": [shared]},
                 "making": {"run": 2.0, "folder": 0.5}}  # fmt: skip
    cover = CoverageMap({"t.py": recording}, SOURCES)
    fault = next(f for f in faults_of(SHAPES, "src/shapes.py") if f.line == 7)
    order = cover.tests_of(fault)
    assert order == ["u.py::other", plain, quick, shared]
    assert [cover.alone(test) for test in order] == pytest.approx([0.25, 1.0, 2.02, 2.51])
    assert cover.total(order) == pytest.approx(0.25 + 1.0 + 2.02 + 0.51)
    assert cover.total([quick, "u.py::other", quick]) == pytest.approx(2.02 + 0.25 + 2.02)
    assert cover.within(order, 3.2) == order[:2] and cover.within(order, 3.3) == order[:3]
