"""Runs with different targets, cameras and lenses do not leak memory."""

import subprocess
import sys
from pathlib import Path

MEMORY = Path(__file__).resolve().parents[2] / "benchmarks" / "memory.py"


def test_runs_that_differ_leave_no_memory_behind():
    subprocess.run([sys.executable, MEMORY, "--warm", "12", "--runs", "12"], check=True)
