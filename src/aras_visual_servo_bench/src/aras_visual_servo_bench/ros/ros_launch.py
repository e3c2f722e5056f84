"""roslaunch as a child process that can be stopped together with all processes it has started."""

import contextlib
import ctypes
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

POLL_PERIOD = 0.1  # time between two checks of a condition, s
_PR_SET_PDEATHSIG = 1
# The C library is loaded here, before any fork. Loading it between fork and exec could wait forever
# for a lock that another thread holds.
_PRCTL = ctypes.CDLL(None).prctl


def find_free_port() -> int:
    """Return a free TCP port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until(condition: Callable[[], Any], timeout: float) -> Any:
    """Call a function until its result is true or `timeout` (s) is over; return the last result."""
    deadline = time.monotonic() + timeout
    while not (found := condition()) and time.monotonic() < deadline:
        time.sleep(POLL_PERIOD)
    return found


class RosLaunch:
    """A roslaunch process and all processes that it starts.

    roslaunch runs in a new session. ^C in the terminal therefore interrupts only this program,
    which then stops all processes in order. Processes that are then still running are found by
    their session.
    """

    def __init__(self, arguments: list[str], log: Path) -> None:
        self.log = log
        with log.open("w", encoding="utf-8") as output:
            self._process = subprocess.Popen(
                ["roslaunch", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=_end_with_parent,
            )

    @property
    def running(self) -> bool:
        """True if the roslaunch process itself is running."""
        return self._process.poll() is None

    def read_log(self) -> str:
        """Return the text of roslaunch's log without colour codes."""
        return re.sub("\x1b\\[[0-9;]*m", "", self.log.read_text("utf-8", errors="replace"))

    def find_death_message(self) -> str:
        """Return a message if roslaunch has ended or one of its nodes has died, otherwise ''."""
        if not self.running:
            return f"roslaunch ({self.log.stem}) ended"
        for line in self.read_log().splitlines():
            if "process has died" in line:
                return "node " + line.partition("[")[2].partition("]")[0] + " died"
        return ""

    def read_last_lines(self, count: int = 6) -> str:
        """Return the last `count` errors in roslaunch's log, or the last lines if there are none.
        """
        lines = [line for line in self.read_log().splitlines() if line.strip()]
        errors = [line for line in lines if "ERROR" in line or "FATAL" in line]
        return "\n".join("    " + line for line in (errors or lines)[-count:])

    def stop(self, patience: float = 20.0) -> None:
        """Stop roslaunch and all processes that it has started.

        roslaunch receives SIGINT. Processes that are then left receive SIGTERM and finally SIGKILL.

        patience: longest time to wait after SIGINT, s.
        """
        if self.running:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(patience)
        for kind, wait in ((signal.SIGTERM, 3.0), (signal.SIGKILL, 2.0)):
            if not self._signal_session(kind):
                break
            wait_until(lambda: not self._find_processes(), wait)
        self._process.wait()

    def _signal_session(self, kind: signal.Signals) -> bool:
        members = self._find_processes()
        for pid in members:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, kind)
        return bool(members)

    def _find_processes(self) -> list[int]:
        """Return the ids of the running processes in the session of roslaunch."""
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                # /proc/PID/stat contains the process id, the command in brackets, then state,
                # parent, process group, session, ...
                fields = (entry / "stat").read_bytes().rpartition(b")")[2].split()
                if int(fields[3]) == self._process.pid and fields[0] != b"Z":
                    found.append(int(entry.name))
        return found


def _end_with_parent() -> None:
    """Request that this child process receives SIGINT when its parent ends, even by SIGKILL."""
    _PRCTL(_PR_SET_PDEATHSIG, signal.SIGINT)
