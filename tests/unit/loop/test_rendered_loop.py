"""The loop closed over rendered pictures, with each camera preset and with a moved camera."""

import subprocess
import sys

import numpy as np
import pytest
from aras_robot import ROBOT
from rendered_loop import run

SHIPPED = ROBOT / "robots" / "aras_visual_servo.urdf"


def check(result, seconds):
    assert result.settling_time < seconds
    assert result.converged
    assert result.distance < 0.3e-3
    assert result.angle < np.radians(0.2)


@pytest.mark.parametrize("start", ["2015", "2016"])
@pytest.mark.parametrize("camera", ["original", "calibrated", "wide", "fisheye", "noisy"])
def test_settles_at_the_goal(camera, start):
    check(run(camera, start), 1.3)


@pytest.mark.parametrize("start", ["2015", "2016"])
def test_settles_at_the_goal_with_a_camera_moved_and_tilted(start):
    mount = [sys.executable, ROBOT / "scripts" / "mount_camera", SHIPPED]
    urdf = subprocess.check_output([*mount, "--xyz=0 0.03 0", "--rpy=0 0.1745 0"], text=True)
    check(run("original", start, urdf=urdf), 1.7)
