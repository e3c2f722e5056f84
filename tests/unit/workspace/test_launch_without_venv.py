"""Launch files work in a terminal in which only devel/setup.bash was sourced."""

import os
import subprocess
from pathlib import Path

import pytest

SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
ROOT = Path(__file__).parents[3]


def test_the_simulator_s_launch_file_finds_the_workspace_s_python():
    """Its scripts import OpenCV, which is only in the virtual environment."""
    setup = ROOT / "devel" / "setup.bash"
    if not setup.exists():
        pytest.skip("needs a built workspace")
    command = f"source {setup} && exec roslaunch --dump-params \"$@\""
    done = subprocess.run(
        ["/bin/bash", "-c", command, "bash",
         "aras_visual_servo_gazebo", "aras_visual_servo_gazebo.launch", "target:=poster",
         "camera:=wide", "camera_rpy:=0 0.1 0"],
        env={"HOME": os.environ["HOME"], "PATH": SYSTEM_PATH}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-800:]
    assert "/robot_description:" in done.stdout and "/target_description:" in done.stdout
