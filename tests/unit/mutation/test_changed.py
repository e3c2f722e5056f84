"""Faults in the lines that are new since a branch was left, and in no others."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from mutation_tool import changed
from mutation_tool.areas import Area, UnknownAreaError
from mutation_tool.faults import sample

WAS = "a = 1\nb = 2\nc = 3\nd = 4\n"
NOW = "a = 1\nb = 22\nc = 3\nd = 4\ne = 5\nf = 6\n"


def git(top: Path, *arguments: str) -> str:
    command = ["git", "-C", str(top), "-c", "user.name=a", "-c", "user.email=a@b", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def top(tmp_path: Path) -> Path:
    """A branch that has left main: one line changed and committed, two added and not."""
    git(tmp_path, "init", "-q", "-b", "main")
    (tmp_path / "src").mkdir()
    for name in ("src/toy.py", "src/gone.py", "src/same.py", "src/data.yaml"):
        (tmp_path / name).write_text(WAS)
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "one")
    git(tmp_path, "checkout", "-qb", "work")
    (tmp_path / "src" / "toy.py").write_text(NOW[: NOW.index("e")])
    (tmp_path / "src" / "gone.py").unlink()
    (tmp_path / "src" / "data.yaml").write_text(NOW)
    git(tmp_path, "commit", "-qam", "two")
    git(tmp_path, "checkout", "-q", "main")
    (tmp_path / "src" / "same.py").write_text(NOW)
    git(tmp_path, "commit", "-qam", "meanwhile on main")
    git(tmp_path, "checkout", "-q", "work")
    (tmp_path / "src" / "toy.py").write_text(NOW)
    (tmp_path / "src" / "new.py").write_text("n = 7\n")
    return tmp_path


def test_new_lines_are_those_since_the_merge_base(top: Path) -> None:
    lines = changed.changed_lines(top)
    assert lines == {"src/toy.py": {2, 5, 6}, "src/new.py": {1, 2}}
    sources = {name: (top / name).read_bytes() for name in lines}
    faults = sample(sources, 99, 1, lines=lines)
    assert {f.now for f in faults} == {"b = 23", "e = 6", "f = 7", "n = 8"}


def test_since_names_a_commit(top: Path) -> None:
    assert changed.changed_lines(top, "HEAD")["src/toy.py"] == {5, 6}
    with pytest.raises(UnknownAreaError, match="no branch or commit nowhere here: name one with"):
        changed.changed_lines(top, "nowhere")


def test_nothing_new_is_told(top: Path) -> None:
    git(top, "add", ".")
    git(top, "commit", "-qm", "three")
    with pytest.raises(UnknownAreaError, match="no line of a source is new since [0-9a-f]{12}$"):
        changed.changed_lines(top, "HEAD")


def test_the_tests_are_those_of_the_areas(top: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(changed, "AREAS", {
        "a": Area("a", ("src/toy.py",), ("tests/a", "tests/both")),
        "b": Area("b", ("src/n*.py",), ("tests/both", "tests/b")),
        "c": Area("c", ("src/same.py",), ("tests/c",)),
    })
    area = changed.area_of(top, {"src/toy.py": {2}, "src/new.py": {1}})
    assert (area.sources, area.tests) == (
        ("src/new.py", "src/toy.py"), ("tests/a", "tests/both", "tests/b"))
    with pytest.raises(UnknownAreaError, match="in no area: src/lost.py"):
        changed.area_of(top, {"src/lost.py": {1}})
