"""Benchmarks: run with a tiny size, and check that the results are plausible."""

import json
import math
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
# What a benchmark is run with, and bounds of the figures whose dotted names match.
RUNS = {
    "browse": (["--runs", "400"], {"reading_s": (0, 60), "longest_answer_s": (0, 30)}),
    "camera_contact_sheet": (
        ["--out", "{folder}/sheet.png", "--only", "depth", "segm", "mono8", "bayer", "blur"], {},
    ),
    "core_size": (
        ["--images", "3"],
        {"imported modules": (20, 400), "lines of executed modules": (1e3, 3e4),
         "functions per image": (20, 400), "functions in set-up": (20, 600),
         "longest function": (5, 100), "lines of code, Python": (1e4, 7e4)},
    ),
    "environment": (["--steps", "2", "--rounds", "1"], {r"here\..*": (0.1, 1e5)}),
    "features": (["--count", "1"], {r"ours\..*": (1, 1e7)}),
    "loop": (
        ["--seconds", "1", "--hours", "0.0001"],
        {"(closed_loop.)?real_time_multiple": (0.1, 1000), r"parts_us\..*": (0, 1e4),
         "memory_.*_mb": (20, 4000)},
    ),
    "model_tracking": (
        ["--count", "2", "--only", "box"],
        {r".*\.mm": (0, 0.3), r".*\.degrees": (0, 0.3), r".*\.lost": (0, 0), r".*\.ms": (0, 1e3)},
    ),
    "moments": (["--repeats", "2", "--rounds", "1"], {r"cases\..*\.ours.*": (1e-3, 1e4)}),
    "peers": (
        ["--images", "20", "--rounds", "1", "--only", "simulator, exact", "PyBullet"],
        {"this simulator, exact": (0.1, 1e3), "PyBullet": (0.1, 1e4)},
    ),
    "render": (
        ["--poses", "1", "--patience", "1", "--sizes", "320x240"],
        {"worst_centroid_rms_px": (0, 0.005), "worst_angle_mrad": (0, 0.5),
         "worst_area_rms_percent": (0, 0.02), r"ms\..*": (0.05, 1e4)},
    ),
    "silhouettes": (
        ["--starts", "1", "--only", "sphere"],
        {r".*\.converged": (1, 1), r".*\.worst\.0": (0, 1e-3)},
    ),
    "study": (
        ["--runs", "0", "--short", "2", "--workers", "0"],
        {"short.runs": (2, 2), "short.0 workers.seconds": (0, 600), "short.identical": (1, 1)},
    ),
    "startup": (
        ["--repeats", "1", "--runs", "2", "help", "table"],
        {r"now\.help": (0.005, 1), r"now\.table": (0.05, 60)},
    ),
}  # fmt: skip
# tests/integration/test_benchmarks.py runs those that need no other Debian package.
ON_A_GRAPH = {"calibrate_live", "nodes_cost", "original_controllers", "show_chessboard"}
APART = {"core_size"}  # counts the modules of its process
ELSEWHERE = {"memory"}  # unit/bench/test_memory.py runs it
IMPORTED = {"checkout", "graph"}  # by the others


def figures(value, name=""):
    """The numbers of a JSON value by their dotted names."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from figures(item, f"{name}.{key}".lstrip("."))
    elif isinstance(value, bool | int | float):
        yield name, float(value)


def test_every_benchmark_is_run_or_named_with_the_reason_why_not():
    here = {path.stem for path in FOLDER.glob("*.py")}
    assert here == RUNS.keys() | ON_A_GRAPH | ELSEWHERE | IMPORTED


def run_here(name, arguments, folder, monkeypatch, capfd):
    """Run a benchmark in this process, which has already imported and loaded most of it."""
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments])
    modules = set(sys.modules)
    try:
        runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
        status = 0
    except SystemExit as end:
        status = end.code or 0
    finally:
        for new in set(sys.modules) - modules:
            if str(FOLDER) in str(getattr(sys.modules[new], "__file__", "")):
                del sys.modules[new]
    printed = capfd.readouterr()
    return status, printed.out, printed.err


def run_apart(name, arguments, folder):
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "PYTHONPATH"))}
    done = subprocess.run(
        [sys.executable, FOLDER / f"{name}.py", *arguments], cwd=folder, env=environment,
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("name", RUNS)
def test_a_benchmark_prints_possible_figures(name, tmp_path, monkeypatch, capfd):
    arguments, bounds = RUNS[name]
    arguments = [argument.format(folder=tmp_path) for argument in arguments]
    if name in APART:
        status, out, err = run_apart(name, arguments, tmp_path)
    else:
        status, out, err = run_here(name, arguments, tmp_path, monkeypatch, capfd)
    # 1 is for speed that is not reached, which a loaded machine does not reach either.
    assert status in (0, 1) and "Traceback" not in err, err
    if not bounds:
        assert next(tmp_path.iterdir()).stat().st_size > 10_000
        return
    found = dict(figures(json.loads(out.splitlines()[-1])))
    assert all(map(math.isfinite, found.values())), found
    for pattern, (least, most) in bounds.items():
        matching = {key: value for key, value in found.items() if re.fullmatch(pattern, key)}
        assert matching, f"no figure {pattern} among {sorted(found)}"
        for key, value in matching.items():
            assert least <= value <= most, (key, value)
