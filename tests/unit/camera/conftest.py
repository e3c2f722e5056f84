"""Fixtures of the camera tests."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from pathlib import Path

import numpy as np
import pytest

from aras_sim_bridge import rendering
from aras_visual_servo_base.compiled_bits import lowest_bit

sys.path.insert(0, str(Path(__file__).parent))

from scenes import Bench  # noqa: E402


@pytest.fixture
def bench():
    """An empty Bullet world."""
    bench = Bench()
    yield bench
    bench.close()


@pytest.fixture
def plainly(monkeypatch):
    """The renderer's compiled functions as plain Python: slow, but nothing is compiled."""
    found = pkgutil.iter_modules(rendering.__path__)
    for module in [importlib.import_module(f"{rendering.__name__}.{one.name}") for one in found]:
        for name, value in list(vars(module).items()):
            if hasattr(value, "py_func"):
                monkeypatch.setattr(module, name, value.py_func)
            elif value is lowest_bit:
                monkeypatch.setattr(module, name, lambda bits: np.int64(
                    (int(bits) & -int(bits)).bit_length() - 1))
    before = np.seterr(all="ignore")  # compiled code divides by 0, and whole numbers overflow
    yield
    np.seterr(**before)
