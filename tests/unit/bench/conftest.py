"""What several tests of the bench share."""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parent / "world"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))

from aras_visual_servo_bench import cameras  # noqa: E402
from aras_visual_servo_bench.robots import Robot, RobotSpec  # noqa: E402


@pytest.fixture(scope="session")
def robot():
    return Robot(RobotSpec())


@pytest.fixture(scope="session")
def arm(robot):
    return robot.arm()


@pytest.fixture(scope="session")
def preset(robot):
    """Settings of the camera of 2015."""
    return cameras.preset("original", robot.packages, "aras_visual_servo_gazebo")


@pytest.fixture(scope="session")
def pinhole(preset):
    return cameras.model_of(preset)
