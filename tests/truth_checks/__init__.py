"""Comparisons of the simulator with independent software: tests/truth."""

import sys
from pathlib import Path

# Scenes and robots of the unit tests.
sys.path += [str(Path(__file__).parents[1] / "unit" / area) for area in ("camera", "world")]
