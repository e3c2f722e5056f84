"""The whole tool on a toy workspace: what its tests hold is found, what they do not is missed."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from mutation_tool import cli, trees
from mutation_tool.areas import Area, UnknownAreaError, area_named
from mutation_tool.baseline import Baseline
from mutation_tool.campaign import Campaign, CampaignError, Outcome
from mutation_tool.equivalents import Equivalents, EquivalentsError
from mutation_tool.faults import Fault, sample
from mutation_tool.report import Report
from mutation_tool.workers import Worker

TOY = """def added(a, b):
    return a + b


def scaled(a):
    return 2.0 * a


def forgotten(a):
    return a - 1


def counted(n):
    while n > 0:
        n -= 1
    return n
"""
TESTS = """import time
import pytest
from toy import added, counted, scaled

@pytest.fixture(scope="module")
def six():
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
    return added(3, 3)

def test_added():
    assert added(1, 2) == 3

def test_six(six):
    assert six == 6

def test_scaled():
    assert scaled(0.0) == 0.0

def test_counted():
    assert counted(3) == 0

def test_script():
    import runpy
    assert runpy.run_path("src/script")["two"]() == 2
"""
AREA = Area("toy", ("src/toy.py",), ("tests",))


@pytest.fixture
def top(tmp_path: Path) -> Path:
    """A git checkout with one module and its tests."""
    top = tmp_path / "work"
    (top / "src").mkdir(parents=True)
    (top / "tests").mkdir()
    (top / "src" / "toy.py").write_text(TOY)
    (top / "src" / "script").write_text("def two():\n    return 2\n")  # without .py
    (top / "tests" / "test_toy.py").write_text(TESTS)
    (top / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["src"]\n')
    subprocess.run(["git", "init", "-q", str(top)], check=True)
    return top


def campaign(top: Path, minutes: float = 5.0, say: Callable[[str], None] = print) -> Campaign:
    deadline = time.monotonic() + 60.0 * minutes
    return Campaign(AREA, top, top.parent / "out", 1, deadline, say,
                    patience=0.5, libraries=("pytest", "coverage"))


def drawn(only: str = "") -> list[Fault]:
    return sample({"src/toy.py": TOY.encode()}, 99, 1, only)


def test_found_and_missed(top: Path) -> None:
    run = campaign(top)
    cover = run.record()
    faults = [f for f in drawn("added|scaled|forgotten|n -=") if f.now != "pass"]  # hangs too
    outcomes = {f.now: o for f, o in run.run(faults, cover)}
    run.close()
    assert {now: outcome.how for now, outcome in outcomes.items()} == {
        "return a - b": "test", "return 2.5 * a": "missed", "return 2.0 / a": "test",
        "return a + 1": "no test", "return a - 2": "no test", "n += 1": "time-out",
        "n -= 2": "test",
    }
    assert outcomes["return a - b"].by.endswith(("::test_added", "::test_six"))
    assert outcomes["return 2.5 * a"].ran == 1
    assert (top / "src" / "toy.py").read_text() == TOY
    assert (top.parent / "out" / "copies" / "0" / "src" / "toy.py").read_text() == TOY
    again = campaign(top)
    again.record()
    assert again.known() == {outcome.key: outcome for outcome in outcomes.values()}
    with (top / "tests" / "test_toy.py").open("a") as file:
        file.write("\ndef test_more():\n    assert scaled(1.0) == 2.0\n")
    later = campaign(top)
    cover = later.record()
    known = later.known()
    assert {o.how for o in known.values()} == {"test", "time-out"}  # misses are tried again
    ((_, outcome),) = later.run([f for f in drawn("scaled") if f.operator == "constant"], cover)
    later.close()
    assert outcome.by == "tests/test_toy.py::test_more"


def test_what_test_files_make_when_they_are_collected_goes_with_the_copy_s_processes(
    top: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (top / "tests" / "test_toy.py").write_text(f"import tempfile\ntempfile.mkdtemp()\n{TESTS}")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    run = campaign(top)
    assert {o.how for _, o in run.run(drawn("added"), run.record())} == {"test"}
    run.close()
    left = [*(tmp_path / "temporary").iterdir(), *(top.parent / "out").rglob(".temporary")]
    assert left == []


def test_what_tests_load_by_its_path_and_keep_from_the_collector_gets_the_fault(top: Path) -> None:
    (top / "tests" / "test_toy.py").write_text(
        "import gc, importlib.util\nfrom pathlib import Path\n"
        "spec = importlib.util.spec_from_file_location('own', Path(__file__).parents[1] / "
        "'src/toy.py')\ntoy = importlib.util.module_from_spec(spec)\n"
        "spec.loader.exec_module(toy)\ngc.freeze()\n"
        "def test_added():\n    assert toy.added(1, 2) == 3\n")
    run = campaign(top)
    cover = run.record()
    ((_, outcome),) = run.run([f for f in drawn("added") if f.now == "return a - b"], cover)
    run.close()
    assert outcome.how == "test"


def test_what_a_shared_fixture_takes_is_recorded_apart(top: Path) -> None:
    run = campaign(top)
    cover = run.record()
    run.close()
    six = "tests/test_toy.py::test_six"
    assert cover.seconds[six] < 0.15 and cover.alone(six) > 0.19
    assert cover.alone("tests/test_toy.py::test_added") < 0.15


def test_recordings_hold_until_their_tests_change(top: Path) -> None:
    run = campaign(top)
    run.record()
    run.close()
    (kept,) = (top.parent / "out" / "recordings").iterdir()
    (top / "src" / "toy.py").write_text(TOY.replace("2.0 * a", "2 * a"))
    assert campaign(top, minutes=0.0).record() is not None
    assert campaign(top, minutes=0.0).record(anew=True) is None
    (top / "tests" / "conftest.py").write_text("")
    assert campaign(top, minutes=0.0).record() is None
    assert list((top.parent / "out" / "recordings").iterdir()) == [kept]


def test_lines_of_a_source_that_has_changed_are_found_again(top: Path) -> None:
    was = "a = 1\nb = 2\nc = 3\nd = 4\n"
    now = "new = 0\na = 1\nb = 22\nbb = 23\nc = 3\n"
    name, test = "src/toy.py", "tests/test_toy.py"
    lines = {str(line): [f"t{line}"] for line in (1, 2, 3, 4)}
    folder = top.parent / "out"
    Baseline(top, folder, {name: was.encode()}).keep(test, {"lines": {name: lines}})
    same = Baseline(top, folder, {name: was.encode()})
    assert same.read(test)["lines"][name] == lines and not same.old(test)
    later = Baseline(top, folder, {name: now.encode()})
    file = later.file(test)
    (top / test).write_text(TESTS + "\n")  # somebody writes on while the campaign runs
    assert later.file(test) == file
    (top / test).write_text(TESTS)
    assert later.holds(test) and later.old(test)
    assert later.read(test)["lines"][name] == {
        "1": ["t1"], "2": ["t1"], "3": ["t2"], "4": ["t2"], "5": ["t3"]
    }


def test_two_runs_never_share_a_copy(tmp_path: Path) -> None:
    first, held = trees.free_copy(tmp_path)
    assert trees.free_copy(tmp_path)[0] != first
    held.close()
    assert trees.free_copy(tmp_path)[0] == first


def test_failing_tests_are_refused_unless_they_are_skipped(top: Path) -> None:
    (top / "tests" / "test_wrong.py").write_text("def test_wrong():\n    assert False\n")
    run = campaign(top)
    with pytest.raises(CampaignError, match="test_wrong.py fails without any fault"):
        run.record()
    run.close()
    later = time.monotonic() + 60.0
    run = Campaign(AREA, top, top.parent / "out", 1, later, print, skip="wrong",
                   libraries=("pytest", "coverage"))
    assert run.record() is not None
    run.close()


def test_a_process_that_a_test_spawns_needs_nothing_of_the_tool(top: Path) -> None:
    (top / "tests" / "test_toy.py").write_text(
        "import multiprocessing\n\ndef test_spawned():\n"
        "    process = multiprocessing.get_context('spawn').Process(target=print)\n"
        "    process.start()\n    process.join()\n    assert process.exitcode == 0\n")
    run = campaign(top)
    run.record()
    run.close()


def test_nothing_is_begun_when_time_is_up(top: Path) -> None:
    run = campaign(top, minutes=0.0)
    assert run.record() is None


def test_report(top: Path) -> None:
    run = campaign(top)
    cover = run.record()
    run.close()
    faults = drawn("added|scaled|forgotten")
    by_line = {f.now: f for f in faults}
    report = Report(faults, {by_line["return a - 2"].key}, cover)
    report.outcomes = {
        by_line[now].key: Outcome(by_line[now].key, how, "", 1, seconds, "")
        for now, how, seconds in (("return a - b", "test", 0.2), ("return 2.5 * a", "missed", 0.9),
                                  ("return a + 1", "no test", 0.0),
                                  ("return 2.0 / a", "time-out", 0.5))
    }
    text = report.text("toy")
    assert report.reached(0.5) is False  # more than a tenth is called equivalent
    assert json.loads(text.splitlines()[-1]) == {
        "area": "toy", "sampled": 5, "found": 2, "missed": 2, "equivalent": 1, "bad": 1,
        "score": 0.5, "seconds": 0.4
    }
    assert "\ntime-out: src/toy.py:6 return 2.0 / a\n" in text
    assert "missed: src/toy.py:6 scaled (constant" in text
    assert "  - return 2.0 * a\n  + return 2.5 * a\n  ran: test_toy.py::test_scaled" in text
    assert "constant          0       1        0           1" in text
    assert "sign              1       0        1           0" in text
    assert "more than a tenth" in text
    del report.outcomes[by_line["return a + 1"].key]
    assert "1 of 5 not planted yet" in report.text("toy")


def test_unknown_areas_name_the_nearest() -> None:
    with pytest.raises(UnknownAreaError, match=r"no area visoin; did you mean vision\? known: ren"):
        area_named("visoin")
    assert cli.main(["nothing-like-it", "--list"]) == 2


def test_an_area_without_sources_says_so(tmp_path: Path) -> None:
    with pytest.raises(UnknownAreaError, match="area toy has no sources yet: src/toy.py"):
        AREA.source_files(tmp_path)
    with pytest.raises(UnknownAreaError, match="area toy has no tests yet: tests"):
        AREA.test_files(tmp_path)


def test_equivalents_are_known_by_what_they_change(tmp_path: Path) -> None:
    file = tmp_path / "equivalents.yaml"
    file.write_text("- {file: toy.py, in: scaled, was: 'return 2.0  * a', now: return 2.5 * a,\n"
                    "   why: toys have no scale}\n")
    known = Equivalents.load(file)
    moved = sample({"src/room/toy.py": b"\n\n" + TOY.encode()}, 99, 1, "scaled")
    reasons = {f.now: known.reason(f) for f in moved}
    assert reasons == {"return 2.5 * a": "toys have no scale", "return 2.0 / a": None}


@pytest.mark.parametrize(("text", "why"), [
    ("- {file: toy.py}", "1: needs the texts file"), ("- why", "1: needs the texts file"),
    ("- {file: 1, in: a, was: b, now: c, why: d}", "1: needs the texts file"),
    (2 * "- {file: e.py, in: a, was: b, now: c, why: d}\n", "2: it stands there twice"),
])
def test_a_wrong_list_of_equivalents_is_refused(text: str, why: str, tmp_path: Path) -> None:
    file = tmp_path / "equivalents.yaml"
    file.write_text(text)
    with pytest.raises(EquivalentsError, match=f"equivalents.yaml, entry {why}"):
        Equivalents.load(file)


def test_a_test_that_passes_under_coverage_alone_finds_nothing(top: Path) -> None:
    with (top / "tests" / "test_toy.py").open("a") as file:
        file.write("\ndef test_traced():\n    import sys\n    assert sys.gettrace()\n"
                   "    assert scaled(1.0) == 2.0\n")
    said: list[str] = []
    run = campaign(top, say=said.append)
    outcomes = {f.now: o for f, o in run.run(drawn("scaled"), run.record())}
    run.close()
    assert outcomes["return 2.5 * a"].how == "missed"
    assert "again, as it fails without a fault (ended): tests/test_toy.py::test_traced" in said[-2]
    assert "left out, as it fails without a fault (ended): tests/test_toy.py" in said[-1]


def test_one_that_fails_once_without_a_fault_is_asked_again(
    top: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine under load ended it once, and a fault that it had found was counted as missed."""
    ask, checks = Worker.ask, []

    def ask_but_the_first_check(worker: Worker, task: dict) -> dict:
        if "order" in task and "text" not in task:
            checks.append(task["order"])
            if len(checks) == 1:
                return {"status": "time-out"}
        return ask(worker, task)

    monkeypatch.setattr(Worker, "ask", ask_but_the_first_check)
    run = campaign(top)
    outcomes = {f.now: o.how for f, o in run.run(drawn("scaled"), run.record())}
    run.close()
    assert outcomes["return 2.0 / a"] == "test"
    assert checks[0] == checks[1]


def test_a_copy_takes_over_what_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                            ) -> None:
    top, copy = tmp_path / "work", tmp_path / "out" / "0"
    module = top / "src" / "room" / "loops.py"
    module.parent.mkdir(parents=True)
    module.write_text("import numba\n\n@numba.njit('f8(f8)', cache=True)\ndef twice(a):\n"
                      "    return 2.0 * a\n")
    subprocess.run(["git", "init", "-q", str(top)], check=True)
    script = ("import sys; sys.path.insert(0, sys.argv[1]); import loops;"
              "print(sum(loops.twice.stats.cache_hits.values()))")

    def hits(folder: Path) -> int:
        done = subprocess.run([sys.executable, "-c", script, str(folder / "src" / "room")],
                              check=True, capture_output=True, text=True)
        return int(done.stdout)

    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert (hits(top), hits(top)) == (0, 1)
    trees.update(top, copy)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(copy / ".numba"))
    assert hits(copy) == 1
