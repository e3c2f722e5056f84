"""Step responses of the ARAS robot at the original gains.

At rest a joint may stand anywhere where friction f holds it: |PID effort - gravity load| <= f. So
the rest error is bounded by f/p around the point where the integral has not yet taken up the load;
with i/p of 1/7 s (J2) and 1/20 s (J3) the integral has no say within 2 s.
"""

import math

import pytest
from aras_robot import CONTROLLERS, ArasRobot, parameters

START_2015 = (0.1, 0.0, math.radians(10), math.radians(-5), math.radians(-5), 0.0)
START_2016 = (-0.1, 0.0, math.radians(20), math.radians(-15), math.radians(-5), math.radians(10))
# rad or m: f/p, and for J2 and J3 up to 5 N m of gravity load and 1.5 N m of wound-up integral
REST_ERROR = {"gantry": 4e-5, "J1": 3.1e-4, "J2": 8.5e-4, "J3": 8e-4, "J5": 3e-4, "J6": 1.3e-2}


@pytest.fixture
def robot(request):
    """At zero, controllers running for a while; its parameter: whether set points interpolate."""
    it = ArasRobot(interpolate=getattr(request, "param", True))
    it.steps(300)
    yield it
    it.close()


def assert_at_rest(robot, seconds=0.3):
    """Check that all joints are at rest: no oscillation, no limit cycle, held by friction."""
    before = robot.positions()
    for _ in range(round(seconds * 1000)):
        robot.steps(1)
        assert all(abs(v) < 2e-3 for v in robot.velocities().values())
    for joint, position in robot.positions().items():
        assert abs(position - before[joint]) < 3e-5, joint


def test_all_six_controllers_interpolate_in_the_shipped_parameters():
    assert all(parameters()[name]["interpolate"] is True for name in CONTROLLERS.values())


@pytest.mark.parametrize("robot", [False], indirect=True)
def test_step_to_the_demonstration_s_start_meets_the_original_s_figures(robot):
    """All six joints at once, 0.1 m and 10 degrees: this step ends well inside the bands."""
    robot.command(START_2015)
    robot.steps(2000)
    for joint, target in zip(CONTROLLERS, START_2015, strict=True):
        error = abs(robot.positions()[joint] - target)
        assert error < (4e-3 if joint == "J6" else 2e-4), joint
    assert_at_rest(robot)


@pytest.mark.parametrize(("robot", "target"), [
    (False, START_2016), (True, (-0.2,) * 6), (True, (0, 0, 0, 0, 0, 1.0)),
], ids=["2016", "all", "J6"], indirect=["robot"])
def test_every_step_ends_at_rest_in_the_friction_band(robot, target):
    """|effort - gravity load| <= f; the position error follows from it."""
    robot.command(target)
    robot.steps(2000)
    assert_at_rest(robot)
    loads = dict(zip(robot.model.joint_names, robot.model.bias_efforts(), strict=True))
    for joint, wanted in zip(CONTROLLERS, target, strict=True):
        friction = robot.model.description.joints[joint].friction
        effort = robot.hardware.handles[joint].effort_command
        assert abs(effort - loads[joint]) <= friction * 1.01 + 0.01, joint
        assert abs(robot.positions()[joint] - wanted) < REST_ERROR[joint], joint


def test_smooth_move_follows_and_stops_within_the_band(robot):
    """A quintic (minimum-jerk) move of 2 s, commanded at 30 Hz as the servo does."""
    for k in range(60):
        s = (k + 1) / 60
        share = s**3 * (10 - 15 * s + 6 * s * s)
        robot.command([share * q for q in START_2016])
        robot.steps(33 if k < 59 else 53)
        for joint, target in zip(CONTROLLERS, START_2016, strict=True):
            most = REST_ERROR[joint] if k == 59 else 2e-2 if joint == "J6" else 5e-3
            assert abs(robot.positions()[joint] - share * target) < most, joint
