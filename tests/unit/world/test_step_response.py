"""Step responses of the ARAS robot at the original gains.

What physics guarantees: at rest a joint may stand anywhere where friction f holds it, that is where
|PID effort - gravity load| <= f. So the rest error is bounded by f/p around the point where the
integral has not yet taken up the gravity load: 3.0e-4 for J1, 1.3e-4 J2, 2.3e-4 J3, 2.6e-4 J5,
1.29e-2 J6 (p = 70, f = 0.9), 3.3e-5 m for the gantry. With i/p of 1/7 s (J2) and 1/20 s (J3) the
integral has no say within 2 s. Where a step comes to rest inside the band depends on the step.
"""

import math

import pytest
from aras_robot import CONTROLLERS, ArasRobot

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


def gravity_loads(robot):
    """Effort by joint that holds the robot still without friction."""
    return dict(zip(robot.model.joint_names, robot.model.bias_efforts(), strict=True))


def assert_at_rest(robot, seconds=0.3):
    """Check that all joints are at rest: no oscillation, no limit cycle, held by friction."""
    before = robot.positions()
    for _ in range(round(seconds * 1000)):
        robot.steps(1)
        assert all(abs(v) < 2e-3 for v in robot.velocities().values())
    for joint, position in robot.positions().items():
        assert abs(position - before[joint]) < 3e-5, joint


@pytest.mark.parametrize("robot", [False], indirect=True)
def test_step_to_the_demonstration_s_start_meets_the_original_s_figures(robot):
    """All six joints at once, 0.1 m and 10 degrees: this step ends well inside the bands."""
    robot.command(START_2015)
    robot.steps(2000)
    for (joint, position), target in zip(
            ((j, robot.positions()[j]) for j in CONTROLLERS), START_2015, strict=True):
        assert abs(position - target) < (4e-3 if joint == "J6" else 2e-4), joint
    assert_at_rest(robot)


@pytest.mark.parametrize(("robot", "target"), [
    (False, START_2016), (True, (-0.2,) * 6), (True, (0, 0, 0, 0, 0, 1.0)),
], ids=["2016", "all", "J6"], indirect=["robot"])
def test_every_step_ends_at_rest_in_the_friction_band(robot, target):
    """|effort - gravity load| <= f; the position error follows from it."""
    robot.command(target)
    robot.steps(2000)
    assert_at_rest(robot)
    loads, positions = gravity_loads(robot), robot.positions()
    for joint, wanted in zip(CONTROLLERS, target, strict=True):
        friction = robot.model.description.joints[joint].friction
        effort = robot.hardware.handles[joint].effort_command
        assert abs(effort - loads[joint]) <= friction * 1.01 + 0.01, joint
        assert abs(positions[joint] - wanted) < REST_ERROR[joint], joint


def test_smooth_move_follows_and_stops_within_the_band(robot):
    """A quintic (minimum-jerk) move of 2 s, commanded at 30 Hz as the servo does."""
    worst = dict.fromkeys(CONTROLLERS, 0.0)
    for k in range(60):
        s = (k + 1) / 60
        share = s**3 * (10 - 15 * s + 6 * s * s)
        robot.command([share * q for q in START_2016])
        robot.steps(33)
        positions = robot.positions()
        for joint, target in zip(CONTROLLERS, START_2016, strict=True):
            worst[joint] = max(worst[joint], abs(positions[joint] - share * target))
    assert all(error < (2e-2 if joint == "J6" else 5e-3) for joint, error in worst.items()), worst
    robot.steps(20)
    positions = robot.positions()
    for joint, wanted in zip(CONTROLLERS, START_2016, strict=True):
        assert abs(positions[joint] - wanted) < REST_ERROR[joint], joint
