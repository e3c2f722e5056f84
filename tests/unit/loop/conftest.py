"""Lets the tests of this folder share rendered_loop.py and the robot of the world's tests."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parent / "world"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
