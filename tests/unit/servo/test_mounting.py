"""A moved camera: from the launch argument through the description to the loop."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_controller.before import servo
from aras_visual_servo_controller.before.laws import Proportional
from aras_visual_servo_controller.before.schemes import create
from aras_visual_servo_controller.before.settings import STARTS, Settings
from aras_visual_servo_controller.desired import Desired
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals import DESIRED_JOINTS, from_geometry
from aras_visual_servo_controller.kinematics import (
    MOUNTING,
    Kinematics,
    pose_difference,
    rotation_rpy,
    transform,
)
from aras_visual_servo_controller.mounting import from_description, same, to_xyz_rpy
from aras_visual_servo_controller.virtual_robot import VirtualRobot

SOURCES = Path(__file__).parents[3] / "src"
PACKAGE = SOURCES / "aras_visual_servo_controller"
ROBOT = SOURCES / "aras_visual_servo_gazebo"
URDF = ROBOT / "robots" / "aras_visual_servo.urdf"
# A camera 3 cm to the left and 10 degrees down in its picture.
XYZ, RPY = "0 0.03 0", "0 0.1745 0"


def mount(*arguments):
    return subprocess.run(
        [sys.executable, ROBOT / "scripts" / "mount_camera", URDF, *arguments],
        capture_output=True, text=True,
    )  # fmt: skip


@pytest.fixture(scope="module")
def moved():
    return from_description(mount(f"--xyz={XYZ}", f"--rpy={RPY}").stdout)


def test_the_shipped_description_is_what_the_kinematics_have_built_in():
    assert same(from_description(URDF.read_text()), MOUNTING)
    assert same(from_description(mount().stdout), MOUNTING)


def test_the_arguments_are_in_camera_link(moved):
    # Optical z is camera_link's x, optical x its -y, optical y its -z.
    shifted = MOUNTING @ transform((-0.03, 0, 0), (0, 0, 0))
    np.testing.assert_allclose(moved[:3, 3], shifted[:3, 3], atol=1e-9)
    # Pitch about camera_link's y turns its x, the line of sight, towards its -z: down.
    sight = MOUNTING[:3, :3].T @ moved[:3, 2]
    np.testing.assert_allclose(sight, (0, np.sin(0.1745), np.cos(0.1745)), atol=1e-9)


def test_without_an_optical_frame_the_camera_looks_along_its_links_x():
    text = URDF.read_text().replace("camera_optical_frame", "some_other_frame")
    assert same(from_description(text), MOUNTING)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<robot", "<robot <", "robot_description is not XML"),
        ('child link="camera', 'child link="eye', "neither camera_optical_frame nor camera_link"),
        ('parent link="link6"', 'parent link="tool"', "tool hangs on no link6"),
        ('name="camera_joint" type="fixed"', 'name="camera_joint" type="revolute"',
         "joint camera_joint between link6 and the camera is 'revolute'"),
        ("3.14 -1.57 0", "3.14 -1.57", "rpy='3.14 -1.57' of joint camera_joint must be three"),
    ],
)  # fmt: skip
def test_a_description_without_a_camera_on_the_flange_is_refused(old, new, words):
    text = URDF.read_text()
    assert old in text
    with pytest.raises(ConfigurationError) as caught:
        from_description(text.replace(old, new))
    assert words in str(caught.value)


@pytest.mark.parametrize("argument", ["--xyz=0 0", "--rpy=0 0 left", "--xyz=0 0 nan"])
def test_numbers_that_are_none_are_named(argument):
    done = mount(argument)
    assert done.returncode != 0
    assert "must be three finite numbers" in done.stderr


def test_place_and_angles_are_those_of_the_matrix():
    for rpy in ((0.3, -0.2, 1.0), (0.0, np.pi / 2, 0.4), (-3.0, -np.pi / 2, 0.1)):
        xyz, angles = to_xyz_rpy(transform((1, 2, 3), rpy))
        assert xyz == [1, 2, 3]
        np.testing.assert_allclose(rotation_rpy(*angles), rotation_rpy(*rpy), atol=1e-9)


@pytest.mark.parametrize("year", ["2015", "2016"])
def test_the_loop_reaches_the_goal_with_a_moved_camera(moved, year):
    loop = Settings(start=year, package=PACKAGE).build(moved)
    robot = VirtualRobot(np.array(STARTS[year]), kinematics=Kinematics(mounting=moved))
    last = robot.run(loop, 6.0)[-1]
    assert last.phase == servo.CONVERGED
    goal = robot.kinematics.pose(np.array(DESIRED_JOINTS[year]))
    distance, angle = pose_difference(goal, robot.kinematics.pose(robot.q))
    assert distance < 0.5e-3
    assert angle < np.radians(0.2)


@pytest.mark.parametrize("year", ["2015", "2016"])
def test_the_law_knows_how_the_tilted_camera_sees_the_table(settle, year):
    """With the matrix of a table parallel to the image, settling takes twice as long."""
    tilted = from_description(mount("--xyz=0 0.03 0", "--rpy=0.3 0.3 0.1").stdout)
    loop = Settings(start="none", desired=year, package=PACKAGE).build(tilted)
    robot = VirtualRobot(np.array(STARTS[year]), kinematics=Kinematics(mounting=tilted))
    assert settle(robot.run(loop, 4.0)) < 1.3


def test_a_camera_that_looks_along_the_table_is_refused():
    along = MOUNTING @ transform((0, 0, 0), (np.pi / 2 - 0.01, 0, 0))
    desired = from_geometry(DESIRED_JOINTS["2016"], "mine", Kinematics())
    with pytest.raises(ConfigurationError, match="mine: .* looks along the table"):
        create("moments", replace(desired, mounting=along), Proportional())


def test_a_law_that_does_not_know_the_mounting_fails():
    """What the loop would do with a camera mounted upside down if it assumed the robot's own."""
    upside_down = MOUNTING @ transform((0, 0, 0), (0, 0, np.pi))
    robot = VirtualRobot(np.array(STARTS["2016"]), kinematics=Kinematics(mounting=upside_down))
    desired = from_geometry(DESIRED_JOINTS["2016"], "x", robot.kinematics)
    errors = {}
    for name, assumed in (("told", upside_down), ("not told", MOUNTING)):
        robot.q = np.array(STARTS["2016"])
        loop = Settings(start="none", package=PACKAGE).build(assumed)
        loop.scheme = type(loop.scheme)(desired, loop.scheme.law)
        history = robot.run(loop, 1.0)
        norms = [np.linalg.norm(c.scheme_result.error) for c in history if c.scheme_result]
        errors[name] = norms[-1] / norms[0]
    assert errors["told"] < 0.2
    assert errors["not told"] > 1.0


def test_a_goal_taught_with_another_mounting_is_refused(moved, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(from_geometry(DESIRED_JOINTS["2016"], "x").to_yaml("of the stock camera"))
    settings = Settings(desired=str(path), package=PACKAGE)
    settings.build()
    with pytest.raises(ConfigurationError, match=r"mine\.yaml were taught .* teach them anew"):
        settings.build(moved)


def test_a_goal_carries_its_mounting(moved, tmp_path):
    path = tmp_path / "mine.yaml"
    exact = from_geometry(DESIRED_JOINTS["2016"], "x", Kinematics(mounting=moved))
    path.write_text(exact.to_yaml("of a moved camera"))
    assert same(Desired.load(path).mounting, moved)
    loop = Settings(desired=str(path), package=PACKAGE).build(moved)
    np.testing.assert_allclose(loop.scheme.desired.m, exact.m)


def test_a_camera_that_looks_away_from_the_target_is_refused():
    away = MOUNTING @ transform((0, 0, 0), (np.pi, 0, 0))
    with pytest.raises(ConfigurationError, match=r"desired_2016\.yaml is a view .* move it less"):
        Settings(package=PACKAGE).build(away)
