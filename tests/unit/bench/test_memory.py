"""Runs with different targets, cameras and lenses do not leak memory."""

import subprocess
import sys
from pathlib import Path

import pytest

from aras_visual_servo_bench.experiment.experiment import PLANTS

MEMORY = Path(__file__).resolve().parents[2] / "benchmarks" / "memory.py"


@pytest.mark.parametrize("plant", PLANTS)
def test_runs_that_differ_leave_no_memory_behind(plant):
    """A run that had arrived left 30 MB: the world in which it looked what hides the target."""
    done = subprocess.run(
        [sys.executable, MEMORY, "--warm", "12", "--runs", "12", "--plants", plant],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
