"""Adds the packages of this checkout and the helpers of the tests to the module path."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HELPERS = ("unit/bench", "unit/camera", "unit/servo", "unit/world", "integration")

sys.path[:0] = [
    *(str(package) for package in sorted(ROOT.glob("src/*/src"))),
    *(str(ROOT / "tests" / folder) for folder in HELPERS),
]
