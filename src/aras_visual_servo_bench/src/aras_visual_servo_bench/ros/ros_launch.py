"""Start roslaunch as a child, and leave no process behind whatever happens."""

import contextlib
import ctypes
import os
import re
import signal
import socket
import subprocess
import time
from pathlib import Path

_PR_SET_PDEATHSIG = 1
# Looked up here, not between fork and exec, where the locks of other threads stay shut.
_PRCTL = ctypes.CDLL(None).prctl


def find_free_port() -> int:
    """A TCP port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class RosLaunch:
    """One roslaunch with everything it starts.

    It gets a session of its own, so that a ^C in the terminal reaches the demo alone, which then
    ends things in order; whoever is still there in the end is found by that session.
    """

    def __init__(self, arguments: list[str], log: Path, environment: dict[str, str]) -> None:
        self.log = log
        with log.open("w", encoding="utf-8") as output:
            self._process = subprocess.Popen(
                ["roslaunch", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
                preexec_fn=_end_with_parent,
            )

    @property
    def running(self) -> bool:
        """Whether roslaunch itself is still there."""
        return self._process.poll() is None

    def read_log(self) -> str:
        """The log without the terminal's colours."""
        return re.sub("\x1b\\[[0-9;]*m", "", self.log.read_text("utf-8", errors="replace"))

    def find_death_message(self) -> str:
        """What roslaunch says of a node that died, '' while none has."""
        if not self.running:
            return f"roslaunch ({self.log.stem}) ended"
        for line in self.read_log().splitlines():
            if "process has died" in line:
                return "node " + line.partition("[")[2].partition("]")[0] + " died"
        return ""

    def read_last_lines(self, count: int = 6) -> str:
        """The end of the log, for a message: errors if there are any, else the last lines."""
        lines = [line for line in self.read_log().splitlines() if line.strip()]
        errors = [line for line in lines if "ERROR" in line or "FATAL" in line]
        return "\n".join("    " + line for line in (errors or lines)[-count:])

    def stop(self, patience: float = 20.0) -> None:
        """End it as ^C would, then harder; returns when nothing of it is left."""
        if self.running:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(patience)
        for kind, wait in ((signal.SIGTERM, 3.0), (signal.SIGKILL, 2.0)):
            if not self._signal_session(kind):
                break
            deadline = time.monotonic() + wait
            while self._find_processes() and time.monotonic() < deadline:
                time.sleep(0.05)
        self._process.wait()

    def _signal_session(self, kind: signal.Signals) -> bool:
        members = self._find_processes()
        for pid in members:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, kind)
        return bool(members)

    def _find_processes(self) -> list[int]:
        """Process ids of the session's living members."""
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                # After the command's name, any bytes in brackets: state, parent, group, session.
                fields = (entry / "stat").read_bytes().rpartition(b")")[2].split()
                if int(fields[3]) == self._process.pid and fields[0] != b"Z":
                    found.append(int(entry.name))
        return found


def _end_with_parent() -> None:
    """In the child: be interrupted when the demo is killed outright."""
    _PRCTL(_PR_SET_PDEATHSIG, signal.SIGINT)
