"""What a process with a fault may do: so much memory and time, write below its own folder, and
signal its own processes."""

from __future__ import annotations

import contextlib
import mmap
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

MEMORY = 4 << 30  # bytes that a process may take besides what it began with
SCRATCH = ".scratch"
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_PATHS = {  # audit event: places of paths among its arguments, and of their folders' descriptors
    "os.remove": ((0, 1),), "os.rename": ((0, 2), (1, 3)), "os.mkdir": ((0, 2),),
    "os.rmdir": ((0, 1),), "os.link": ((1, 3),), "os.symlink": ((1, 2),),
    "os.truncate": ((0, None),), "os.chmod": ((0, 2),), "os.chown": ((0, 3),),
    "os.utime": ((0, 3),), "sqlite3.connect": ((0, None),),
}
_FREE = ("/dev/", "/proc/")


class Deadline:
    """When a child is to be ended, kept in memory that it shares with its parent."""

    def __init__(self) -> None:
        # struct.pack_into would write zero first, which the parent could read.
        self._shared = memoryview(mmap.mmap(-1, 8)).cast("d")

    def set(self, seconds: float) -> None:
        self._shared[0] = time.monotonic() + seconds

    @property
    def over(self) -> bool:
        return time.monotonic() > self._shared[0]


def limit_time(deadline: Deadline, cpu: float, wall: float) -> None:
    """From now on this process may take so many seconds."""
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    soft = int(time.process_time() + cpu) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (soft, hard))
    deadline.set(wall)


def confine(top: Path, outside: Path) -> None:
    """Limit this process's memory, give it a home and a temporary folder of its own below `top`,
    and refuse what it would write elsewhere, and signals to processes that do not descend from its
    parent; what that was goes into `outside`: "write PATH" or
    "signal process NUMBER" a line.

    Processes that it starts inherit the first two and, if they are forks, the others.
    """
    with open("/proc/self/statm") as file:
        taken = int(file.read().split()[5]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_DATA, (taken + MEMORY, taken + MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for name, variable in (("home", "HOME"), ("tmp", "TMPDIR")):
        folder = top / SCRATCH / name
        folder.mkdir(parents=True, exist_ok=True)
        os.environ[variable] = str(folder)
    # What is imported for the first time would be kept beside its source, maybe outside.
    os.environ["PYTHONDONTWRITEBYTECODE"], sys.dont_write_bytecode = "1", True
    os.environ.setdefault("MPLCONFIGDIR", str(top / ".matplotlib"))
    tempfile.tempdir = None
    sys.addaudithook(_refusing(f"{top}/", outside))


def _refusing(top: str, outside: Path) -> Callable[[str, tuple], None]:
    noted = os.open(outside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)

    def refuse(path: object, folder: object) -> None:
        if isinstance(path, int) or path is None:
            return
        text = os.fsdecode(path)
        if isinstance(folder, int) and folder >= 0 and not os.path.isabs(text):
            text = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), text)
        # The last part may be a link, which is what is removed or replaced.
        real = os.path.join(os.path.realpath(os.path.dirname(os.path.abspath(text))),
                            os.path.basename(text))
        if not real.startswith((top, *_FREE)) and ":memory:" not in real:
            os.write(noted, os.fsencode(f"write {real}\n"))
            raise PermissionError(f"a test of a fault writes {real}, outside its folder {top}")

    parent = os.getppid()

    def refuse_signal(reached: list[int]) -> None:
        for one in reached:
            if parent not in _ancestors(one):
                os.write(noted, f"signal process {one}\n".encode())
                raise PermissionError(f"a test of a fault signals process {one}, not its own")

    def hook(event: str, arguments: tuple) -> None:
        if event in ("os.kill", "os.killpg"):
            number, signalled = arguments
            if signalled != 0:  # which only asks whether it is there
                refuse_signal(_reached(number, event == "os.killpg"))
        elif event == "open":
            path, mode, flags = arguments
            if (flags or 0) & _WRITES:
                refuse(os.path.realpath(path) if isinstance(path, str | bytes) else path, None)
        elif event in _PATHS:
            for place, folder in _PATHS[event]:
                refuse(arguments[place], None if folder is None else arguments[folder])

    return hook


def _stat(number: int | str) -> list[str]:
    """State, parent, group ... of a process; empty where there is none of this number."""
    with contextlib.suppress(OSError), open(f"/proc/{number}/stat", "rb") as file:
        # Behind the name, which may be any bytes.
        return file.read().rpartition(b")")[2].decode().split()
    return []


def _reached(number: int, group: bool) -> list[int]:
    """Processes that a signal to a process or a group goes to; -1 stands for all there are."""
    if number > 0 and not group:
        return [number]
    if number == -1 and not group:
        return [-1]
    group = abs(number) or os.getpgrp()
    return [number for number in (int(n) for n in os.listdir("/proc") if n.isdigit())
            if (stat := _stat(number)) and int(stat[2]) == group]


def _ancestors(number: int) -> set[int]:
    """The parent of a process, and theirs."""
    found = set()
    while stat := _stat(number):
        number = int(stat[1])
        found.add(number)
    return found


def adopt_orphans() -> None:
    """Processes whose parent ends become children of this one, so that they can be ended."""
    import ctypes  # here, as only Linux's C library has this

    ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def children() -> set[int]:
    """Of this process, those that have ended but were not waited for included."""
    found = set()
    for entry in os.scandir("/proc"):
        if entry.name.isdigit() and _stat(entry.name)[1:2] == [str(os.getpid())]:
            found.add(int(entry.name))
    return found


def end_all(kept: set[int]) -> int:
    """Kill the children but `kept`, and theirs, until there are none; says how many."""
    count = 0
    while left := children() - kept:
        for number in left:
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                os.kill(number, signal.SIGKILL)
                os.waitpid(number, 0)
                count += 1
    return count
