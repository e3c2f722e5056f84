"""Adds this folder to the module path, so that its tests can import its helpers."""

import sys
from pathlib import Path

import pytest

from aras_visual_servo_bench.plots import style

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def _figures_of_few_dots(monkeypatch):
    """Draw figures with 75 dpi, because drawing them takes half of a report's time."""
    monkeypatch.setitem(style.STYLE, "savefig.dpi", 75)
