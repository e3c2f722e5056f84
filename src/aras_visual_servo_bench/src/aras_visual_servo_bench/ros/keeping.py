"""What is kept of a run: a goal taught, a bag recorded, a report of it."""

from __future__ import annotations

import os
import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from ..errors import RefusedError, writing
from .processes import Launch

TEACHING, REPORTING, CLOSING = 90.0, 180.0, 15.0  # s of wall time
IMAGES = 20.0  # s that teaching waits for images
REPORT = "report"
ACTIVE = ".active"  # behind the name of a bag that is not closed
LOGGED = re.compile(r"^\[ ?\w+\] \[[\d., ]+\]: ")  # what a log line begins with
ENDED = re.compile(r"^\[ERROR\] (the recorder .*)$", re.MULTILINE)  # report_recorder_end's line


class Keeping:
    """Runs the tools for it, and knows where they put their files.

    Attributes:
        recording: bag that is being written, None while none is.
        recorded: the last one that was; unclosed where its recorder was killed.
        check: raises RefusedError where nothing could be recorded; called before it is begun.
        report: path of the last report's page within the reports, '' while there is none.
    """

    def __init__(self, directory: Path) -> None:
        self.check: Callable[[], None] = lambda: None
        self.directory = directory
        self.recording: Path | None = None
        self.recorded: Path | None = None
        self.report = ""
        self._recorder: Launch | None = None

    def teach(self, name: str, scheme: str) -> str:
        """The view that the camera has now, as a goal of that name."""
        path = self._made("goals") / f"{name}.yaml"
        tool = ["rosrun", "aras_visual_servo_controller", "teach"]
        self._run([*tool, str(path), "--scheme", scheme,
                   "--timeout", str(IMAGES)], TEACHING)
        return f"the goal {name} is what the camera sees now: {path}"

    def record(self) -> str:
        """A bag of every topic that matters, until `stop_record`."""
        if self.recording is not None and self._recorder.running:
            raise RefusedError(f"recording already, to {self.recording}")
        self.check()
        bag = self._made("bags") / time.strftime("run_%Y-%m-%d_%H-%M-%S.bag")
        self._recorder = Launch(
            ["aras_visual_servo_gazebo", "record.launch", f"bag:={bag}"],
            self._made("log") / "record.txt", dict(os.environ),
        )  # fmt: skip
        active = bag.with_name(bag.name + ACTIVE)
        end = time.monotonic() + CLOSING
        while not (active.exists() or bag.exists()):
            ended = ENDED.search(self._recorder.text())
            if ended or self._recorder.death() or time.monotonic() > end:
                why = ended[1] if ended else self._recorder.last_lines(1).strip()
                self._recorder.stop()
                raise RefusedError(f"the recorder did not start: {why}")
            time.sleep(0.1)
        self.recording = bag
        return f"recording to {bag}"

    def stop_record(self) -> str:
        """Close the bag."""
        if self.recording is None:
            raise RefusedError("nothing is being recorded")
        trouble = self.trouble()
        self._recorder.stop()
        bag, self.recording = self.recording, None
        if not bag.exists():
            bag = bag.with_name(bag.name + ACTIVE)  # its recorder was killed; a report reads it
        if not bag.exists():
            raise RefusedError(f"the recorder left no bag: {self._recorder.last_lines(1).strip()}")
        self.recorded = bag
        text = f"recorded {bag} ({bag.stat().st_size / 1e6:.1f} MB)"
        if trouble:
            raise RefusedError(f"{trouble}; what it had until then is kept: {text}")
        return text

    def trouble(self) -> str:
        """Why the bag that is being recorded does not grow any more, as on a full disk; or ''."""
        if self.recording is None:
            return ""
        ended = ENDED.search(self._recorder.text())
        if ended:
            return ended[1]
        if not self._recorder.death() and "Disabling recording" not in self._recorder.text():
            return ""
        return f"the recorder has stopped: {LOGGED.sub('', self._recorder.last_lines(1).strip())}"

    def make_report(self) -> str:
        """The report of the last bag, by `analyze`."""
        if self.recording is not None:
            raise RefusedError("a bag is still being recorded: stop that first")
        if self.recorded is None:
            raise RefusedError("nothing has been recorded yet")
        out = self._made(REPORT) / self.recorded.stem
        self._run(["rosrun", "aras_visual_servo_bench", "analyze", str(self.recorded), "--out",
                   str(out), "--formats", ""], REPORTING)  # the page alone
        pages = sorted(out.rglob("*.html"))
        if not pages:
            raise RefusedError(f"analyze left no page in {out}")
        self.report = str(pages[0].relative_to(self.directory / REPORT))
        return f"reported in {out}"

    def file(self, name: str) -> Path | None:
        """A file of the reports; nothing from elsewhere."""
        root = (self.directory / REPORT).resolve()
        try:
            path = (root / name).resolve()
            return path if path.is_relative_to(root) and path.is_file() else None
        except (OSError, ValueError):  # a name that no file can have: too long, with a NUL
            return None

    def close(self) -> None:
        """Close the bag, if one is open."""
        if self._recorder is not None:
            self._recorder.stop()

    def _made(self, part: str) -> Path:
        path = self.directory / part
        with writing(f"to {path}", RefusedError):
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
