"""Benchmarks that need a graph: run with a tiny size, and check that the results are plausible."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"
RUNS = {
    "camera_graph": ["--seconds", "2", "--only", "320x240"],
    "nodes_cost": ["--seconds", "2", "one_process:=true"],
    "original_controllers": ["first"],
    "page_cost": ["--seconds", "2", "--turns", "1"],
    "study_beside": ["--starts", "1"],
}
pytestmark = pytest.mark.graph


@pytest.fixture(scope="module")
def printed():
    """Return the JSON value in the last line that a benchmark prints."""

    def run(name):
        done = subprocess.run(
            [sys.executable, FOLDER / f"{name}.py", *RUNS[name]], capture_output=True, text=True,
            timeout=400, check=False, env=dict(os.environ),
        )  # fmt: skip
        # 1 is for speed that is not reached, which a loaded machine does not reach either.
        assert done.returncode in (0, 1) and done.stdout, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run


def test_images_of_a_graph(printed):
    (found,) = printed("camera_graph").values()
    assert 10.0 < found["rate_hz"] < 101.0 and 0.1 < found["real_time_factor"] < 1.1
    assert found["lost"] >= 0 and 0.0 <= found["delay_median_ms"] <= found["delay_95_percent_ms"]


def test_the_original_controller_reaches_its_goal(printed):
    found = printed("original_controllers")
    assert 0.1 < found["real_time_factor"] < 1.1 and found["messages_a_second"] > 0
    assert found["simulated"] < 45.0


def test_the_cost_of_the_page(printed):
    for found in printed("page_cost").values():
        assert 0.1 < found["factor"] < 1.1
        assert all(0.0 <= found[f"{node}_cpu"] < 2.0 for node in ("page", "camera", "simulator"))


def test_the_cost_of_the_nodes(printed):
    for found in printed("nodes_cost").values():
        assert set(found) == {
            "simulator", "/aras_visual_servo_controller", "total", "memory_mb", "real_time_factor",
        }  # fmt: skip
        assert 0.0 < found["simulator"] < found["total"] < 200.0


def test_studies_and_shell_loops_make_the_same_runs(printed):
    for found in printed("study_beside").values():
        assert found["runs"] == 2 and found["converged"] >= 1 and found["seconds"] > 0.0


def test_a_missing_debian_package_is_named():
    done = subprocess.run(
        [sys.executable, FOLDER / "calibrate_live.py", "--help"], capture_output=True, text=True,
        check=False, timeout=60,
    )  # fmt: skip
    assert "default calibrated" in done.stdout or "apt install" in done.stderr, done.stderr
