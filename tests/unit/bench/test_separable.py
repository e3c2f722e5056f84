"""Parts that a run or a command does not need can be taken away, and are not imported."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

from aras_visual_servo_bench import run_study
from aras_visual_servo_bench.cli.arguments import EXAMPLES

SOURCES = Path(__file__).parents[3] / "src"
BENCH = "aras_visual_servo_bench"
# None stands for a module that cannot be imported, nor any below it: as if deleted.
HIDING = """
import sys
for name in sys.argv[1].split():
    sys.modules[name] = None
"""
REPORT = """
try:
    import aras_visual_servo_bench.web.live
    sys.exit("what is hidden can be imported")
except ImportError:
    pass
from pathlib import Path
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.studies.replay import run_with_images
from aras_visual_servo_bench.web.report.write import write_report
run = run_with_images(Experiment(plant="free", duration=0.5), "one")
written = write_report([run], Path(sys.argv[2]), ("png",))
print(sorted(path.name for path in written if path.suffix in (".html", ".json")))
"""
STUDY = """
from pathlib import Path
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.runner.loop import run
assert run(Experiment(plant="free")).verdict.is_reached
out = Path(sys.argv[2])
(out / "study.yaml").write_text("{experiment: {plant: free}, vary: {gain: [1.0, 2.0]}}")
assert main(["run", str(out / "study.yaml"), "--out", str(out / "study"), "--in-process"]) == 0
assert main(["table", str(out / "study")]) == 0
"""
RUN = """
import sys
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
assert len(run(Experiment(**eval(sys.argv[1]))).stamp) > 4
print(*sys.modules)
"""
# What a run of a free camera with exact features does without: physics and control of an arm,
# rendering, sensors, the whole of SDF, learning, model tracker, features of grey levels.
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
    f"{BENCH}.targets.textures", f"{BENCH}.plants.dynamic_arm", f"{BENCH}.web",
)  # fmt: skip
CONTROLLERS = "aras_sim_bridge.control.controllers"
# What a run of the shipped arm with its shipped target does without.
RARE = (
    f"{CONTROLLERS}.gripper", f"{CONTROLLERS}.joint_trajectory_controller",
    f"{CONTROLLERS}.trajectory_controllers", "aras_sim_bridge.world.grasping",
    "aras_visual_servo_camera.model_tracker", f"{BENCH}.learning", f"{BENCH}.web",
)  # fmt: skip
# Modules of the project, packages included; they have at most 400 lines each.
MOST_MODULES = 195
PAGES = f"{BENCH}.web.live {BENCH}.web.browse"


def outcome(script: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a script in a process of its own, with all packages of the workspace on its path."""
    folders = os.pathsep.join(str(folder) for folder in sorted(SOURCES.glob("*/src")))
    search = os.pathsep.join(filter(None, [folders, os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, timeout=180,
        env={**os.environ, "PYTHONPATH": search, "MPLBACKEND": "agg"},
    )  # fmt: skip


def test_a_report_is_written_without_live_page_and_browser(tmp_path: Path) -> None:
    done = outcome(HIDING + REPORT, PAGES, str(tmp_path))
    assert done.stdout == "['report.html', 'summary.json']\n", done.stderr
    assert "uPlot" in (tmp_path / "report.html").read_text()


def test_experiments_and_studies_run_without_pages(tmp_path: Path) -> None:
    done = outcome(HIDING + STUDY, f"{BENCH}.web", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "gain" in done.stdout


def modules_of(**settings: object) -> set[str]:
    """The modules that a process has imported after a run."""
    done = outcome(RUN, repr(settings))
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_a_run_with_exact_features_imports_what_it_needs() -> None:
    found = modules_of(plant="free")
    parts = {name.rpartition(".")[0] for name in found} | found
    assert not parts & set(UNNEEDED)
    # The package itself tells the names of renderers, which an experiment checks.
    assert not any(name.startswith("aras_sim_bridge.rendering.") for name in found)
    assert len([name for name in found if name.startswith("aras_")]) <= MOST_MODULES


def test_what_a_run_needs_is_imported_then() -> None:
    """A scheme by name brings its own module, images of a poster bring the renderer."""
    found = modules_of(plant="free", scheme="predictive", duration=0.5)
    assert "aras_visual_servo_controller.schemes.predictive" in found
    found = modules_of(plant="free", features="images", target="poster", duration=0.5)
    assert "aras_sim_bridge.rendering.renderer" in found and "pybullet" not in found


def test_a_run_of_the_arm_imports_no_rare_feature() -> None:
    """Grippers, trajectories, solid targets and their tracker are for those who have them."""
    found = modules_of(duration=0.3)
    assert f"{CONTROLLERS}.forward" in found and "aras_sim_bridge.world.world" in found
    assert not found & set(RARE)


@pytest.mark.parametrize("name", [*UNNEEDED, *RARE])
def test_names_of_modules_that_are_not_needed_exist(name: str) -> None:
    assert find_spec(name) is not None


LIBRARIES = ("numpy", "cv2", "numba", "scipy", "pandas", "pyarrow", "matplotlib")
COMMANDS = """
import sys
from aras_visual_servo_bench.cli import main
for command in sys.argv[1:]:
    try:
        main(command.split())
    except SystemExit:
        pass
print(*sys.modules, file=sys.stderr)
"""


def imported_by(*commands: str) -> set[str]:
    """The modules that a process has imported after some commands."""
    done = outcome(COMMANDS, *commands)
    assert done.returncode == 0 and done.stdout, done.stderr
    return set(done.stderr.splitlines()[-1].split())


def test_help_imports_no_library():
    found = imported_by("--help", *(f"{name} --help" for name in EXAMPLES))
    assert "argparse" in found
    assert found.isdisjoint(LIBRARIES)


def test_a_run_imports_neither_files_of_studies_nor_figures():
    found = imported_by("run plant=free features=exact duration=0.2")
    assert "numba" in found
    assert found.isdisjoint(("scipy.stats", "scipy.linalg", "pandas", "pyarrow", "matplotlib",
                             "asyncio", "dask"))  # fmt: skip


def test_a_table_imports_neither_compiled_code_nor_what_its_formulas_do_without(tmp_path):
    file = tmp_path / "study.yaml"
    settings = {"plant": "free", "features": "exact", "duration": 0.2}
    file.write_text(yaml.safe_dump({"experiment": settings, "repeats": 3,
                                    "metrics": ["settled", "final_distance"]}))  # fmt: skip
    run_study(file, tmp_path / "out")
    found = imported_by(f"table {tmp_path / 'out'}")
    assert "pyarrow" in found
    assert found.isdisjoint(("numba", "scipy.stats", "pandas", "matplotlib", "dask"))


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
assert run(Experiment(plant="free")).verdict.is_reached
foreign = [n for n in sys.modules if n.split(".")[0] in (
    "rospy", "rospkg", "genpy", "catkin", "catkin_pkg", "std_msgs", "sensor_msgs", "angles", "tf",
    "pinocchio")]
assert not foreign, foreign
print("bare")
"""


def test_experiments_run_without_debian_and_ros():
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", BARE], capture_output=True, text=True, timeout=120,
        env={"PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    assert done.stdout.strip() == "bare", done.stderr[-2000:]
