"""What the live page keeps of a run, when its recorder ends by itself."""

import pytest

from aras_visual_servo_bench.live.requests import RefusedError
from aras_visual_servo_bench.ros import keeping
from aras_visual_servo_bench.ros.processes import Launch

FULL = ("[ERROR] [1795337166.759, 0.012]: Less than 256M of space free on disk with {bag}.active. "
        "Disabling recording.\n")  # fmt: skip
TORN = "[ERROR] [1795338141.830, 27.134]: Error writing to file: writing 4 bytes, wrote 1 bytes\n"
DIED = "[record-2] process has died [pid 1, exit code -6, cmd /usr/lib/rosbag/record]\n"


class Recorder(Launch):
    """Writes what record.launch would, without one."""

    running = True

    def __init__(self, arguments, log, environment):
        self.log = log
        self.bag = log.parents[1] / "bags" / arguments[-1].rpartition("/")[2]
        log.write_text("recording\n")
        self.bag.with_name(self.bag.name + ".active").write_bytes(b"#ROSBAG V2.0\n")

    def stop(self, patience=0.0):
        active = self.bag.with_name(self.bag.name + ".active")
        if "exit code -6" not in self.text():
            active.rename(self.bag)


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setattr(keeping, "Launch", Recorder)
    found = keeping.Keeping(tmp_path)
    found.record()
    return found


def test_a_recorder_that_writes_is_no_trouble(kept):
    assert kept.trouble() == ""
    assert kept.stop_record().startswith(f"recorded {kept.recorded}")
    assert kept.recorded.suffix == ".bag" and kept.trouble() == ""


def test_a_disk_without_room_is_said_while_recording_and_at_its_end(kept):
    with kept._recorder.log.open("a") as log:
        log.write(FULL.format(bag=kept.recording))
    assert kept.trouble().startswith("the recorder has stopped: Less than 256M of space free on")
    with pytest.raises(RefusedError, match="Less than 256M .*; what it had until then is kept: "):
        kept.stop_record()
    assert kept.recorded.suffix == ".bag" and kept.recorded.is_file()


def test_of_a_recorder_that_died_the_unclosed_bag_is_kept_for_the_report(kept):
    with kept._recorder.log.open("a") as log:
        log.write(TORN + DIED)
    with pytest.raises(RefusedError, match="Error writing to file.* is kept: recorded .*active"):
        kept.stop_record()
    assert kept.recorded.name.endswith(".bag.active") and kept.recording is None


@pytest.mark.parametrize("name", ["x\0", "a" * 5000, "../bags", "missing.html", ""])
def test_no_other_file_than_a_report_s_is_given(kept, name):
    assert kept.file(name) is None


def test_a_report_s_file_is_given(kept):
    page = kept.directory / keeping.REPORT / "one" / "report.html"
    page.parent.mkdir(parents=True)
    page.write_text("")
    assert kept.file("one/report.html") == page.resolve()
