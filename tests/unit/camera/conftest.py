"""Fixtures of the camera tests."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from scenes import Bench  # noqa: E402


@pytest.fixture
def bench():
    """An empty Bullet world."""
    bench = Bench()
    yield bench
    bench.close()
