"""Adds the packages of this checkout and the helpers of the tests to the module path."""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HELPERS = ("unit/bench", "unit/camera", "unit/servo", "unit/world", "integration")

sys.path[:0] = [
    *(str(package) for package in sorted(ROOT.glob("src/*/src"))),
    *(str(ROOT / "tests" / folder) for folder in HELPERS),
]


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
