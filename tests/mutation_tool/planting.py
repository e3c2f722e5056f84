"""A copy of the workspace with one fault in it, for a while."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from . import loops


class Faulty:
    """The copy with one file changed, and as it was afterwards.

    Each change gets a time of its own, since compiled files, Python's and numba's, are told apart
    by their source's time and size; what numba keeps of a changed file goes into a folder that is
    thrown away, and begins with what the change does not touch.
    """

    def __init__(self, top: Path, task: dict, stamp: int) -> None:
        self._file, self._text, self._stamp = top / task["file"], task["text"].encode(), stamp
        self._cache = top / ".numba-faulty" if task["compiled"] else None
        self._top, self._names = top, tuple(task.get("names", ()))

    def __enter__(self) -> None:
        status = self._file.stat()
        self._was = self._file.read_bytes(), (status.st_atime, status.st_mtime)
        self._file.write_bytes(self._text)
        os.utime(self._file, (status.st_atime, int(status.st_mtime) + self._stamp))
        if self._cache:
            shutil.rmtree(self._cache, ignore_errors=True)
            shutil.copytree(self._top / ".numba", self._cache)
            if self._names:
                names = loops.touched(self._text.decode(), self._names)
                loops.keep(self._cache, self._file.stem, self._was[0], self._text, names)

    def __exit__(self, *_: object) -> None:
        self._file.write_bytes(self._was[0])
        os.utime(self._file, self._was[1])
        if self._cache:
            shutil.rmtree(self._cache, ignore_errors=True)
