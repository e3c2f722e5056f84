"""Files of the live page: recordings that end unexpectedly, goals, and reports.

Programs named roslaunch and rosrun, first on the PATH, do what those of ROS do on a graph.
"""

import os
import subprocess
import time
from pathlib import Path

import pytest

from aras_visual_servo_bench.errors import RefusedRequestError
from aras_visual_servo_bench.ros.session_files import REPORT_FOLDER, SessionFiles

ROSLAUNCH = """#!/bin/sh
bag=${3#bag:=}
echo "$1 $2" > "$STATE/launched"
stop() { echo stopped >> "$STATE/launched"; [ ! -e "$bag.active" ] || [ -e "$STATE/dead" ] || \
mv "$bag.active" "$bag"; exit; }
trap stop INT
case "$RECORDER" in
    "") echo recording; echo '#ROSBAG V2.0' > "$bag.active";;
    *) echo "$RECORDER";;
esac
while :; do sleep 0.02; done
"""
ROSRUN = """#!/bin/sh
echo "$*" >> "$STATE/run"
[ "$2" != analyze ] || [ -n "$NO_PAGE" ] || { mkdir -p "$5"; touch "$5/b.html" "$5/a.html"; }
printf one
printf "$SAID" >&2
exit ${STATUS:-0}
"""
FULL = ("[ERROR] [1795337166.759, 0.012]: Less than 256M of space free on disk with {bag}.active. "
        "Disabling recording.\n")  # fmt: skip
TORN = "[ERROR] [1795338141.830, 27.134]: Error writing to file: writing 4 bytes, wrote 1 bytes\n"
DIED = "[record-2] process has died [pid 1, exit code -6, cmd /usr/lib/rosbag/record]\n"
ENDED = ("[ERROR] the recorder (record) has ended: the disk of {bag} is full: make room, or "
         "record elsewhere. What it has recorded until then is in the bag\n"
         "[record-2] process has finished cleanly\n")  # fmt: skip


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Files of a page in a folder, with the programs; what they did is in the folder `state`."""
    state = tmp_path / "state"
    state.mkdir()
    for name, text in (("roslaunch", ROSLAUNCH), ("rosrun", ROSRUN)):
        (state / name).write_text(text)
        (state / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{state}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("STATE", str(state))
    found = SessionFiles(tmp_path / "page")
    yield found
    found.close()


@pytest.fixture
def kept(files):
    """The same while a bag is recorded."""
    files.start_recording()
    return files


def say(files, text):
    with (files.directory / "log" / "record.txt").open("a") as log:
        log.write(text.format(bag=files.open_bag))


def test_a_recorder_that_writes_is_no_trouble(kept, tmp_path):
    assert kept.find_recording_error() == ""
    assert kept.stop_recording().startswith(f"recorded {kept.last_bag}")
    assert kept.last_bag.suffix == ".bag" and kept.find_recording_error() == ""
    assert (tmp_path / "state" / "launched").read_text() == (
        "aras_visual_servo_gazebo record.launch\nstopped\n")


@pytest.mark.parametrize(("text", "error", "told"), [
    (FULL, "the recorder has stopped: Less than 256M of space free on", "Less than 256M"),
    (ENDED, "the recorder (record) has ended: the disk of ", "is full: "),
])  # fmt: skip
def test_what_stops_a_recorder_is_said_while_recording_and_at_its_end(kept, text, error, told):
    say(kept, text)
    assert kept.find_recording_error().startswith(error)
    with pytest.raises(
        RefusedRequestError, match=f"{told}.*; the bag contains the data bef.*: recorded"
    ):
        kept.stop_recording()
    assert kept.last_bag.suffix == ".bag" and kept.last_bag.is_file()


def test_of_a_recorder_that_died_the_unclosed_bag_is_kept_for_the_report(kept, tmp_path):
    (tmp_path / "state" / "dead").touch()
    say(kept, TORN + DIED)
    with pytest.raises(
        RefusedRequestError, match="Error writing to file.* error: recorded .*active"
    ):
        kept.stop_recording()
    assert kept.last_bag.name.endswith(".bag.active") and kept.open_bag is None


def test_what_is_not_recorded_is_neither_closed_nor_reported(kept):
    with pytest.raises(RefusedRequestError, match=f"^already recording to {kept.open_bag}$"):
        kept.start_recording()
    with pytest.raises(
        RefusedRequestError, match="a bag is being recorded: stop the recording first"
    ):
        kept.make_report()
    Path(f"{kept.open_bag}.active").unlink()
    with pytest.raises(RefusedRequestError, match="^the recorder has written no bag: recording$"):
        kept.stop_recording()
    with pytest.raises(RefusedRequestError, match="^nothing is being recorded$"):
        kept.stop_recording()
    with pytest.raises(RefusedRequestError, match="^nothing has been recorded yet$"):
        kept.make_report()


@pytest.mark.parametrize(("said", "told", "lasts"), [
    ("no such disk", "no such disk", 15.0),
    ("[ERROR] the recorder (record) does not start: the disk is full",
     "the recorder .* the disk is full", 0.0),
])  # fmt: skip
def test_a_recorder_that_does_not_begin_is_ended(files, tmp_path, monkeypatch, said, told, lasts):
    """One that says why is not waited for."""
    now, sleep = [100.0], time.sleep

    def wait(seconds):
        now[0] += seconds if lasts else 0.0
        sleep(0.005)

    monkeypatch.setenv("RECORDER", said)
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "sleep", wait)
    with pytest.raises(RefusedRequestError, match=f"^the recorder did not start: {told}$"):
        files.start_recording()
    assert now[0] == pytest.approx(100.0 + lasts, abs=0.3) and files.open_bag is None
    assert (tmp_path / "state" / "launched").read_text().endswith("stopped\n")


def test_tools_are_run_to_their_end(kept, tmp_path, monkeypatch):
    goal = kept.directory / "goals" / "mine.yaml"
    assert kept.teach_goal("mine", "points") == f"stored the current view as goal mine: {goal}"
    kept.stop_recording()
    out = kept.directory / "report" / kept.last_bag.stem
    assert kept.make_report() == f"wrote the report into {out}"
    assert kept.report_page == f"{kept.last_bag.stem}/a.html"
    assert goal.parent.is_dir() and (tmp_path / "state" / "run").read_text() == (
        f"aras_visual_servo_controller teach {goal} --scheme points --timeout 20.0\n"
        f"aras_visual_servo_bench analyze {kept.last_bag} --out {out} --formats \n")
    monkeypatch.setenv("STATUS", "1")
    for said, why in (("\\n two \\n\\n", "^two$"), ("", "^one$")):
        monkeypatch.setenv("SAID", said)
        with pytest.raises(RefusedRequestError, match=why):
            kept.teach_goal("mine", "points")
    monkeypatch.setenv("STATUS", "0")
    monkeypatch.setenv("NO_PAGE", "1")
    for page in out.iterdir():
        page.unlink()
    with pytest.raises(RefusedRequestError, match=f"^analyze has written no page into {out}$"):
        kept.make_report()

    def late(command, timeout, **keys):
        raise subprocess.TimeoutExpired(command, timeout)

    monkeypatch.setattr(subprocess, "run", late)
    with pytest.raises(RefusedRequestError, match="^teach did not finish within 90 s$"):
        kept.teach_goal("mine", "points")


def test_only_files_of_reports_are_given(files):
    page = files.directory / REPORT_FOLDER / "one" / "report.html"
    page.parent.mkdir(parents=True)
    page.write_text("")
    assert files.find_file("one/report.html") == page.resolve()
    (files.directory / "bags").mkdir()
    (files.directory / "bags" / "a.bag").touch()
    for name in ("x\0", "a" * 5000, "../bags/a.bag", "missing.html", ""):
        assert files.find_file(name) is None, name
