"""Adds robot_figures.py and the mesh scripts to the module path."""

import os
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parents[2] / "src" / "aras_visual_servo_gazebo" / "scripts"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


@pytest.fixture(autouse=True)
def sources_for_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let programs of launch files import the packages as the tests do, without a build."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
