"""Runs with different targets, cameras and lenses do not leak memory."""

import subprocess
import sys
from pathlib import Path

MEMORY = Path(__file__).resolve().parents[2] / "benchmarks" / "memory.py"


def test_runs_that_differ_leave_no_memory_behind():
    words = ["--warm", "8", "--runs", "8", "--plants", "bullet", "chain"]  # has all of the others
    subprocess.run([sys.executable, MEMORY, *words], check=True)
