"""What several tests of the bench share."""

import os
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parent / "world"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))

from aras_visual_servo_bench.asked import cameras  # noqa: E402
from aras_visual_servo_bench.asked.robots import Robot, RobotSpec  # noqa: E402


@pytest.fixture(scope="session")
def robot():
    return Robot(RobotSpec())


@pytest.fixture(scope="session")
def arm(robot):
    return robot.arm()


@pytest.fixture(scope="module")
def host(robot, pinhole):
    """Of a live page, without a graph."""
    from page_host import StandIn

    return StandIn(robot, pinhole)


@pytest.fixture(scope="module")
def server(host):
    """That page, served."""
    from aras_visual_servo_bench.live.server import serve

    found = serve(host, "127.0.0.1", 18300 + os.getpid() % 1000, say=lambda _: None)
    yield found
    found.close()


@pytest.fixture(scope="session")
def preset(robot):
    """Settings of the camera of 2015."""
    return cameras.preset("original", robot.packages, "aras_visual_servo_gazebo")


@pytest.fixture(scope="session")
def pinhole(preset):
    return cameras.model_of(preset)
