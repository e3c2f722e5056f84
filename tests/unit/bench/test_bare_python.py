"""The runner in plain Python: only with requirements/, without Debian packages and ROS."""

import subprocess
import sys
import sysconfig
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[3] / "src"
# As in a virtual environment without --system-site-packages: -I and -S leave Debian's folders out.
SCRIPT = f"""
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
        [sys.executable, "-I", "-S", "-c", SCRIPT], capture_output=True, text=True, timeout=120,
        env={"PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    assert done.stdout.strip() == "bare", done.stderr[-2000:]
