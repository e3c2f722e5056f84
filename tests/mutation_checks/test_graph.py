"""Integration files on a built copy, with a stand-in for catkin and a node that is a process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mutation_tool.faults import faults_of
from mutation_tool.graph import Graph, GraphError

NODE = "import sys\n\n\ndef twice(a):\n    return a * 2\n\n\nprint(twice(int(sys.argv[1])))\n"
TEST = """import os, subprocess, sys

def test_node():
    assert os.environ["TOY_SOURCED"] == "1"
    done = subprocess.run([sys.executable, "src/node.py", "3"], capture_output=True, text=True)
    assert done.stdout == "6\\n"
"""
CATKIN = """#!/bin/sh
[ -f src/broken ] && { echo no such package; exit 1; }
mkdir devel && echo 'export TOY_SOURCED=1' > devel/setup.bash
"""
FILE = "tests/integration/test_node.py"


@pytest.fixture
def top(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    top = tmp_path / "work"
    files = {"src/node.py": NODE, FILE: TEST, "pyproject.toml": "", ".gitignore": ".venv\n"}
    for name, text in files.items():
        (top / name).parent.mkdir(parents=True, exist_ok=True)
        (top / name).write_text(text)
    (top / ".venv").symlink_to(sys.prefix)
    subprocess.run(["git", "init", "-q", str(top)], check=True)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "catkin_make").write_text(CATKIN)
    (tmp_path / "bin" / "catkin_make").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}/bin:/usr/bin:/bin")
    return top


def test_a_node_s_lines_are_recorded_and_its_faults_found(top: Path) -> None:
    graph = Graph(top, top.parent / "graphs")
    recording = graph.record(FILE)
    assert recording["lines"]["src/node.py"]["5"] == [FILE]
    assert list(recording["seconds"]) == [FILE] and not recording["failed"]
    (fault,) = (f for f in faults_of(NODE.encode(), "src/node.py") if f.now == "return a / 2")
    task = {"file": fault.file, "compiled": False, "order": [FILE], "wall": 60.0}
    found = graph.run(task | {"text": fault.apply(NODE.encode()).decode()})
    assert (found["status"], found["failed"]) == ("ended", [f"{FILE}::test_node"])
    clean = graph.run(task | {"text": NODE})
    assert (clean["status"], clean["code"], clean["failed"]) == ("ended", 0, [])
    late = graph.run(task | {"text": "import time\ntime.sleep(60)\n", "wall": 2.0})
    assert late["status"] == "time-out"
    assert (top.parent / "graphs" / "0" / "src" / "node.py").read_text() == NODE


def test_what_cannot_be_built_or_fails_by_itself_is_told(top: Path) -> None:
    (top / "src" / "broken").touch()
    with pytest.raises(GraphError, match="cannot be built:\nno such package"):
        Graph(top, top.parent / "graphs").record(FILE)
    (top / "src" / "broken").unlink()
    (top / FILE).write_text(TEST.replace("6", "7"))
    with pytest.raises(GraphError, match="test_node.py fails without any fault"):
        Graph(top, top.parent / "graphs").record(FILE)
