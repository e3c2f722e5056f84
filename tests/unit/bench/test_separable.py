"""Parts that a run or a command does not need can be taken away, and are not imported."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[3] / "src"
BENCH = "aras_visual_servo_bench"
# What a run of a free camera with exact features does without.
UNNEEDED = (
    "pybullet", "aras_sim_bridge.world", "aras_sim_bridge.control", "aras_sim_bridge.control_cycle",
    "aras_sim_bridge.simulation", "aras_sim_bridge.sensors", "aras_sim_bridge.camera.sensor",
    "aras_sim_bridge.description.sdf", "aras_sim_bridge.description.world_file",
    "aras_visual_servo_camera.model_tracker", "aras_visual_servo_camera.trackers",
    "aras_visual_servo_controller.features.luminance",
    "aras_visual_servo_controller.features.kernel", "aras_visual_servo_controller.features.stereo",
    "aras_visual_servo_controller.teleop", "aras_visual_servo_controller.ros",
    f"{BENCH}.visualization", f"{BENCH}.learning", f"{BENCH}.plots", f"{BENCH}.ros",
    f"{BENCH}.studies", f"{BENCH}.targets.rendering", f"{BENCH}.targets.solids",
    f"{BENCH}.targets.textures", f"{BENCH}.plants.dynamic_arm", f"{BENCH}.web")  # fmt: skip
CONTROLLERS = "aras_sim_bridge.control.controllers"
# What a run of the shipped arm with its shipped target does without.
RARE = (
    f"{CONTROLLERS}.gripper", f"{CONTROLLERS}.joint_trajectory_controller",
    f"{CONTROLLERS}.trajectory_controllers", "aras_sim_bridge.world.grasping",
    "aras_visual_servo_camera.model_tracker", f"{BENCH}.learning", f"{BENCH}.web")  # fmt: skip
# Modules of the project, packages included; they have at most 400 lines each.
MOST_MODULES = 195
FILES_AND_FIGURES = ("scipy.stats", "pandas", "pyarrow", "matplotlib", "dask")
# Each part prints the modules that have been imported up to its end.
PARTS = {
    "help": """from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.cli.arguments import EXAMPLES
for words in ["--help"], *([name, "--help"] for name in EXAMPLES):
    with contextlib.suppress(SystemExit):
        main(words)
""",
    "run": """from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
done = run(Experiment(plant="free", duration=0.3))
assert len(done.stamp) > 4 and "simulated time" in repr(done)
""",
    "command": "main(['run', 'plant=free', 'features=exact', 'duration=0.2'])",
    "scheme": "run(Experiment(plant='free', scheme='predictive', duration=0.2))",
    "images": "run(Experiment(plant='free', features='images', target='poster', duration=0.2))",
    "arm": "assert len(run(Experiment(duration=0.3)).stamp) > 4",
    "figure": """import matplotlib
matplotlib.use("svg")
import matplotlib.pyplot as plt
mine = plt.figure()
done.plot()._repr_png_(), done._repr_html_()
assert (matplotlib.get_backend(), plt.get_fignums(), plt.gcf() is mine) == ("svg", [1], True)
"""}  # the user's backend and figures stay as they are


@pytest.fixture(scope="module")
def imported() -> dict[str, set[str]]:
    """Names of the imported modules after each part of `PARTS`, all in one new process."""
    script = "import contextlib, sys\n" + "".join(
        f"{part}\nprint(*sys.modules, file=sys.stderr)\n" for part in PARTS.values())
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, SOURCES.glob("*/src")))}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          timeout=180, env=environment | {"MPLBACKEND": "agg"})  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("sys builtins ")]
    return {part: set(line.split()) for part, line in zip(PARTS, lines, strict=True)}


@pytest.mark.parametrize(("part", "needed", "others"), [
    ("help", ("argparse",), ("numpy", "cv2", "numba", "scipy", *FILES_AND_FIGURES)),
    ("run", (), UNNEEDED),
    ("command", ("numba",), ("scipy.linalg", "asyncio", *FILES_AND_FIGURES)),
    ("scheme", ("aras_visual_servo_controller.schemes.predictive",), ()),
    ("images", ("aras_sim_bridge.rendering.renderer",), ("pybullet",)),
    ("arm", (f"{CONTROLLERS}.forward", "aras_sim_bridge.world.world"), RARE),
    ("figure", ("matplotlib",), ("pandas", "pyarrow", "dask"))])  # fmt: skip
def test_a_run_or_a_command_imports_what_it_needs(imported, part, needed, others) -> None:
    assert all(find_spec(name) is not None for name in others)
    found = imported[part] - (imported["help"] if part == "run" else set())
    assert not ({name.rpartition(".")[0] for name in found} | found) & set(others)
    assert found >= set(needed)
    if part == "run":  # the package itself has the names of renderers
        assert not any(name.startswith("aras_sim_bridge.rendering.") for name in found)
        assert len([name for name in imported["run"] if name.startswith("aras_")]) <= MOST_MODULES


# As in a virtual environment without --system-site-packages: -I and -S leave Debian's folders out.
BARE = f"""
import site, sys
sys.path = [p for p in sys.path if "dist-packages" not in p]
site.addsitedir({sysconfig.get_path("purelib")!r})
sys.path = [p for p in sys.path if "dist-packages" not in p]
# What requirements/ pin at Debian's own version is Debian's here, and PyPI's in a bare environment.
import importlib.util
for name in ("yaml", "pyparsing", "dateutil", "six"):
    try:
        __import__(name)
    except ImportError:
        sys.path.append("/usr/lib/python3/dist-packages")
        __import__(name)
        sys.path.remove("/usr/lib/python3/dist-packages")
for package in ("visual_servo_base", "sim_bridge", "visual_servo_camera",
                "visual_servo_controller", "visual_servo_bench"):
    sys.path.append({str(SOURCES)!r} + f"/aras_{{package}}/src")
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.metrics import summary
from aras_visual_servo_bench.recording import message_run_builder
from aras_visual_servo_bench.runner.environment import ServoEnv
from aras_visual_servo_bench.runner.loop import run
bullet = run(Experiment(duration=0.2))
assert len(bullet.stamp) > 4, bullet
assert run(Experiment(plant="free", gain=4.0, duration=3.0)).verdict.is_reached
foreign = [n for n in sys.modules if n.split(".")[0] in (
    "rospy", "rospkg", "genpy", "catkin", "catkin_pkg", "std_msgs", "sensor_msgs", "angles", "tf",
    "pinocchio")]
assert not foreign, foreign
print("bare")
"""


def test_experiments_run_without_debian_and_ros():
    done = subprocess.run([sys.executable, "-I", "-S", "-c", BARE], capture_output=True, text=True,
                          timeout=120, env={"PATH": "/usr/bin:/bin"})  # fmt: skip
    assert done.stdout.strip() == "bare", done.stderr[-2000:]
