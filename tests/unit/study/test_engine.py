"""Execution of a study: every run once, reproducible after any interruption, nothing lost."""

from __future__ import annotations

import errno
import hashlib
import importlib.util
import io
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import yaml

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.metrics.metric import metric
from aras_visual_servo_bench.progress_bar import ProgressBar
from aras_visual_servo_bench.studies import chunk_execution as work
from aras_visual_servo_bench.studies import replay, study_folder, versions
from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.studies import study_execution as engine
from aras_visual_servo_bench.studies.pools import InProcessPool, Pool
from aras_visual_servo_bench.studies.study_folder import StudyFolder
from aras_visual_servo_bench.studies.study_progress import StudyProgress, format_duration


@metric("", "smaller", "these tests")
def killing(finished):
    """Ends the process at a gain of 2; prints else, and returns the number of its threads."""
    if finished.experiment.gain == 2.0:
        os.kill(os.getpid(), signal.SIGKILL)
    print("chatter")
    return float(cv2.getNumThreads())


@metric("", "smaller", "these tests")
def failing(finished):
    """Raises at a gain of 4."""
    if finished.experiment.gain == 4.0:
        raise ZeroDivisionError("two\n lines " + "x" * 600)
    return 1.0


def carried(study, path, pool=None, **options):
    made = StudyFolder.create(path, study, "as given")
    engine.run_missing(made, lambda: pool or InProcessPool(), None, **options)
    return made


def hashes(path, kinds=("parts",)):
    return {
        str(p.relative_to(path)): hashlib.sha256(p.read_bytes()).hexdigest()
        for kind in kinds for p in sorted((path / kind).glob("*"))
    }  # fmt: skip


class Dying(Pool):
    """Whose worker dies over its only chunk, unless that is guarded."""

    size, has_room, died = 1, True, False

    def submit(self, task):
        self.task = task

    def wait_for_chunk(self):
        was_dead, self.died = self.died, True
        return self.task, work.carry_out(replace(self.task, is_isolated=True)) if was_dead else None


def test_every_run_is_a_row_with_what_was_set_and_measured(tiny, tmp_path):
    study = tiny()
    made = carried(study, tmp_path)
    table = made.read_results()
    assert table["run"].to_pylist() == list(range(6))
    assert table["gain"].to_pylist() == [1.0, 1.0, 2.0, 2.0, 4.0, 4.0]
    assert table["repeat"].to_pylist() == [0, 1] * 3
    assert table["seed"].to_pylist() == [study.compute_seed(run) for run in range(6)]
    assert set(table["outcome"].to_pylist()) == {"timed_out"}
    far = table["final_distance"].to_pylist()
    assert far[0] > far[2] > far[4] > 0.01
    assert all(0.1 < s < 0.3 for s in table["simulated"].to_pylist())
    assert set(table["images"].to_pylist()) == {5}
    assert "numpy=" in table["versions"][0].as_py() and table["code"][0].as_py()
    times = made.read_results(study_folder.TIMES)
    assert times["run"].to_pylist() == list(range(6))
    for kind in ("wall", "processor"):
        assert all(0.0 < seconds < 60.0 for seconds in times[kind].to_pylist())
    assert (tmp_path / "study.yaml").read_text() == "as given"
    assert not (tmp_path / study_folder.TRACES).exists()


def test_the_last_part_is_counted_by_its_own_runs_and_read_as_it_is_now(tiny, tmp_path):
    study = tiny(repeats=1)  # parts of two runs and of one
    made = carried(study, tmp_path)
    before = made.read_results()
    made.find_part(1).unlink()
    assert made.count_stored_runs() == 2
    done = work.carry_out(work.StudyChunk(json.dumps(study.to_mapping()), 1))
    done.values[0]["reason"] = "of another day"
    made.write_chunk(1, done)
    assert made.read_results()["reason"].to_pylist() == [
        *before["reason"].to_pylist()[:2], "of another day"]


def test_a_part_that_is_no_table_is_run_again_whatever_its_hash_says(tiny, tmp_path):
    made = carried(tiny(), tmp_path)
    for content, told in (
        (b"no table", "^cannot read .*000001.parquet: "),
        (made.find_part(0).read_bytes(), ""),
        (None, "000001.parquet is missing or not a file: "),
    ):
        made.find_part(1).unlink()
        if content is None:
            made.find_part(1).mkdir()
        else:
            made.find_part(1).write_bytes(content)
            with open(tmp_path / study_folder.CHECKSUM_FILE, "a") as sums:
                print(f"{hashlib.sha256(content).hexdigest()}  parts/000001.parquet", file=sums)
        assert StudyFolder.open(tmp_path).find_missing_chunks() == [1]
        if told:
            with pytest.raises(StudyError, match=told):
                StudyFolder.open(tmp_path).read_results()


def test_a_run_that_hangs_ends_as_a_row_and_its_worker_goes_on(tiny, tmp_path):
    rows.compute_row(tiny(), 0)  # what the first run of a process loads counts for none
    study = tiny(metrics=["success", "made_studies:hanging"], chunk=3, repeats=1, limit=2.0)
    table = carried(study, tmp_path).read_results()
    assert table["outcome"].to_pylist() == ["timed_out", rows.LATE, "timed_out"]
    assert table["reason"][1].as_py() == "not finished after 2 s of wall time"
    assert "limit" in table["remedy"][1].as_py()


def test_a_folder_of_another_study_is_refused_with_the_difference(tiny, tmp_path):
    carried(tiny(), tmp_path)
    StudyFolder.create(tmp_path, tiny(), "")
    with pytest.raises(StudyError, match="has another study: repeats was 2, is 3"):
        StudyFolder.create(tmp_path, tiny(repeats=3), "")
    many = {"repeats": 3, "seed": 1, "limit": 5.0, "seeds": "repeats", "chunk": 3}
    assert study_folder.describe_difference(tiny(), tiny(**many)).count(";") == 4
    told = study_folder.describe_difference(tiny(), tiny(**many, traces=True))
    assert told.endswith("; and 1 more")
    with pytest.raises(StudyError, match="experiment.duration was 0.1, is 0.2.*lag was 0.0, is no"):
        StudyFolder.create(tmp_path, tiny(experiment={"plant": "free", "duration": 0.2}), "")


def test_a_folder_of_which_no_run_was_kept_takes_another_study(tiny, tmp_path):
    """A scheduler did not answer, and the study was corrected since."""
    made = StudyFolder.create(tmp_path, tiny(), "one")
    with made.lock(), pytest.raises(StudyError, match="being written by another process"):
        StudyFolder.create(tmp_path, tiny(repeats=3), "two")
    assert StudyFolder.create(tmp_path, tiny(repeats=3), "two").study.repeats == 3
    assert (tmp_path / "study.yaml").read_text() == "two"
    (tmp_path / "study.yaml").unlink()  # by whoever wanted to begin anew
    assert StudyFolder.create(tmp_path, tiny(repeats=4), "three").study.repeats == 4


def test_a_study_file_that_was_edited_is_refused(tiny, tmp_path):
    study = tiny()
    made = StudyFolder.create(tmp_path, study, yaml.safe_dump(study.to_mapping()))
    made.check_file()
    (tmp_path / "study.yaml").write_text(yaml.safe_dump({**study.to_mapping(), "repeats": 9}))
    with pytest.raises(StudyError, match="repeats was 2, is 9"):
        StudyFolder.open(tmp_path).check_file()


def test_folders_that_are_none(tiny, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter").write_text("dear")
    for path, told in ((tmp_path / "full", "is not empty and does not contain a study"),
                       (Path("/dev/null/out"), "cannot write /dev/null/out")):  # fmt: skip
        with pytest.raises(StudyError, match=told):
            StudyFolder.create(path, tiny(), "")
    manifest = StudyFolder.create(tmp_path / "whole", tiny(), "").manifest
    for content, told in (
        (None, r"has no study \(manifest.json"), ("{}", "is not the manifest of a study"),
        (json.dumps({**manifest, "chunk": 4}), "was written with another chunk size"),
        (json.dumps({**manifest, "format": 4}), "in format 4, not 3"),
    ):  # fmt: skip
        if content:
            (tmp_path / "manifest.json").write_text(content)
        with pytest.raises(StudyError, match=told):
            StudyFolder.open(tmp_path)


def test_other_code_does_not_go_on_with_a_study(tiny, tmp_path, monkeypatch):
    """Neither here nor at a worker: its runs would not go together. As numpy, so a user's code."""
    monkeypatch.syspath_prepend(tmp_path)
    mine = tmp_path / "my_own_metrics.py"
    mine.write_text("from aras_visual_servo_bench.metrics.metric import metric\n"
                    "@metric('', 'smaller', 'me')\ndef one(finished):\n    return 1.0\n")
    made = StudyFolder.create(tmp_path / "out", tiny(metrics=["my_own_metrics:one"]), "")
    made.check_code()
    mine.write_text(mine.read_text().replace("1.0", "2.0"))
    manifest = made.manifest | {"versions": made.manifest["versions"] | {"numpy": "1.0"}}
    for text, name, told in (
        (json.dumps(made.manifest), "my_own_metrics", "my_own_metrics [0-9a-f]{16} here"),
        (json.dumps(manifest), "numpy", "numpy .* here and.* 1.0 there"),
    ):  # fmt: skip
        (made.path / "manifest.json").write_text(text)
        made = StudyFolder.open(made.path)
        with pytest.raises(StudyError, match=f"started with other code .*{told}"):
            made.check_code()
        known = tuple(made.manifest["versions"].items())
        task = work.StudyChunk(json.dumps(made.study.to_mapping()), 0, versions=known)
        for go_on in (lambda task=task: work.carry_out(task),
                      lambda made=made: engine.run_missing(made, InProcessPool, None)):
            with pytest.raises(StudyError, match=f"a worker has other versions: .*{name}"):
                go_on()


def test_a_module_without_a_file_is_unknown():
    found = versions.read_study_versions(
        {"metrics": ["nowhere.at_all:it", "sys:exit"], "scheme": "moments"})
    assert [name for name, told in found.items() if told == versions.UNKNOWN] == [
        "nowhere.at_all", "sys"]


@pytest.mark.parametrize("fault", [
    None, FileNotFoundError("git"), subprocess.TimeoutExpired("git", 20),
])  # fmt: skip
def test_the_commit_is_unknown_where_git_tells_none(monkeypatch, fault):
    def git(command, **keys):
        if fault:
            raise fault
        return subprocess.CompletedProcess(command, 1, "", "no repository")

    monkeypatch.setattr(subprocess, "run", git)
    assert versions.read_commit() == versions.UNKNOWN


DIGESTS = """
import sys
from pathlib import Path
code, share, sys.prefix = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
from aras_visual_servo_bench.studies import versions

def digest():
    versions.compute_source_digest.cache_clear()
    return versions.compute_source_digest()

assert Path(versions.__file__).is_relative_to(code)
seen = [digest()]
for name in ("world.urdf", "learned.npz", "poster.png", "plate.mtl", "law.py"):
    for place in (share, code):
        for content in ("as it was", "changed"):
            (place / name).write_text(content)
            seen.append(digest())
assert len(set(seen)) == 21, seen
(share / "README.md").write_text("words")
(share / "config" / "studies").mkdir(parents=True)
(share / "config" / "studies" / "mine.yaml").write_text("gain: 1")
assert digest() == seen[-1]
(code / "law.py").rename(code / "lore.py")
assert digest() not in seen
"""


@pytest.mark.parametrize("is_installed", [False, True])
def test_every_file_that_decides_a_run_is_in_the_digest_of_the_code(is_installed, tmp_path):
    """In a workspace, and where pip has installed code and data in two folders."""
    package = "aras_visual_servo_bench"
    share = tmp_path / "share" / package if is_installed else tmp_path / "src" / package
    code = tmp_path / "lib" / package if is_installed else share / "src" / package
    share.mkdir(parents=True)
    (share / "package.xml").write_text("<package/>")
    shutil.copytree(Path(versions.__file__).parents[1], code,
                    ignore=shutil.ignore_patterns("__pycache__"))  # fmt: skip
    subprocess.run(
        [sys.executable, "-c", DIGESTS, code, share, tmp_path], check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(code.parent), *sys.path])},
    )  # fmt: skip


def test_the_digest_is_the_same_where_catkins_stubs_come_first(tmp_path):
    """As in a sourced workspace: client and workers differed, and every study was refused."""
    stub = tmp_path / "aras_visual_servo_camera"
    stub.mkdir()
    place = importlib.util.find_spec(stub.name).submodule_search_locations[0]
    (stub / "__init__.py").write_text(f"__path__.append({place!r})\n")
    (stub / "generated.py").write_text("")
    command = (
        "from aras_visual_servo_bench.studies.versions import compute_source_digest\n"
        "print(compute_source_digest())"
    )
    told = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
    )  # fmt: skip
    assert told.stdout.strip() == versions.compute_source_digest()


def test_a_full_disk_keeps_what_was_done(tiny, tmp_path, monkeypatch):
    study = tiny()
    carried(study, tmp_path / "whole")
    made = StudyFolder.create(tmp_path / "full", study, "")
    real, left = os.replace, [2]  # parts and times of one chunk

    def full(old, new):
        if not left[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        left[0] -= 1
        real(old, new)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(StudyError, match="disk of .*full is full.*bench resume"):
        engine.run_missing(made, InProcessPool, None)
    monkeypatch.undo()
    assert not list((tmp_path / "full").glob("*/.*.new")) and made.find_missing_chunks() == [1, 2]
    engine.run_missing(StudyFolder.open(tmp_path / "full"), InProcessPool, None)
    assert hashes(tmp_path / "full") == hashes(tmp_path / "whole")


def test_what_goes_wrong_in_a_run_is_its_outcome_and_the_others_go_on(tiny, tmp_path):
    study = tiny(metrics=["success", f"{__name__}:failing"], chunk=6)
    table = carried(study, tmp_path).read_results()
    assert table["outcome"].to_pylist() == ["timed_out"] * 4 + [rows.FAULT] * 2
    assert table["reason"][5].as_py() == ("ZeroDivisionError: two lines " + "x" * 600)[:500]
    assert table["failing"].to_pylist()[:4] == [1.0] * 4
    starts = {"height": [0.15, 0.2], "side": 5.0, "attempts": 1}
    refused = tiny(experiment={"plant": "free", "start": starts})
    table = carried(refused, tmp_path / "refused").read_results()
    assert set(table["outcome"].to_pylist()) == {rows.REFUSED}
    assert set(table["images"].to_pylist()) == set(table["simulated"].to_pylist()) == {0}
    assert "no start found" in table["reason"][0].as_py()
    with pytest.raises(StudyError, match="^run 0: .*no start found"):
        replay.replay(StudyFolder.open(tmp_path / "refused"), 0)


def test_fail_fast_sends_nothing_more(tiny, tmp_path):
    study = tiny(chunk=4)  # the last part is a short one
    made = StudyFolder.create(tmp_path, study, "")
    done = engine.run_missing(made, InProcessPool, None, fail_fast=True)
    assert done.stopped["run"] == 0 and done.stopped["outcome"] == "timed_out"
    assert (done.runs, done.failed, made.find_missing_chunks()) == (4, 4, [1])
    assert "parts" not in made.manifest


def test_a_run_that_kills_its_process_is_found_named_and_recorded(tiny, tmp_path, monkeypatch):
    """At the end of a chunk: the run before it is done all the same."""
    monkeypatch.syspath_prepend(os.path.dirname(__file__))
    study = tiny(metrics=["success", "test_engine:killing"], chunk=2, repeats=1,
                 vary={"gain": [1.0, 2.0]})  # fmt: skip
    table = carried(study, tmp_path, Dying()).read_results()
    assert table["outcome"].to_pylist() == ["timed_out", rows.DIED]
    assert table["reason"][1].as_py() == "the process of the run was ended by SIGKILL"
    assert table["killing"].to_pylist()[0] == 1.0 and table["gain"][1].as_py() == 2.0


class Scripted:
    """Replacement of Popen: each process does some runs, and then ends."""

    def __init__(self, *given, **keys):
        self.count, self.end = self.script[len(self.begun)]
        self.stdin = io.BytesIO()
        self.stdin.close = lambda: self.begun.append(pickle.loads(self.stdin.getvalue())[1:])

    @property
    def stdout(self):
        start, stop = self.begun[-1]
        done = [rows.RunRows([{"run": n, "outcome": "x"}]) for n in range(start, stop)[:self.count]]
        return io.BytesIO(b"".join(map(pickle.dumps, done)))

    def kill(self):
        self.end = -signal.SIGKILL

    def wait(self):
        if self.end is None:  # it does not end before its time is over
            self.timer.end()
        return self.end


class Now:
    """Replacement of Timer whose time is over when a process waits for it."""

    def __init__(self, limit, end):
        Scripted.timer, self.limit, self.end = self, limit, end

    def start(self):
        pass

    cancel = start


KILLED, AGAIN = (f"the process of the run {how}" for how in (
    "was ended by SIGKILL", "ended with exit code 3"))  # fmt: skip


@pytest.mark.parametrize(("script", "begun", "lost"), [
    ([(1, -9), (4, 0)], [0, 1], {}),
    ([(1, -9), (0, 3), (3, 0)], [0, 1, 2], {1: (rows.DIED, AGAIN)}),
    ([(0, -9), (3, 3), (0, 3), (1, 0)], [0, 0, 3, 4], {3: (rows.DIED, AGAIN)}),
    ([(0, 3), (0, -9), (0, 3), (4, 0)], [0, 0, 1, 1], {0: (rows.DIED, KILLED)}),
    ([(2, None), (2, 0)], [0, 3], {2: (rows.LATE, "not finished after 9 s of wall time")}),
])  # fmt: skip
def test_a_run_is_lost_when_its_process_ends_twice_or_hangs_once(
    tiny, monkeypatch, script, begun, lost
):  # fmt: skip
    """script: how many runs each process did, and its exit code; begun: the first of each."""
    study = tiny(repeats=5, vary={}, chunk=5, limit=9.0)
    monkeypatch.setattr(subprocess, "Popen", type("", (Scripted,), {"script": script, "begun": []}))
    monkeypatch.setattr(threading, "Timer", Now)
    done = work.carry_out(work.StudyChunk(json.dumps(study.to_mapping()), 0, True))
    assert subprocess.Popen.begun == [(first, 5) for first in begun]
    assert Scripted.timer.limit == 69.0
    assert [row["run"] for row in done.values] == list(range(5))
    found = {row["run"]: (row["outcome"], row["reason"]) for row in done.values
             if row["outcome"] != "x"}  # fmt: skip
    assert found == lost and [row["run"] for row in done.times] == list(lost)


def test_a_thread_s_run_that_takes_too_long_ends_its_process():
    """As it does a worker of Dask; in children here, of which one would end otherwise after 9 s,
    and one is done in time."""
    def limited(may, takes):
        with rows.limit_time(may):
            threading.Event().wait(takes)

    before = signal.getsignal(signal.SIGALRM)
    limited(9.0, 0.0)  # nothing is left of it where signals come
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
    assert signal.getsignal(signal.SIGALRM) is before
    children = {}
    for may, takes, after, code in ((0.05, 9.0, 0.0, 1), (0.05, 0.0, 0.2, 0)):
        child = os.fork()
        if not child:
            thread = threading.Thread(target=limited, args=(may, takes))
            thread.start()
            thread.join()
            threading.Event().wait(after)
            os._exit(0)
        children[child] = code
    for child, code in children.items():
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == code


def test_traces_are_beside_the_results(tiny, tmp_path):
    made = carried(tiny(traces=True), tmp_path)
    traces = made.read_results(study_folder.TRACES)
    first = traces.filter([run == 0 for run in traces["run"].to_pylist()])
    assert first.num_rows == made.read_results()["images"][0].as_py()
    assert len(first["pose"][0].as_py()) == 16 and len(first["desired_twist"][0].as_py()) == 6
    size = [sum(e * e for e in errors) for errors in first["error"].to_pylist()]
    assert size[2] < size[0]
    manifest = (tmp_path / "manifest.json").read_text()
    assert json.loads(manifest)["parts"] == hashes(tmp_path, ("parts", "traces"))
    assert manifest.startswith('{\n "')  # to be read, and compared line by line


def walls(worker, *seconds):
    return [{"worker": worker, "wall": wall} for wall in seconds]


def test_the_line_of_progress():
    now = [0.0]
    out = io.StringIO()
    progress = StudyProgress(100, 20, out, clock=lambda: now[0])
    now[0] = 10.0
    progress.add_runs(20, 3, walls("a", *[1.0] * 20), 2)
    assert "40/100 runs, 2/s, 3 without success, 30 s left" in out.getvalue()
    for at, lines in ((10.0, 1), (20.0, 2)):  # nobody wants a line a chunk in a log
        now[0] = at
        progress.add_runs(1, 0)
        assert out.getvalue().count("\n") == lines
    now[0] = 21.0
    progress.add_runs(58, 0)
    assert "100/100" in out.getvalue() and "0 s left" in out.getvalue()
    # nothing to do; no times; sooner than any clock shows
    for total, done, more in ((0, 0, ()), (2, 1, ([],)), (9, 0, (walls("a", 0.0, 0.0),))):
        progress = StudyProgress(total, done, io.StringIO(), clock=lambda: 0.0)
        for times in more:
            progress.add_runs(max(len(times), 1), 0, times)
        shown = max(done + 1, 2) if total else 0
        told = f" {shown}/{total} runs, 0 without success, 0 s left"
        assert progress.make_line().endswith(told)


def test_on_a_terminal_a_line_is_drawn_over_itself_until_it_is_gone():
    """Not more often than it is seen; not at all in a file, and in a notebook, too."""
    now, shown = [0.0], {}
    for kind in ("terminal", "notebook", "file"):
        out = io.StringIO() if kind != "notebook" else type(
            "OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})()
        if kind == "terminal":
            out.isatty = lambda: True
        bar = ProgressBar(out, clock=lambda: now[0])
        bar.show(0.25, "the first " + "x" * 40)
        bar.show(1.0, "the second")
        bar.close()
        shown[kind] = out.getvalue()
        progress = StudyProgress(4, 0, out, clock=lambda: 0.0)
        out.truncate(0)
        for _ in range(3):
            progress.add_runs(1, 0)
        progress.close()
        assert out.getvalue().count("\r") == 3 * (kind != "file")
        assert out.getvalue().count("\n") == 1 and out.getvalue().endswith("\n")
        out.truncate(0)
        for step in range(1001):
            now[0] = 1e-3 * step
            bar.show(step / 1000, "one")
        assert (10 <= out.getvalue().count("\r") <= 13) == (kind != "file")
    quarter = f"\r[{'#' * 6}{'.' * 18}]  25 % e first {'x' * 40}\x1b[K"
    whole = f"\r[{'#' * 24}] 100 % the second\x1b[K\r\x1b[K"
    assert shown == {"terminal": quarter + whole, "notebook": quarter + whole, "file": ""}


def test_times_are_told_in_a_unit_that_fits():
    told = {0.0: "0 s", 89.4: "89 s", 90.0: "2 min", 5399.0: "90 min", 5400.0: "1.5 h",
            172799.0: "48.0 h", 172800.0: "2.0 days", 1e6: "11.6 days",
            float("inf"): "unknown time"}  # fmt: skip
    assert {seconds: format_duration(seconds) for seconds in told} == told


def test_the_first_line_does_not_take_compiling_for_the_rate():
    """A run that compiles loops takes 40 s, every other 1 s: of 160 runs 40 minutes were told."""
    now = [40.0]
    progress = StudyProgress(160, 0, io.StringIO(), clock=lambda: now[0])
    progress.add_runs(1, 0, walls("a", 40.0), 2)
    assert "1/160 runs, 0 without success, unknown time left" in progress.make_line()
    now[0] = 41.0
    progress.add_runs(3, 0, walls("b", 41.0, 1.0, 1.0), 2)
    assert "2/s, 0 without success, 78 s left" in progress.make_line()
    now[0] = 45.0
    progress.add_runs(8, 0, walls("a", *[1.0] * 8), 2)
    assert "74 s left" in progress.make_line()
    now[0] = 85.0  # the workers wait for chunks: the clock knows better than the runs
    progress.add_runs(2, 0, walls("a", 1.0, 1.0), 2)
    assert "8 min left" in progress.make_line()
