#!/usr/bin/env python3
"""The name under which older launch files call xacro."""

import runpy
from pathlib import Path

runpy.run_path(str(Path(__file__).with_name("xacro")), run_name="__main__")
