"""Faults that hang, take all memory, write outside or break the set-up: ended, named, and nothing
is left of them."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import pytest

from aras_visual_servo_base.compiled import compiled
from mutation_tool import guard, recording
from mutation_tool.areas import Area
from mutation_tool.campaign import Campaign, Outcome
from mutation_tool.faults import Fault

TOY = '''import os
import subprocess
import tempfile
from pathlib import Path

HOME = Path.home()
TOP = 1


def turn(a):
    return a


def helper():
    return "sleep 0"


def note(folder):
    (folder / "note.txt").write_text("noted")
    return folder


def use(kind):
    if kind == "note":
        return note(Path(tempfile.mkdtemp()))
    if kind == "process":
        return subprocess.run(helper(), shell=True).returncode
    return turn(kind)
'''
TESTS = """import toy


def test_turn():
    assert toy.use(1) == 1


def test_note():
    assert (toy.use("note") / "note.txt").is_file()


def test_process():
    assert toy.use("process") == 0
"""
CONFTEST = "import toy\n\nassert toy.TOP == 1\n"


def workspace(folder: Path) -> Path:
    """The toy workspace, a git checkout, in a folder."""
    top = folder / "work"
    for name, text in (("src/toy.py", TOY), ("tests/test_toy.py", TESTS),
                       ("tests/conftest.py", CONFTEST),
                       ("pyproject.toml", '[tool.pytest.ini_options]\npythonpath = ["src"]\n')):
        (top / name).parent.mkdir(parents=True, exist_ok=True)
        (top / name).write_text(text)
    subprocess.run(["git", "init", "-q", str(top)], check=True)
    return top


def campaign(folder: Path, top: Path) -> Campaign:
    return Campaign(Area("toy", ("src/toy.py",), ("tests",)), top, folder / "out", 1,
                    time.monotonic() + 300.0, print, patience=1.0,
                    libraries=("pytest", "coverage"))


def fault_of(was: str, now: str) -> Fault:
    """`now` for `was` in the toy."""
    start = TOY.index(was)
    line = TOY.count("\n", 0, start) + 1
    top_level = was == was.lstrip() and was.startswith("TOP")
    return Fault("src/toy.py", "", "constant", (line, line), ("TOP",) if top_level else (),
                 False, start, start + len(was), now, line, was, now, now[:12])


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str, str], Outcome]]:
    """Plants `now` for `was` in a toy workspace and says what became of it."""
    folder = tmp_path_factory.mktemp("bad")
    run = campaign(folder, workspace(folder))
    cover = run.record()
    copy = folder / "out" / "copies" / "0"
    before = files_of(copy)

    def plant(was: str, now: str) -> Outcome:
        ((_, outcome),) = run.run([fault_of(was, now)], cover)
        assert files_of(copy) == before and left_of(copy) == []
        assert (copy / "src" / "toy.py").read_text() == TOY
        return outcome

    yield plant
    run.close()


def files_of(copy: Path) -> set[str]:
    """All files of a copy but what Python compiles and what the last task answered."""
    return {
        str(path.relative_to(copy)) for path in copy.rglob("*")
        if "__pycache__" not in path.parts and not path.name.startswith(".")
    }


def left_of(copy: Path, server: str = "mutation_tool.worker") -> list[str]:
    """Command lines of processes that work in the copy, its server's own apart."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and os.readlink(entry / "cwd") == str(copy):
                text = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                if not server or server not in text:
                    found.append(text)
        except OSError:
            continue
    return found


@pytest.mark.parametrize("now", ["while True: pass", "__import__('time').sleep(1e6)"])
def test_one_that_hangs_is_ended(plant: Callable, now: str, monkeypatch: pytest.MonkeyPatch,
                                 ) -> None:
    monkeypatch.setattr("mutation_tool.campaign._SLOWNESS", 2.0)
    monkeypatch.setattr("mutation_tool.campaign._IDLE", 1.0)
    outcome = plant("return a", now)
    assert (outcome.how, outcome.found) == ("time-out", True)


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_nothing_goes_on_once_the_campaign_is_ended(
    tmp_path: Path, how: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It left the test of a fault that hangs to run on, with what that had started."""
    monkeypatch.setattr("mutation_tool.campaign._IDLE", 1000.0)
    top, copy = workspace(tmp_path), tmp_path / "out" / "copies" / "0"
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            run = campaign(tmp_path, top)
            cover = run.record()
            os.write(write, b"recorded")
            list(run.run([fault_of("return a", "return os.system('sleep 1000; true')")], cover))
        finally:
            os._exit(1)
    try:
        assert os.read(read, 8) == b"recorded"
        wait_until(lambda: any("sleep 1000" in line for line in left_of(copy)))
    finally:
        os.kill(child, how)
        os.waitpid(child, 0)
        os.close(read), os.close(write)
    wait_until(lambda: left_of(copy, server="") == [])


def wait_until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_one_that_takes_all_memory_is_ended(plant: Callable) -> None:
    outcome = plant("return a", "return bytearray(1 << 36)")
    assert (outcome.how, outcome.by) == ("memory", "tests/test_toy.py::test_turn")


def test_one_that_writes_outside_its_folder_is_refused(plant: Callable, tmp_path: Path) -> None:
    outcome = plant('(folder / "note.txt")', f'Path("{tmp_path}/note.txt")')
    assert (outcome.how, outcome.by) == ("write", f"{tmp_path}/note.txt")
    assert not (tmp_path / "note.txt").exists()


def test_one_that_removes_what_stands_outside_is_refused(plant: Callable, tmp_path: Path) -> None:
    kept = tmp_path / "kept.txt"
    kept.write_text("kept")
    outcome = plant('(folder / "note.txt").write_text("noted")', f'os.remove("{kept}")')
    assert (outcome.how, outcome.by) == ("write", str(kept))
    assert kept.read_text() == "kept"


@pytest.mark.parametrize("how", ["kill({}, 15)", "kill(-{}, 15)", "killpg({}, 15)"])
def test_one_that_signals_another_s_process_is_refused(plant: Callable, how: str) -> None:
    with subprocess.Popen(["sleep", "60"], start_new_session=True) as other:
        try:
            outcome = plant("return a", f"return os.{how.format(other.pid)} or a")
            assert other.poll() is None
        finally:
            other.kill()
    assert (outcome.how, outcome.by) == ("signal", f"process {other.pid}")


def test_one_that_signals_every_process_is_refused(plant: Callable) -> None:
    outcome = plant("return a", "return os.kill(-1, __import__('signal').SIGCONT) or a")
    assert (outcome.how, outcome.by) == ("signal", "process -1")


@pytest.mark.parametrize("end", ["p.terminate()", "os.killpg(p.pid, 15)", "os.kill(1, 0)"])
def test_one_that_signals_its_own_processes_may(plant: Callable, end: str) -> None:
    begun = "subprocess.Popen(['sleep', '1'], start_new_session=True)"
    assert not plant("return a", f"return (lambda p: ({end}, p.wait()) and a)({begun})").found


def test_home_and_temporary_folder_are_its_own(plant: Callable, tmp_path: Path) -> None:
    before = set(Path.home().iterdir())
    outcome = plant('(folder / "note.txt")', '(Path.home() / "note.txt")')
    assert outcome.how == "test"
    assert set(Path.home().iterdir()) == before


def test_one_that_writes_into_the_sources_leaves_them_as_they_were(plant: Callable) -> None:
    outcome = plant('(folder / "note.txt").write_text("noted")',
                    'Path("src/toy.py").write_text("oh"); Path("src/new.py").touch()')
    assert outcome.how == "test"  # `plant` looks at the files


def test_one_that_breaks_the_set_up_is_named(plant: Callable) -> None:
    assert plant("TOP = 1", "TOP = 2").how == "import"
    assert plant("TOP = 1", "TOP = 1 / 0").how == "import"


def test_processes_that_leave_their_group_are_ended(plant: Callable) -> None:
    outcome = plant('return "sleep 0"', 'return "setsid sleep 1000 & exit 3"')
    assert outcome.how == "test"  # `plant` looks for processes


def test_compiling_does_not_count_for_the_test_that_calls_first() -> None:
    """It took longer than the test might, so faults of compiled functions were never tried."""
    inner = numba.njit(lambda a: a + 1)
    outer = numba.njit(lambda a: inner(a) + inner(1.0 * a))
    limits: list[float] = []
    chosen = recording.Chosen(["test_f"], {"test_f": 0.5}, limits.append, patience=3.0)
    running = chosen.pytest_runtest_protocol(SimpleNamespace(nodeid="test_f"))
    next(running)
    assert outer(2) == 6.0
    assert outer(3) == 8.0  # compiled by now
    assert limits == [5.0, recording.COMPILING, 5.0] and gc.isenabled()
    with pytest.raises(StopIteration):
        running.send(None)
    assert numba.njit(lambda a: a - 1)(2) == 1 and len(limits) == 3


def test_nothing_is_compiled_while_test_files_are_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    chosen = recording.Chosen([], {}, print, patience=1.0)
    count = compiled("i8[::1]")(lambda a: len(a))
    chosen.pytest_load_initial_conftests()
    later = compiled("i8[::1]")(lambda a: len(a) + 1)
    chosen.pytest_collection_finish()
    at_once = compiled("i8[::1]")(lambda a: len(a) + 2)
    assert [bool(one.signatures) for one in (count, later, at_once)] == [True, False, True]
    assert later(np.arange(3)) == 4 and later.signatures


def test_a_deadline_is_read_whole_while_a_child_sets_it() -> None:
    """`struct.pack_into` writes zero first: a parent that read it ended a child that had time."""
    deadline = guard.Deadline()
    deadline.set(600.0)
    child = os.fork()
    if child == 0:
        try:
            for _ in range(200_000):
                deadline.set(600.0)
        finally:
            os._exit(0)
    while not (done := os.waitpid(child, os.WNOHANG)[0]):
        assert not any(deadline.over for _ in range(100))
    assert done == child


def test_a_limit_of_time_is_of_each_test(monkeypatch: pytest.MonkeyPatch) -> None:
    deadline = guard.Deadline()
    now = 100.0
    monkeypatch.setattr(guard.time, "monotonic", lambda: now)
    deadline.set(5.0)
    assert not deadline.over
    now = 105.1
    assert deadline.over
