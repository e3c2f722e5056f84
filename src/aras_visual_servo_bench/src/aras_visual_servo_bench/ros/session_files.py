"""Files that the live page creates: taught goals, recorded bags and their reports."""

from __future__ import annotations

import re
import subprocess
import time
from pathlib import Path

from ..errors import RefusedRequestError, catch_write_errors
from .ros_launch import RosLaunch

# Longest times, s of wall time: for the tool teach, for the tool analyze, and for the recorder to
# create its bag.
TEACH_TIMEOUT, REPORT_TIMEOUT, CLOSE_TIMEOUT = 90.0, 180.0, 15.0
IMAGE_TIMEOUT = 20.0  # longest time for which the tool teach waits for images, s of wall time
REPORT_FOLDER = "report"
ACTIVE_SUFFIX = ".active"  # suffix of a bag that rosbag is writing, or has not closed
LOG_PREFIX = re.compile(r"^\[ ?\w+\] \[[\d., ]+\]: ")  # level and time at the start of a log line
# Log line in which the program report_recorder_end names an error of the recorder.
RECORDER_ERROR = re.compile(r"^\[ERROR\] (the recorder .*)$", re.MULTILINE)


class SessionFiles:
    """Runs the tools teach, record and analyze, and manages the files that they write.

    Attributes:
        directory: folder of all files.
        open_bag: bag that is being recorded; None if there is none.
        last_bag: bag that was recorded last; None if no bag was recorded. The bag is not closed if
            the recorder was killed.
        report_page: path of the last report's page, relative to the folder of reports; '' if there
            is no report.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.open_bag: Path | None = None
        self.last_bag: Path | None = None
        self.report_page = ""
        self._recorder: RosLaunch | None = None

    def teach_goal(self, name: str, scheme: str) -> str:
        """Store the current view of the camera as the goal `name` of a scheme."""
        path = self._make_folder("goals") / f"{name}.yaml"
        tool = ["rosrun", "aras_visual_servo_controller", "teach"]
        self._run([*tool, str(path), "--scheme", scheme,
                   "--timeout", str(IMAGE_TIMEOUT)], TEACH_TIMEOUT)
        return f"stored the current view as goal {name}: {path}"

    def start_recording(self) -> str:
        """Start record.launch, which records a bag; `stop_recording` ends the recording."""
        if self.open_bag is not None and self._recorder.running:
            raise RefusedRequestError(f"already recording to {self.open_bag}")
        bag = self._make_folder("bags") / time.strftime("run_%Y-%m-%d_%H-%M-%S.bag")
        self._recorder = RosLaunch(
            ["aras_visual_servo_gazebo", "record.launch", f"bag:={bag}"],
            self._make_folder("log") / "record.txt",
        )  # fmt: skip
        active = bag.with_name(bag.name + ACTIVE_SUFFIX)
        end = time.monotonic() + CLOSE_TIMEOUT
        while not (active.exists() or bag.exists()):
            ended = RECORDER_ERROR.search(self._recorder.read_log())
            if ended or self._recorder.find_death_message() or time.monotonic() > end:
                why = ended[1] if ended else self._recorder.read_last_lines(1).strip()
                self._recorder.stop()
                raise RefusedRequestError(f"the recorder did not start: {why}")
            time.sleep(0.1)
        self.open_bag = bag
        return f"recording to {bag}"

    def stop_recording(self) -> str:
        """Stop the recorder, which then closes the bag."""
        if self.open_bag is None:
            raise RefusedRequestError("nothing is being recorded")
        error = self.find_recording_error()
        self._recorder.stop()
        bag, self.open_bag = self.open_bag, None
        if not bag.exists():
            # The recorder was killed, so its bag is unclosed; analyze can still read this bag.
            bag = bag.with_name(bag.name + ACTIVE_SUFFIX)
        if not bag.exists():
            raise RefusedRequestError(
                f"the recorder has written no bag: {self._recorder.read_last_lines(1).strip()}"
            )
        self.last_bag = bag
        text = f"recorded {bag} ({bag.stat().st_size / 1e6:.1f} MB)"
        if error:
            raise RefusedRequestError(
                f"{error}; the bag contains the data before this error: {text}"
            )
        return text

    def find_recording_error(self) -> str:
        """Return why the recorder has stopped, such as a full disk; '' if it has not."""
        if self.open_bag is None:
            return ""
        ended = RECORDER_ERROR.search(self._recorder.read_log())
        if ended:
            return ended[1]
        is_disabled = "Disabling recording" in self._recorder.read_log()
        if not (is_disabled or self._recorder.find_death_message()):
            return ""
        last_line = self._recorder.read_last_lines(1).strip()
        return f"the recorder has stopped: {LOG_PREFIX.sub('', last_line)}"

    def make_report(self) -> str:
        """Create the report of the last bag with the tool analyze."""
        if self.open_bag is not None:
            raise RefusedRequestError("a bag is being recorded: stop the recording first")
        if self.last_bag is None:
            raise RefusedRequestError("nothing has been recorded yet")
        out = self._make_folder(REPORT_FOLDER) / self.last_bag.stem
        self._run(["rosrun", "aras_visual_servo_bench", "analyze", str(self.last_bag), "--out",
                   # without formats, analyze writes only the page, no separate figures
                   str(out), "--formats", ""], REPORT_TIMEOUT)
        pages = sorted(out.rglob("*.html"))
        if not pages:
            raise RefusedRequestError(f"analyze has written no page into {out}")
        self.report_page = str(pages[0].relative_to(self.directory / REPORT_FOLDER))
        return f"wrote the report into {out}"

    def find_file(self, name: str) -> Path | None:
        """Return the path of a file in the folder of reports.

        Return None if the file does not exist, or if its path is outside this folder.
        """
        root = (self.directory / REPORT_FOLDER).resolve()
        try:
            path = (root / name).resolve()
            return path if path.is_relative_to(root) and path.is_file() else None
        except (OSError, ValueError):  # invalid name: too long, or with a NUL character
            return None

    def close(self) -> None:
        """Stop the recorder, if it is running."""
        if self._recorder is not None:
            self._recorder.stop()

    def _make_folder(self, name: str) -> Path:
        path = self.directory / name
        with catch_write_errors(f"to {path}", RefusedRequestError):
            path.mkdir(parents=True, exist_ok=True)
        return path

    @staticmethod
    def _run(command: list[str], seconds: float) -> None:
        """Run a tool and wait until it ends.

        Raises:
            RefusedRequestError: the tool fails, or takes longer than `seconds`. If it fails, the
                message is the last line of its output.
        """
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=seconds,
                                  check=False, stdin=subprocess.DEVNULL)  # fmt: skip
        except subprocess.TimeoutExpired:
            raise RefusedRequestError(
                f"{command[2]} did not finish within {seconds:.0f} s"
            ) from None
        if done.returncode:
            lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
            raise RefusedRequestError(lines[-1].strip() if lines else f"{command[2]} failed")
