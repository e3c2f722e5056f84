"""PyBullet, without the lines that it writes from C, past sys.stdout and sys.stderr."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def silence_output() -> Iterator[None]:
    """Let what C code writes to standard output and error go nowhere meanwhile.

    What goes wrong still arrives as an exception.
    """
    flush = ctypes.CDLL(None).fflush  # C keeps what it writes to a pipe or file
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    flush(None)
    kept = {fd: os.dup(fd) for fd in (1, 2)}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd in kept:
            os.dup2(nowhere, fd)
        yield
    finally:
        flush(None)
        for fd, copy in kept.items():
            os.dup2(copy, fd)
            os.close(copy)
        os.close(nowhere)


if "pybullet" not in sys.modules:
    with silence_output():  # "pybullet build time: …"
        import pybullet
else:
    import pybullet

__all__ = ["connect", "find_contacts", "release_client", "pybullet", "silence_output"]

# Bullets without a window that were given back before their first step. Connecting takes 14 ms of a
# study's run; one that made steps is not used again, since only a fresh one is deterministic.
_idle_clients: list[int] = []


# Bullet ends the whole process where it cannot open its window: another one tries first.
_WINDOW_PROGRAM = "import pybullet; raise SystemExit(pybullet.connect(pybullet.GUI) < 0)"
WINDOW_TIMEOUT = 30.0  # s


def check_window() -> None:
    """Try to open Bullet's window in a process that may end.

    Raises:
        pybullet.error: it cannot be opened on this display.
    """
    display = os.environ.get("DISPLAY", "")
    try:
        done = subprocess.run(
            [sys.executable, "-c", _WINDOW_PROGRAM], capture_output=True, text=True, check=False,
            timeout=WINDOW_TIMEOUT, stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        raise pybullet.error(f"display '{display}' does not answer") from None
    if done.returncode:
        said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        why = next((line for line in reversed(said) if "build time" not in line), "it ends")
        raise pybullet.error(f"display '{display}': {why}")


def connect(window: bool) -> int:
    """An empty Bullet's client id, or a negative number; pybullet.error without a display."""
    if window:
        check_window()
        return pybullet.connect(pybullet.GUI)
    try:
        return _idle_clients.pop()
    except IndexError:
        return pybullet.connect(pybullet.DIRECT)


def release_client(client: int, is_unused: bool) -> None:
    """Be done with a client; `is_unused`: it has no window and has never made a step."""
    if is_unused and not _idle_clients:
        pybullet.resetSimulation(physicsClientId=client)
        _idle_clients.append(client)
    else:
        pybullet.disconnect(client)


def find_contacts(body: int, client: int) -> list[tuple[int, int, int, tuple[float, ...]]]:
    """What touches a body: its link, the other body, that one's link, and sixteen numbers: the
    point (m, world), three forces on the body (normal, two of friction), each as its size (N) and
    a direction, and the depth (m) to which the two are in each other.

    Asked for one body's contacts, PyBullet turns their normals round to suit but not their
    friction; so all are asked for here, and turned as they should be.
    """
    found = []
    for c in pybullet.getContactPoints(physicsClientId=client):
        if c[1] == c[2]:
            continue
        if c[1] == body:
            numbers = (*c[5], c[9], *c[7], c[10], *c[11], c[12], *c[13], -c[8])
            found.append((c[3], c[2], c[4], numbers))
        elif c[2] == body:
            numbers = (*c[6], -c[9], *c[7], -c[10], *c[11], -c[12], *c[13], -c[8])
            found.append((c[4], c[1], c[3], numbers))
    return found
