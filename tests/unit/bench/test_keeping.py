"""Files of the live page: recordings that end unexpectedly, goals, and reports."""

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
if [ -n "$RECORDER" ]; then echo "$RECORDER"
else echo recording; echo '#ROSBAG V2.0' > "$bag.active"; fi
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
DIED = ("[ERROR] [1795338141.830, 27.134]: Error writing to file: writing 4 bytes, wrote 1 bytes\n"
        "[record-2] process has died [pid 1, exit code -6, cmd /usr/lib/rosbag/record]\n")
ENDED = ("[ERROR] the recorder (record) has ended: the disk of {bag} is full: make room, or "
         "record elsewhere\n[record-2] process has finished cleanly\n")  # fmt: skip


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Files of a page. Programs instead of those of ROS note in `state` what they did."""
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
    files.start_recording()
    return files


@pytest.mark.parametrize(("text", "error", "told", "suffix"), [
    (FULL, "the recorder has stopped: ", "Less than 256M.*; the bag contains the data be", ".bag"),
    (ENDED, "the recorder (record) has ended", "is full: .*; the bag contains the data be", ".bag"),
    (DIED, "", "Error writing to file", ".active"),
])  # fmt: skip
def test_what_stops_a_recorder_is_said_and_its_bag_kept(kept, tmp_path, text, error, told, suffix):
    if text == DIED:
        (tmp_path / "state" / "dead").touch()
    with (kept.directory / "log" / "record.txt").open("a") as log:
        log.write(text.format(bag=kept.open_bag))
    assert kept.find_recording_error().startswith(error)
    with pytest.raises(RefusedRequestError, match=f"{told}.*recorded "):
        kept.stop_recording()
    assert kept.last_bag.suffix == suffix and kept.open_bag is None
    assert kept.last_bag.is_file()


def test_only_what_is_recorded_is_closed_and_reported(kept, tmp_path):
    def refuse(act, why):
        with pytest.raises(RefusedRequestError, match=why):
            act()

    refuse(kept.start_recording, f"^already recording to {kept.open_bag}$")
    refuse(kept.make_report, "a bag is being recorded: stop the recording first")
    Path(f"{kept.open_bag}.active").unlink()
    refuse(kept.stop_recording, "^the recorder has written no bag: recording$")
    refuse(kept.stop_recording, "^nothing is being recorded$")
    refuse(kept.make_report, "^nothing has been recorded yet$")
    kept.start_recording()
    assert kept.find_recording_error() == ""
    assert kept.stop_recording().startswith(f"recorded {kept.last_bag}")
    assert kept.last_bag.suffix == ".bag" and kept.find_recording_error() == ""
    ran = "aras_visual_servo_gazebo record.launch\nstopped\n"
    assert (tmp_path / "state" / "launched").read_text() == ran


@pytest.mark.parametrize(("said", "told", "lasts"), [
    ("no such disk", "no such disk", 15.0),
    ("[ERROR] the recorder (record) does not start: the disk is full",
     "the recorder .* the disk is full", 0.0),  # one that says why is not waited for
])  # fmt: skip
def test_a_recorder_that_does_not_begin_is_ended(files, tmp_path, monkeypatch, said, told, lasts):
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
    goal, ran = kept.directory / "goals" / "mine.yaml", tmp_path / "state" / "run"
    assert kept.teach_goal("mine", "points") == f"stored the current view as goal mine: {goal}"
    kept.stop_recording()
    out = kept.directory / "report" / kept.last_bag.stem
    assert kept.make_report() == f"wrote the report into {out}"
    assert kept.report_page == f"{kept.last_bag.stem}/a.html"
    assert goal.parent.is_dir() and ran.read_text() == (
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
