"""A copy of the workspace with one fault in it, for a while."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from . import loops

_FOLDERS = ("src", "tests")


class Faulty:
    """The copy with one file changed, and as it was afterwards.

    Each change gets a time of its own, since compiled files, Python's and numba's, are told apart
    by their source's time and size; what numba keeps of a changed file goes into a folder that is
    thrown away, and begins with what the change does not touch.
    """

    def __init__(self, top: Path, task: dict, stamp: int) -> None:
        self._file, self._text, self._stamp = top / task["file"], task["text"].encode(), stamp
        anew = task.get("compiled") and task.get("anew", True)
        self._cache = top / ".numba-faulty" if anew else None
        self._top, self._names = top, tuple(task.get("names", ()))

    def __enter__(self) -> None:
        status = self._file.stat()
        self._was = self._file.read_bytes(), (status.st_atime_ns, status.st_mtime_ns)
        self._file.write_bytes(self._text)
        later = status.st_mtime_ns // 10**9 * 10**9 + self._stamp * 10**9
        os.utime(self._file, ns=(status.st_atime_ns, later))
        if self._cache:
            shutil.rmtree(self._cache, ignore_errors=True)
            shutil.copytree(self._top / ".numba", self._cache)
            if self._names:
                names = loops.touched(self._text.decode(), self._names)
                loops.keep(self._cache, self._file.stem, self._was[0], self._text, names)

    def __exit__(self, *_: object) -> None:
        self._file.write_bytes(self._was[0])
        os.utime(self._file, ns=self._was[1])
        if self._cache:
            shutil.rmtree(self._cache, ignore_errors=True)


class Files:
    """The copy's sources and tests as they are now, to be made so again."""

    def __init__(self, top: Path) -> None:
        self._top = top
        self._texts = {path: Path(path).read_bytes() for path, _ in self._found()}
        self._stats = dict(self._found())

    def restore(self) -> list[str]:
        """Undo what tests have written there; says to which files, from the top."""
        found = dict(self._found())
        changed = [
            path for path in {*found, *self._stats} if found.get(path) != self._stats.get(path)
        ]
        for path in changed:
            file = Path(path)
            if path not in self._stats:
                file.unlink()
                continue
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(self._texts[path])
            os.utime(file, ns=(self._stats[path][0], self._stats[path][0]))
        return sorted(str(Path(path).relative_to(self._top)) for path in changed)

    def _found(self) -> Iterator[tuple[str, tuple[int, int]]]:
        """Path, and time and size, of each file but what Python compiles."""
        pending = [str(self._top / folder) for folder in _FOLDERS]
        while pending:
            with os.scandir(pending.pop()) as entries:
                for entry in entries:
                    if entry.is_symlink() or entry.name == "__pycache__":
                        continue
                    if entry.is_dir():
                        pending.append(entry.path)
                    else:
                        stat = entry.stat()
                        yield entry.path, (stat.st_mtime_ns, stat.st_size)
