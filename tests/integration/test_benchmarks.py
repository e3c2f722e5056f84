"""Benchmarks that need a graph: run with a tiny size, and check that the results are plausible."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"
pytestmark = pytest.mark.graph


def run(name, *arguments):
    """Return the JSON value in the last line that a benchmark prints."""
    done = subprocess.run([sys.executable, FOLDER / f"{name}.py", *arguments], capture_output=True,
                          text=True, timeout=400, check=False, env=dict(os.environ))
    # 1 is for speed that is not reached, which a loaded machine does not reach either.
    assert done.returncode in (0, 1) and done.stdout, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_original_controller_reaches_its_goal():
    found = run("original_controllers", "first", "--gain", "0.2", "--rest", "0.5")
    assert 0.1 < found["real_time_factor"] < 1.1 and found["messages_a_second"] > 0
    assert found["simulated"] < 45.0 and found["gantry_off_mm"] < 10.0


def test_the_cost_of_the_nodes():
    for found in run("nodes_cost", "--seconds", "1", "one_process:=true", "gain:=2.0").values():
        assert set(found) == {"simulator", "/aras_visual_servo_controller", "total", "memory_mb",
                              "real_time_factor"}
        assert 0.0 < found["simulator"] < found["total"] < 200.0
