"""The bridge's README walks through the code twice; what it names on the way is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

BRIDGE = Path(__file__).parents[3] / "src" / "aras_sim_bridge"
LIBRARY = BRIDGE / "src" / "aras_sim_bridge"
FOLDERS = (LIBRARY, *(LIBRARY / "ros" / name for name in ("", "runtime", "control", "camera")))


def steps() -> list[str]:
    text = (BRIDGE / "README.md").read_text().partition("## Two walks")[2].partition("\n## ")[0]
    return re.findall(r"^\d+\. (.*(?:\n   .*)*)", text, re.MULTILINE)


def test_there_are_two_walks_of_ten_steps():
    assert len(steps()) == 20


@pytest.mark.parametrize("step", steps(), ids=lambda step: step.split(":")[0].strip("`"))
def test_a_step_names_what_is_there(step):
    """Files by their path below the library, its skin or beside the step's first; functions and
    classes of the library; topics."""
    names = re.findall(r"`([^`]+)`", step)
    files = [name for name in names if name.endswith((".py", "/"))]
    near = {folder / files[0] for folder in FOLDERS}
    near |= {place.parent for place in near}
    for name in files:
        assert any((folder / name).exists() for folder in (*FOLDERS, *near)), f"no {name}"
    text = "\n".join(file.read_text() for file in LIBRARY.rglob("*.py"))
    for name in set(names) - set(files):
        for part in () if name.startswith("/") else name.split("."):
            assert re.search(rf"^ *(def|class) {part}\b", text, re.MULTILINE), f"no {name}"
