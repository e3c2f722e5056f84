"""Every source is in one area, and what tests an area is among its tests."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import pytest

from mutation_tool.areas import AREAS, LEFT_OUT, TESTS_LEFT_OUT, Area
from mutation_tool.equivalents import Equivalents
from mutation_tool.sources import all_sources, is_source

TOP = Path(__file__).parents[3]


def names_of(top: Path, area: Area) -> set[str]:
    return {str(file.relative_to(top)) for file in area.source_files(top)}


def test_every_source_is_in_one_area_or_left_out_for_a_reason() -> None:
    counts = Counter(name for area in AREAS.values() for name in names_of(TOP, area))
    counts.update(str(f.relative_to(TOP)) for glob in LEFT_OUT for f in TOP.glob(glob))
    wrong = {name: counts[name] for name in all_sources(TOP) if counts[name] != 1}
    assert wrong == {}, "areas of each of these; see AREAS in tests/mutation_tool/areas.py"


def test_scripts_are_sources_if_they_are_python(tmp_path: Path) -> None:
    files = {"src/a/nodes/node": "#!/usr/bin/env python3\n", "src/a/scripts/sh": "#!/bin/sh\n",
             "src/a/src/module.py": "", "src/a/README": "#!/usr/bin/env python3\n",
             "src/a/nodes/data.yaml": "a: 1\n", "docs/conf.py": ""}
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert [name for name in files if is_source(tmp_path, name)] == [
        "src/a/nodes/node", "src/a/src/module.py"]


@pytest.mark.parametrize("area", AREAS.values(), ids=list(AREAS))
def test_what_an_area_names_is_there(area: Area) -> None:
    assert area.source_files(TOP) and area.test_files(TOP)
    globs = (*area.sources, *area.without, *(f"{entry}*" for entry in area.tests))
    assert [glob for glob in globs if not any(TOP.glob(glob))] == []
    assert [test for test in area.graph if not (TOP / test).is_file()] == []


def modules() -> dict[str, str]:
    """By dotted name of a module: its area."""
    found = {}
    for area in AREAS.values():
        for name in names_of(TOP, area):
            if "/src/" in name.removeprefix("src/"):
                dotted = name.removesuffix(".py").removesuffix("/__init__").rpartition("/src/")[2]
                found[dotted.replace("/", ".")] = area.name
    return found


def imported(file: Path) -> Counter[str]:
    """How many names a test file takes from each module."""
    counts: Counter[str] = Counter()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            for name in node.names:
                counts[f"{node.module}.{name.name}"] += 1
                counts[node.module] += 1
    return counts


def test_a_file_of_tests_is_among_those_of_the_area_that_it_uses_most() -> None:
    areas = modules()
    ran: dict[Path, set[str]] = {}
    for area in AREAS.values():
        for file in area.test_files(TOP):
            ran.setdefault(file, set()).add(area.name)
    wrong = {}
    for file in sorted((TOP / "tests" / "unit").rglob("test_*.py")):
        if file.relative_to(TOP / "tests" / "unit").parts[0] in TESTS_LEFT_OUT:
            continue
        used: Counter[str] = Counter()
        for name, count in imported(file).items():
            if name in areas and not name.endswith((".errors", ".poses")):
                used[areas[name]] += count
        most = {name for name, count in used.items() if count == max(used.values())}
        if not ran.get(file) or most and not most & ran[file]:
            wrong[str(file.relative_to(TOP))] = sorted(most)
    assert wrong == {}, "uses these areas most, and is among the tests of none of them"


def test_what_the_kept_list_was_made_for_still_stands() -> None:
    texts: dict[str, str] = {}
    for name in all_sources(TOP):
        text = " ".join((TOP / name).read_text().split())
        texts[Path(name).name] = texts.get(Path(name).name, "") + text
    gone = [(file, was) for file, _, was, _ in Equivalents.load().reasons
            if was not in texts.get(file, "")]
    assert gone == []
