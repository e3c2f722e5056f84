"""Lets the tests of this folder share recorded_values.py, and use the examples of the docs."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[2] / "docs" / "examples")]
