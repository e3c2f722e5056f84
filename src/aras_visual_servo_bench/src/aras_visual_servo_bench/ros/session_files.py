"""What is kept of a run: a goal taught, a bag recorded, a report of it."""

from __future__ import annotations

import os
import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from ..errors import RefusedError, catch_write_errors
from .ros_launch import RosLaunch

TEACH_TIMEOUT, REPORT_TIMEOUT, CLOSE_TIMEOUT = 90.0, 180.0, 15.0  # s of wall time
IMAGE_TIMEOUT = 20.0  # s that teaching waits for images
REPORT_FOLDER = "report"
ACTIVE_SUFFIX = ".active"  # behind the name of a bag that is not closed
LOG_PREFIX = re.compile(r"^\[ ?\w+\] \[[\d., ]+\]: ")  # what a log line begins with
# report_recorder_end's line
RECORDER_ERROR = re.compile(r"^\[ERROR\] (the recorder .*)$", re.MULTILINE)


class SessionFiles:
    """Runs the tools for it, and knows where they put their files.

    Attributes:
        recording: bag that is being written, None while none is.
        recorded: the last one that was; unclosed where its recorder was killed.
        check: raises RefusedError where nothing could be recorded; called before it is begun.
        report: path of the last report's page within the reports, '' while there is none.
    """

    def __init__(self, directory: Path) -> None:
        self.check_recording: Callable[[], None] = lambda: None
        self.directory = directory
        self.open_bag: Path | None = None
        self.last_bag: Path | None = None
        self.report_page = ""
        self._recorder: RosLaunch | None = None

    def teach_goal(self, name: str, scheme: str) -> str:
        """The view that the camera has now, as a goal of that name."""
        path = self._make_folder("goals") / f"{name}.yaml"
        tool = ["rosrun", "aras_visual_servo_controller", "teach"]
        self._run([*tool, str(path), "--scheme", scheme,
                   "--timeout", str(IMAGE_TIMEOUT)], TEACH_TIMEOUT)
        return f"the goal {name} is what the camera sees now: {path}"

    def start_recording(self) -> str:
        """A bag of every topic that matters, until `stop_recording`."""
        if self.open_bag is not None and self._recorder.running:
            raise RefusedError(f"recording already, to {self.open_bag}")
        self.check_recording()
        bag = self._make_folder("bags") / time.strftime("run_%Y-%m-%d_%H-%M-%S.bag")
        self._recorder = RosLaunch(
            ["aras_visual_servo_gazebo", "record.launch", f"bag:={bag}"],
            self._make_folder("log") / "record.txt", dict(os.environ),
        )  # fmt: skip
        active = bag.with_name(bag.name + ACTIVE_SUFFIX)
        end = time.monotonic() + CLOSE_TIMEOUT
        while not (active.exists() or bag.exists()):
            ended = RECORDER_ERROR.search(self._recorder.read_log())
            if ended or self._recorder.find_death_message() or time.monotonic() > end:
                why = ended[1] if ended else self._recorder.read_last_lines(1).strip()
                self._recorder.stop()
                raise RefusedError(f"the recorder did not start: {why}")
            time.sleep(0.1)
        self.open_bag = bag
        return f"recording to {bag}"

    def stop_recording(self) -> str:
        """Close the bag."""
        if self.open_bag is None:
            raise RefusedError("nothing is being recorded")
        trouble = self.find_recording_error()
        self._recorder.stop()
        bag, self.open_bag = self.open_bag, None
        if not bag.exists():
            # its recorder was killed; a report reads it
            bag = bag.with_name(bag.name + ACTIVE_SUFFIX)
        if not bag.exists():
            raise RefusedError(
                f"the recorder left no bag: {self._recorder.read_last_lines(1).strip()}"
            )
        self.last_bag = bag
        text = f"recorded {bag} ({bag.stat().st_size / 1e6:.1f} MB)"
        if trouble:
            raise RefusedError(f"{trouble}; what it had until then is kept: {text}")
        return text

    def find_recording_error(self) -> str:
        """Why the bag that is being recorded does not grow any more, as on a full disk; or ''."""
        if self.open_bag is None:
            return ""
        ended = RECORDER_ERROR.search(self._recorder.read_log())
        if ended:
            return ended[1]
        if (
            not self._recorder.find_death_message()
            and "Disabling recording" not in self._recorder.read_log()
        ):
            return ""
        last_line = self._recorder.read_last_lines(1).strip()
        return f"the recorder has stopped: {LOG_PREFIX.sub('', last_line)}"

    def make_report(self) -> str:
        """The report of the last bag, by `analyze`."""
        if self.open_bag is not None:
            raise RefusedError("a bag is still being recorded: stop that first")
        if self.last_bag is None:
            raise RefusedError("nothing has been recorded yet")
        out = self._make_folder(REPORT_FOLDER) / self.last_bag.stem
        self._run(["rosrun", "aras_visual_servo_bench", "analyze", str(self.last_bag), "--out",
                   str(out), "--formats", ""], REPORT_TIMEOUT)  # the page alone
        pages = sorted(out.rglob("*.html"))
        if not pages:
            raise RefusedError(f"analyze left no page in {out}")
        self.report_page = str(pages[0].relative_to(self.directory / REPORT_FOLDER))
        return f"reported in {out}"

    def find_file(self, name: str) -> Path | None:
        """A file of the reports; nothing from elsewhere."""
        root = (self.directory / REPORT_FOLDER).resolve()
        try:
            path = (root / name).resolve()
            return path if path.is_relative_to(root) and path.is_file() else None
        except (OSError, ValueError):  # a name that no file can have: too long, with a NUL
            return None

    def close(self) -> None:
        """Close the bag, if one is open."""
        if self._recorder is not None:
            self._recorder.stop()

    def _make_folder(self, name: str) -> Path:
        path = self.directory / name
        with catch_write_errors(f"to {path}", RefusedError):
            path.mkdir(parents=True, exist_ok=True)
        return path

    @staticmethod
    def _run(command: list[str], seconds: float) -> None:
        """Run a tool to its end; RefusedError with its last line where it fails."""
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=seconds,
                                  check=False, stdin=subprocess.DEVNULL)  # fmt: skip
        except subprocess.TimeoutExpired:
            raise RefusedError(f"{command[2]} has not ended within {seconds:.0f} s") from None
        if done.returncode:
            lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
            raise RefusedError(lines[-1].strip() if lines else f"{command[2]} failed")
