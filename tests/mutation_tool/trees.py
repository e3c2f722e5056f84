"""Copies of the workspace, in which faults are planted; the checkout itself is never changed."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
import subprocess
from pathlib import Path
from typing import TextIO

_SKIPPED = "tests/mutation_tool/"


def tracked(top: Path) -> list[str]:
    """What git knows of the checkout or could: all but the ignored, as far as tests use it."""
    listing = subprocess.run(
        ["git", "-C", str(top), "ls-files", "-co", "--exclude-standard", "-z"],
        capture_output=True, check=True, text=True,
    ).stdout
    return sorted(
        name for name in listing.split("\0")
        if name and not name.startswith(_SKIPPED) and (top / name).is_file()
    )


def free_copy(folder: Path) -> tuple[Path, TextIO]:
    """The first folder 0, 1, ... below `folder` that no other run works in, and its open lock."""
    folder.mkdir(parents=True, exist_ok=True)
    number = 0
    while True:
        lock = (folder / f"{number}.lock").open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return folder / str(number), lock
        except BlockingIOError:
            lock.close()
        number += 1


def update(top: Path, copy: Path) -> None:
    """Make `copy` equal to the checkout; what is equal already keeps its time."""
    names = tracked(top)
    copy.mkdir(parents=True, exist_ok=True)
    for name in names:
        source, target = top / name, copy / name
        if not target.is_file() or target.read_bytes() != source.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)
    known = {*names, "src/CMakeLists.txt"}  # catkin makes that one
    for folder in ("src", "tests"):
        for path in (copy / folder).rglob("*"):
            name = str(path.relative_to(copy))
            if path.is_file() and name not in known and "__pycache__" not in path.parts:
                path.unlink()
    _take_loops(top, copy)
    for name, target in ((".venv", top / ".venv"), ("../shared", top.parent / "shared")):
        if target.exists() and not (copy / name).is_symlink():
            (copy / name).symlink_to(target.resolve())


def _take_loops(top: Path, copy: Path) -> None:
    """What the checkout has compiled, so that the copy need not: it would take minutes.

    numba keeps the loops of a folder in one that is named after the folder and its path's SHA-1;
    those of a file with another time or size are never used.
    """
    for loop in sorted((top / "src").rglob("__pycache__/*.nb[ic]")):
        folder = (copy / loop.parents[1].relative_to(top)).resolve()
        place = f"{folder.name}_{hashlib.sha1(str(folder).encode()).hexdigest()}"
        kept = copy / ".numba" / place / loop.name
        if not kept.is_file():
            kept.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(loop, kept)
    (copy / ".numba").mkdir(exist_ok=True)


def digest(top: Path, names: list[str]) -> str:
    """Hash of these files' names and contents."""
    total = hashlib.sha256()
    for name in names:
        total.update(name.encode() + b"\0" + (top / name).read_bytes() + b"\0")
    return total.hexdigest()[:16]
