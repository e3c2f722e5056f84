"""roslaunch as a child process; all its descendants are ended with it."""

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
# Loaded here, because between fork and exec a lock of another thread could block forever.
_PRCTL = ctypes.CDLL(None).prctl


def find_free_port() -> int:
    """Return a free TCP port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class RosLaunch:
    """A roslaunch process with all processes that it starts.

    It runs in a new session: ^C in the terminal then reaches only the demo, which stops everything
    in order. Remaining processes are found by this session.
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
        """Whether the roslaunch process itself is running."""
        return self._process.poll() is None

    def read_log(self) -> str:
        """Return the log without terminal colour codes."""
        return re.sub("\x1b\\[[0-9;]*m", "", self.log.read_text("utf-8", errors="replace"))

    def find_death_message(self) -> str:
        """Return a message if roslaunch or one of its nodes has died; otherwise ''."""
        if not self.running:
            return f"roslaunch ({self.log.stem}) ended"
        for line in self.read_log().splitlines():
            if "process has died" in line:
                return "node " + line.partition("[")[2].partition("]")[0] + " died"
        return ""

    def read_last_lines(self, count: int = 6) -> str:
        """Return the last errors of the log, or its last lines if there are no errors."""
        lines = [line for line in self.read_log().splitlines() if line.strip()]
        errors = [line for line in lines if "ERROR" in line or "FATAL" in line]
        return "\n".join("    " + line for line in (errors or lines)[-count:])

    def stop(self, patience: float = 20.0) -> None:
        """Send SIGINT, then SIGTERM and SIGKILL; return when no process of the session is left.

        `patience`: s to wait after SIGINT.
        """
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
        """Return the ids of the running processes of the session."""
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                # The fields after the command in brackets: state, parent, group, session, ...
                fields = (entry / "stat").read_bytes().rpartition(b")")[2].split()
                if int(fields[3]) == self._process.pid and fields[0] != b"Z":
                    found.append(int(entry.name))
        return found


def _end_with_parent() -> None:
    """Request SIGINT for this child process when its parent dies, even by SIGKILL."""
    _PRCTL(_PR_SET_PDEATHSIG, signal.SIGINT)
