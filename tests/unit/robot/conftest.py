"""Puts the table of figures and the mesh scripts on the import path."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parents[2] / "src" / "aras_visual_servo_gazebo" / "scripts"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
