"""Adds recorded_values.py and the examples of the documentation to the module path."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[2] / "docs" / "examples")]
