"""Lets the tests of this folder share loop_rig.py and free_camera.py."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
