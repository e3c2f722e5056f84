"""What each test file runs, recorded once and kept: one recording serves every area.

A recording holds as long as its test file and the helpers beside it. Of a source that has changed
since, the lines that still stand are found again, and lines that are new count as run by what ran
their neighbours. The texts of the sources are kept for that.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import os
from functools import cache
from pathlib import Path

from . import trees


class Baseline:
    """The recordings below `folder`, of tests of the checkout `top`.

    Args:
        top: the checkout.
        folder: where they are kept.
        sources: all sources by their names from `top`, as they are now.
    """

    def __init__(self, top: Path, folder: Path, sources: dict[str, bytes]) -> None:
        self._top, self._names = top, trees.tracked(top)
        self._recordings, self._texts = folder / "recordings", folder / "sources"
        for one in (self._recordings, self._texts):
            one.mkdir(parents=True, exist_ok=True)
        self._sources = sources
        self._digests = {name: digest_of(source) for name, source in sources.items()}

    @cache  # noqa: B019  one baseline a run, in which tests may be written on
    def file(self, test: str) -> Path:
        """Where the recording of a test file is, named after it and its helpers."""
        folder = f"{Path(test).parent}/"
        read = [
            name for name in self._names
            if name == test or name in ("tests/conftest.py", "pyproject.toml")
            or name.startswith(folder) and "/test_" not in name
        ]
        return self._recordings / f"{Path(test).stem}-{trees.digest(self._top, read)}.json"

    def holds(self, test: str) -> bool:
        return self.file(test).is_file()

    def old(self, test: str) -> bool:
        """Whether sources have changed since."""
        ran = json.loads(self.file(test).read_text())["sources"]
        return any(self._digests.get(name) != digest for name, digest in ran.items())

    def keep(self, test: str, recording: dict) -> None:
        recording["lines"] = {n: v for n, v in recording["lines"].items() if n in self._digests}
        recording["sources"] = {name: self._digests[name] for name in recording["lines"]}
        for name, digest in recording["sources"].items():
            if not (self._texts / digest).is_file():
                _write(self._texts / digest, self._sources[name].decode())
        _write(self.file(test), json.dumps(recording))

    def read(self, test: str) -> dict:
        """The recording, its lines being those of the sources as they are now."""
        recording = json.loads(self.file(test).read_text())
        lines = recording["lines"]
        for name, digest in recording["sources"].items():
            if name not in self._digests or not (self._texts / digest).is_file():
                lines.pop(name)
            elif self._digests[name] != digest:
                lines[name] = self._moved(name, digest, lines[name])
        return recording

    def _moved(self, name: str, digest: str, lines: dict[str, list[str]]) -> dict:
        found: dict[str, set[str]] = {}
        for line, old in self._standing(name, digest).items():
            for one in old:
                if contexts := lines.get(str(one)):
                    found.setdefault(str(line), set()).update(contexts)
        return {line: sorted(contexts) for line, contexts in found.items()}

    @cache  # noqa: B019  one baseline a run
    def _standing(self, name: str, digest: str) -> dict[int, range]:
        """By line of the source as it is now: the lines that it was, or that stood around it."""
        was = (self._texts / digest).read_text().splitlines()
        now = self._sources[name].decode().splitlines()
        standing = {}
        for kind, a, b, c, d in difflib.SequenceMatcher(None, was, now, False).get_opcodes():
            for line in range(c, d):
                old = range(a + line - c, a + line - c + 1) if kind == "equal" else range(
                    a - (a == b), b + (a == b))
                standing[line + 1] = range(old.start + 1, old.stop + 1)
        return standing


def digest_of(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()[:16]


def _write(file: Path, text: str) -> None:
    part = file.with_suffix(f".{os.getpid()}")
    part.write_text(text)
    part.rename(file)
