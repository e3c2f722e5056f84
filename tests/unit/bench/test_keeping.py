"""Files of the live page, if the recorder ends unexpectedly."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from aras_visual_servo_bench.errors import RefusedError
from aras_visual_servo_bench.ros import session_files
from aras_visual_servo_bench.ros.ros_launch import RosLaunch

FULL = ("[ERROR] [1795337166.759, 0.012]: Less than 256M of space free on disk with {bag}.active. "
        "Disabling recording.\n")  # fmt: skip
TORN = "[ERROR] [1795338141.830, 27.134]: Error writing to file: writing 4 bytes, wrote 1 bytes\n"
DIED = "[record-2] process has died [pid 1, exit code -6, cmd /usr/lib/rosbag/record]\n"


ENDED = ("[ERROR] the recorder (record) has ended: the disk of {folder} is full: make room, or "
         "record elsewhere. What it has recorded until then is in the bag\n"
         "[record-2] process has finished cleanly\n")  # fmt: skip


class Recorder(RosLaunch):
    """Writes what record.launch would, without one."""

    running = True

    def __init__(self, arguments, log, environment):
        self.log = log
        self.bag = log.parents[1] / "bags" / arguments[-1].rpartition("/")[2]
        log.write_text("recording\n")
        self.bag.with_name(self.bag.name + ".active").write_bytes(b"#ROSBAG V2.0\n")

    def stop(self, patience=0.0):
        active = self.bag.with_name(self.bag.name + ".active")
        if "exit code -6" not in self.read_log():
            active.rename(self.bag)


@pytest.fixture
def kept(tmp_path, monkeypatch):
    begun = []
    monkeypatch.setattr(
        session_files, "RosLaunch", lambda *how: begun.append(Recorder(*how)) or begun[0]
    )
    found = session_files.SessionFiles(tmp_path)
    found.start_recording()
    found.by = begun[0]
    return found


def test_nothing_is_recorded_where_no_simulator_answers(tmp_path):
    """The recorder waited for a time, and the page had no answer."""

    def check():
        raise RefusedError("/gazebo/get_world_properties does not answer")

    page = session_files.SessionFiles(tmp_path)
    page.check_recording = check
    with pytest.raises(RefusedError, match="does not answer"):
        page.start_recording()
    assert not list(tmp_path.iterdir())


def test_a_recorder_that_writes_is_no_trouble(kept):
    assert kept.find_recording_error() == ""
    assert kept.stop_recording().startswith(f"recorded {kept.last_bag}")
    assert kept.last_bag.suffix == ".bag" and kept.find_recording_error() == ""


def test_a_disk_without_room_is_said_while_recording_and_at_its_end(kept):
    with kept.by.log.open("a") as log:
        log.write(FULL.format(bag=kept.open_bag))
    assert kept.find_recording_error().startswith(
        "the recorder has stopped: Less than 256M of space free on"
    )
    with pytest.raises(RefusedError, match="Less than 256M .*; the bag contains the data bef"):
        kept.stop_recording()
    assert kept.last_bag.suffix == ".bag" and kept.last_bag.is_file()


def test_a_recorder_that_ended_in_order_says_why(kept):
    with kept.by.log.open("a") as log:
        log.write(ENDED.format(folder=kept.open_bag.parent))
    assert kept.find_recording_error().startswith("the recorder (record) has ended: the disk of ")
    with pytest.raises(RefusedError, match="is full: .*; the bag contains .*: recorded"):
        kept.stop_recording()


def test_a_recorder_that_does_not_start_is_reported_at_once(tmp_path, monkeypatch):
    class Full(Recorder):
        def __init__(self, arguments, log, environment):
            super().__init__(arguments, log, environment)
            self.bag.with_name(self.bag.name + ".active").unlink()
            log.write_text("[ERROR] the recorder (record) does not start: the disk is full\n"
                           "[record-2] process has finished cleanly\n")

        def stop(self, patience=0.0):
            pass

    monkeypatch.setattr(session_files, "RosLaunch", Full)
    monkeypatch.setattr(session_files.time, "sleep", lambda _: pytest.fail("it waits"))
    with pytest.raises(RefusedError, match="did not start: the recorder .* the disk is full$"):
        session_files.SessionFiles(tmp_path).start_recording()


def test_of_a_recorder_that_died_the_unclosed_bag_is_kept_for_the_report(kept):
    with kept.by.log.open("a") as log:
        log.write(TORN + DIED)
    with pytest.raises(RefusedError, match="Error writing to file.* error: recorded .*active"):
        kept.stop_recording()
    assert kept.last_bag.name.endswith(".bag.active") and kept.open_bag is None


def test_what_is_not_recorded_is_neither_closed_nor_reported(kept):
    with pytest.raises(RefusedError, match=f"^already recording to {kept.open_bag}$"):
        kept.start_recording()
    with pytest.raises(RefusedError, match="a bag is being recorded: stop the recording first"):
        kept.make_report()
    kept.by.bag.with_name(kept.by.bag.name + ".active").rename(kept.directory / "x")
    kept.by.stop = lambda patience=0.0: None
    with pytest.raises(RefusedError, match="^the recorder has written no bag: recording$"):
        kept.stop_recording()
    with pytest.raises(RefusedError, match="^nothing is being recorded$"):
        kept.stop_recording()
    with pytest.raises(RefusedError, match="^nothing has been recorded yet$"):
        kept.make_report()


def test_tools_are_run_to_their_end(kept, monkeypatch):
    asked, status, pages = [], [0], ["b.html", "a.html"]

    def run(command, timeout, **more):
        asked.append((command, timeout))
        assert more == {"capture_output": True, "text": True, "check": False,
                        "stdin": session_files.subprocess.DEVNULL}
        if status[0] == "late":
            raise session_files.subprocess.TimeoutExpired(command, timeout)
        for page in pages if "analyze" in command else ():
            out = Path(command[command.index("--out") + 1])
            out.mkdir(parents=True, exist_ok=True)
            (out / page).touch()
        return SimpleNamespace(returncode=status[0], stdout="one\n", stderr=status[-1])

    monkeypatch.setattr(session_files.subprocess, "run", run)
    goal = kept.directory / "goals" / "mine.yaml"
    assert kept.teach_goal("mine", "points") == f"stored the current view as goal mine: {goal}"
    assert goal.parent.is_dir() and asked.pop() == (
        ["rosrun", "aras_visual_servo_controller", "teach", str(goal), "--scheme", "points",
         "--timeout", "20.0"], 90.0)
    kept.stop_recording()
    out = kept.directory / "report" / kept.last_bag.stem
    assert kept.make_report() == f"wrote the report into {out}" and asked.pop() == (
        ["rosrun", "aras_visual_servo_bench", "analyze", str(kept.last_bag), "--out", str(out),
         "--formats", ""], 180.0)
    assert kept.report_page == f"{kept.last_bag.stem}/a.html"
    for ends, why in (([1, " two \n\n"], "^two$"), ([1, ""], "^one$"),
                      (["late", ""], "^teach did not finish within 90 s$")):
        status[:] = ends
        with pytest.raises(RefusedError, match=why):
            kept.teach_goal("mine", "points")
    status[:], pages[:] = [0, ""], []
    for page in out.iterdir():
        page.unlink()
    with pytest.raises(RefusedError, match=f"^analyze has written no page into {out}$"):
        kept.make_report()


def test_a_recorder_that_does_not_begin_is_ended(tmp_path, monkeypatch):
    now, made = [100.0], []

    class Silent(Recorder):
        def __init__(self, arguments, log, environment):
            self.log, self.arguments, self.ended = log, arguments, 0
            log.write_text("no such disk\n")
            made.append(self)

        def stop(self, patience=0.0):
            self.ended += 1

    monkeypatch.setattr(session_files, "RosLaunch", Silent)
    monkeypatch.setattr(session_files, "time", SimpleNamespace(
        strftime=lambda form: form, monotonic=lambda: now[0],
        sleep=lambda seconds: now.__setitem__(0, now[0] + seconds)))
    found = session_files.SessionFiles(tmp_path)
    with pytest.raises(RefusedError, match="^the recorder did not start: no such disk$"):
        found.start_recording()
    assert made[0].ended == 1 and now[0] == pytest.approx(115.0, abs=0.2)
    bag = tmp_path / "bags" / "run_%Y-%m-%d_%H-%M-%S.bag"
    assert made[0].arguments == ["aras_visual_servo_gazebo", "record.launch", f"bag:={bag}"]
    assert found.open_bag is None and made[0].log == tmp_path / "log" / "record.txt"
    found.close()
    assert made[0].ended == 2


@pytest.mark.parametrize("name", ["x\0", "a" * 5000, "../bags", "missing.html", ""])
def test_no_other_file_than_a_report_s_is_given(kept, name):
    assert kept.find_file(name) is None


def test_a_report_s_file_is_given(kept):
    page = kept.directory / session_files.REPORT_FOLDER / "one" / "report.html"
    page.parent.mkdir(parents=True)
    page.write_text("")
    assert kept.find_file("one/report.html") == page.resolve()
