#!/usr/bin/env python3
"""Run xacro for older launch files that call it as xacro.py."""

import runpy
from pathlib import Path

runpy.run_path(str(Path(__file__).with_name("xacro")), run_name="__main__")
