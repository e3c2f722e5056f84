"""Configuration of the unit tests, which run in one process per core."""

import gc
import os
from pathlib import Path

import pytest

# One thread each for BLAS, OpenMP and Mesa, read when they are loaded: several would wait for each
# other at full speed. A matrix exponential of 4 x 4 took 50 times the processor time.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "LP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# What is imported and collected stays to the end, and to look through it again and again for
# garbage took a tenth of all the time.
gc.disable()


# Files whose tests wait for other processes, these first: at the end nothing would run beside them.
WAITING = ("test_cluster", "test_browse_browser", "test_page_browser", "test_report_browser",
           "test_browse", "test_shutdown", "test_engine")  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    items.sort(key=lambda item: here in item.path.parents and item.path.stem not in WAITING)


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()
