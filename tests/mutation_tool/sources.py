"""Which files of the workspace are sources in which faults can be planted."""

from __future__ import annotations

from pathlib import Path

from . import trees


def is_source(top: Path, name: str) -> bool:
    """A Python file below src/, a script without .py among them."""
    if not name.startswith("src/"):
        return False
    if name.endswith(".py"):
        return True
    if "." in Path(name).name or not {"nodes", "scripts"} & set(Path(name).parts):
        return False
    if not (top / name).is_file():
        return False
    with (top / name).open("rb") as file:
        head = file.readline(80)
    return head.startswith(b"#!") and b"python" in head


def all_sources(top: Path) -> dict[str, bytes]:
    """By name from the workspace's top, in order."""
    return {name: (top / name).read_bytes() for name in trees.tracked(top) if is_source(top, name)}
