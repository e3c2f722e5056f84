"""Import of PyBullet without the lines that its C code prints, and management of Bullet clients."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from aras_visual_servo_base.poses import Vector3, add, cross, subtract


@contextmanager
def silence_output() -> Iterator[None]:
    """Discard all output that C and Python code writes to standard output and standard error.

    Exceptions are still raised.
    """
    # C buffers its output to pipes and files; this function writes the buffered output now.
    flush = ctypes.CDLL(None).fflush
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    flush(None)
    saved = {fd: os.dup(fd) for fd in (1, 2)}
    null_device = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd in saved:
            os.dup2(null_device, fd)
        yield
    finally:
        flush(None)
        for fd, copy in saved.items():
            os.dup2(copy, fd)
            os.close(copy)
        os.close(null_device)


if "pybullet" not in sys.modules:
    with silence_output():  # importing pybullet prints "pybullet build time: …"
        import pybullet
else:
    import pybullet

__all__ = [
    "compute_point_velocity",
    "connect",
    "find_contacts",
    "pybullet",
    "release_client",
    "silence_output",
]

# Bullet clients without a window that were released before their first step, for reuse: connecting
# a new client takes 14 ms in each run of a study. A client that has made steps is not reused,
# because its results would depend on these steps.
_idle_clients: list[int] = []


# Program that tries to open Bullet's window in a process of its own, because Bullet ends the
# process if this fails.
_WINDOW_PROGRAM = "import pybullet; raise SystemExit(pybullet.connect(pybullet.GUI) < 0)"
WINDOW_TIMEOUT = 30.0  # time to wait until Bullet's window has opened, s


def check_window() -> None:
    """Check in a separate process that Bullet can open its window.

    Raises:
        pybullet.error: the window cannot be opened on this display.
    """
    display = os.environ.get("DISPLAY", "")
    try:
        result = subprocess.run(
            [sys.executable, "-c", _WINDOW_PROGRAM], capture_output=True, text=True, check=False,
            timeout=WINDOW_TIMEOUT, stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        raise pybullet.error(f"display '{display}' does not answer") from None
    if result.returncode:
        lines = [line.strip() for line in result.stderr.splitlines() if line.strip()]
        reason = next((line for line in reversed(lines) if "build time" not in line), "it ends")
        raise pybullet.error(f"display '{display}': {reason}")


def connect(window: bool) -> int:
    """Return the id of an empty Bullet client, or a negative number on failure.

    Raises:
        pybullet.error: the window cannot be opened.
    """
    if window:
        check_window()
        return pybullet.connect(pybullet.GUI)
    try:
        return _idle_clients.pop()
    except IndexError:
        return pybullet.connect(pybullet.DIRECT)


def release_client(client: int, is_unused: bool) -> None:
    """Release a Bullet client; keep it for reuse if `is_unused` is True and no other is kept.

    `is_unused` means that the client has no window and has never made a step.
    """
    if is_unused and not _idle_clients:
        pybullet.resetSimulation(physicsClientId=client)
        _idle_clients.append(client)
    else:
        pybullet.disconnect(client)


def find_contacts(body: int, client: int) -> list[tuple[int, int, int, tuple[float, ...]]]:
    """Return the contacts of a body.

    PyBullet's own search for the contacts of one body returns wrong friction directions. Therefore
    this function filters the list of all contacts.

    Returns:
        For each contact, the tuple (link of the body, other body, link of the other body, numbers).
        The sixteen numbers are the contact point in the world (m), the normal force and two
        friction forces on the body, each as magnitude (N) and unit direction, and the penetration
        depth (m).
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


def compute_point_velocity(body: int, link: int, point: Vector3, client: int) -> Vector3:
    """Return the velocity (m/s) of a point of a link; `point` (m) is in the world frame."""
    if link < 0:
        centre = pybullet.getBasePositionAndOrientation(body, client)[0]
        linear, angular = pybullet.getBaseVelocity(body, client)
    else:
        state = pybullet.getLinkState(body, link, True, True, client)
        centre, linear, angular = state[0], state[6], state[7]
    return add(linear, cross(angular, subtract(point, centre)))
