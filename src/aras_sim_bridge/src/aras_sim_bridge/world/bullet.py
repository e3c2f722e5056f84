"""PyBullet, without the lines that it writes from C, past sys.stdout and sys.stderr."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet() -> Iterator[None]:
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
    with quiet():  # "pybullet build time: …"
        import pybullet
else:
    import pybullet

__all__ = ["pybullet", "quiet"]
