"""Which lines of the sources have changed since a branch was left, or since a commit."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from .areas import AREAS, Area, UnknownAreaError
from .sources import all_sources

NAME = "changed"
BRANCHES = ("main", "origin/main")
_HUNK = re.compile(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@")


def changed_lines(top: Path, since: str = "") -> dict[str, set[int]]:
    """By source: the lines that are new since the merge base of HEAD with a branch or commit, by
    default the first of BRANCHES that there is; what is not committed yet included.

    Raises:
        UnknownAreaError: there is no such branch or commit, or no line is new.
    """
    base = _merge_base(top, since)
    lines: dict[str, set[int]] = {}
    sources = all_sources(top)
    name = ""
    for line in _git(top, "diff", "-U0", "--no-color", "--no-ext-diff", base, "--", "src",
                     ).splitlines():
        if line.startswith("+++ "):
            name = line.removeprefix("+++ b/")
        elif (match := _HUNK.match(line)) and name in sources:
            first, count = int(match[1]), int(match[2] or 1)
            lines.setdefault(name, set()).update(range(first, first + count))
    for name in _git(top, "ls-files", "-o", "--exclude-standard", "src").splitlines():
        if name in sources:
            lines[name] = set(range(1, sources[name].count(b"\n") + 2))
    lines = {name: several for name, several in lines.items() if several}
    if not lines:
        raise UnknownAreaError(f"no line of a source is new since {base[:12]}")
    return lines


def area_of(top: Path, lines: dict[str, set[int]]) -> Area:
    """An area of these sources, with the tests of all areas that they belong to.

    Raises:
        UnknownAreaError: they belong to none.
    """
    concerned = [
        area for area in AREAS.values()
        if {str(f.relative_to(top)) for f in area.source_files(top)} & set(lines)
    ]
    if not concerned:
        raise UnknownAreaError(f"in no area: {', '.join(sorted(lines))}")
    tests = tuple(dict.fromkeys(test for area in concerned for test in area.tests))
    return Area(NAME, tuple(sorted(lines)), tests)


def _merge_base(top: Path, since: str) -> str:
    for name in (since,) if since else BRANCHES:
        try:
            return _git(top, "merge-base", "HEAD", name).strip()
        except subprocess.CalledProcessError:
            continue
    known = since or " or ".join(BRANCHES)
    raise UnknownAreaError(f"no branch or commit {known} here: name one with --since")


def _git(top: Path, *arguments: str) -> str:
    return subprocess.run(["git", "-C", str(top), *arguments], capture_output=True, check=True,
                          text=True).stdout
