"""Adds this folder to the module path, so that its tests can import feature_cases.py."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
