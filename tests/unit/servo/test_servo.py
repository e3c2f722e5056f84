"""The closed loop with exact vision and lagging joints: arrives in time, holds when blind."""

from dataclasses import replace

import numpy as np
import pytest

from aras_visual_servo_controller.before import laws, schemes, servo
from aras_visual_servo_controller.before.schemes import Measurement, Scheme, SchemeResult
from aras_visual_servo_controller.kinematics import pose_difference
from aras_visual_servo_controller.virtual_robot import VirtualRobot


@pytest.mark.parametrize("lag", [0.03, 0.08])
@pytest.mark.parametrize("year", ["2015", "2016"])
def test_moments_reach_the_desired_pose(loops, settle, year, lag):
    robot = VirtualRobot(np.array(loops.starts[year]), lag=lag)
    history = robot.run(loops.servo(year), 5.0)

    assert settle(history) < 2.0
    last = history[-1]
    assert last.phase == servo.CONVERGED
    assert (np.abs(last.scheme_result.error) < (0.001, 0.003, 0.005, 0.01)).all()
    desired = loops.kinematics.pose(np.array(loops.desired_joints[year]))
    distance, angle = pose_difference(desired, loops.kinematics.pose(robot.q))
    assert distance < 0.2e-3
    assert angle < np.radians(0.1)


def test_errors_decay_without_overshoot(loops):
    robot = VirtualRobot(np.array(loops.starts["2016"]))
    errors = np.array([c.scheme_result.error for c in robot.run(loops.servo("2016"), 4.0)])
    overshoot = (-errors * np.sign(errors[0])).max(axis=0)
    assert (overshoot < 0.05 * np.abs(errors[0])).all()


def test_the_camera_stays_level(loops):
    robot = VirtualRobot(np.array(loops.starts["2016"]))
    for command in robot.run(loops.servo("2016"), 3.0):
        assert abs(loops.kinematics.pitch(command.joint_commands)) < 5e-4


def test_paper_law_and_adaptive_gain_converge_too(loops):
    for scheme, law, seconds in (
        ("moments_2016", laws.Proportional(3.0), 9.0),
        ("moments", laws.Adaptive(), 6.0),
    ):
        robot = VirtualRobot(np.array(loops.starts["2016"]))
        assert robot.run(loops.servo("2016", scheme, law), seconds)[-1].phase == servo.CONVERGED


def test_a_wrong_depth_only_changes_the_speed(loops):
    desired = replace(loops.desired("2016"), depth=1.3 * loops.desired("2016").depth)
    robot = VirtualRobot(np.array(loops.starts["2016"]))
    loop = loops.servo("2016", desired=desired)
    assert robot.run(loop, 6.0)[-1].phase == servo.CONVERGED


def test_two_runs_are_identical(loops):
    ends = []
    for _ in range(2):
        robot = VirtualRobot(np.array(loops.starts["2015"]))
        robot.run(loops.servo("2015"), 1.0)
        ends.append(robot.q)
    np.testing.assert_array_equal(*ends)


def test_lost_target_holds_still_says_so_and_goes_on(loops):
    robot = VirtualRobot(np.array(loops.starts["2016"]))

    def blind_for_a_while(stamp):
        if 0.5 <= stamp < 1.5:
            return Measurement(stamp, valid=False, reason="the target touches the border")
        return robot.measure(stamp)

    history = robot.run(loops.servo("2016"), 6.0, blind_for_a_while)
    blind = [c for c in history if 0.5 <= c.stamp < 1.5]
    assert {c.phase for c in blind} == {servo.HOLDING}
    assert {c.reason for c in blind} == {"the target touches the border"}
    for command in blind:
        np.testing.assert_array_equal(command.joint_commands, blind[0].joint_commands)
        np.testing.assert_array_equal(command.twist, np.zeros(6))
    assert history[-1].phase == servo.CONVERGED


def test_waits_without_joints_and_sends_nothing(loops):
    loop = loops.servo("2016")
    command = loop.step(Measurement(0.0), None)
    assert command.phase == servo.WAITING
    assert command.joint_commands is None


def test_not_finite_joints_hold_the_last_command(loops):
    robot = VirtualRobot(np.array(loops.starts["2016"]))
    loop = loops.servo("2016")
    good = robot.run(loop, 0.5)[-1]
    command = loop.step(robot.measure(0.5), np.array([0, 0, np.nan, 0, 0, 0]))
    assert command.phase == servo.HOLDING
    np.testing.assert_array_equal(command.joint_commands, good.joint_commands)


class Mad(Scheme):
    """A user's scheme with a bug."""

    feature_names = ("x",)
    thresholds = (1.0,)

    def compute(self, measurement, elapsed):
        value = np.array([np.nan])
        return SchemeResult(("x",), value, value, value, np.full(6, np.nan))


def test_nan_of_a_scheme_never_reaches_a_joint(loops, monkeypatch):
    loop = loops.servo("2016")
    loop.scheme = Mad(loops.desired("2016"), laws.Proportional())
    robot = VirtualRobot(np.array(loops.starts["2016"]))
    for command in robot.run(loop, 0.3):
        assert command.phase == servo.HOLDING
        assert "not finite" in command.reason
        assert np.isfinite(command.joint_commands).all()


def test_a_stuck_joint_is_not_run_away_from(loops):
    robot = VirtualRobot(np.array(loops.starts["2016"]))
    stuck = np.array(loops.starts["2016"])
    history = robot.run(loops.servo("2016"), 3.0, positions=lambda stamp, q: stuck)
    lead = np.abs(history[-1].joint_commands - stuck)
    assert (lead <= servo.ServoSettings.lead).all()
    assert "behind its command" in history[-1].reason


def test_approach_reaches_the_start_pose_smoothly_then_opens_its_eyes(loops):
    start = loops.starts["2016"]
    loop = loops.servo("2016", start=start)
    q, previous, stamp = np.zeros(6), np.zeros(6), 0.0
    while loop.approaching and stamp < 10.0:
        command = loop.joints(q, stamp)
        assert command.phase == servo.APPROACHING
        speed = np.abs(command.joint_commands - previous) / 0.01
        assert (speed <= 0.31 * np.asarray(loop.resolver.limits.velocity)).all()
        previous = command.joint_commands
        q = q + 0.3 * (command.joint_commands - q)
        stamp += 0.01
    np.testing.assert_allclose(q, start, atol=1e-3)
    robot = VirtualRobot(q)
    assert robot.run(loop, 6.0)[-1].phase == servo.CONVERGED


def test_approach_names_the_joint_that_does_not_arrive(loops):
    loop = loops.servo("2016", start=loops.starts["2016"])
    for stamp in np.arange(0.0, 4.0, 0.01):
        command = loop.joints(np.zeros(6), stamp)
    assert command.reason.startswith("waiting at the start pose for gantry (0.0000, to be -0.1000)")


def test_reset_begins_anew(loops):
    robot = VirtualRobot(np.array(loops.starts["2015"]))
    loop = loops.servo("2015")
    robot.run(loop, 1.0)
    loop.reset()
    assert loop.phase == servo.WAITING
    again = VirtualRobot(np.array(loops.starts["2015"]))
    fresh = VirtualRobot(np.array(loops.starts["2015"]))
    again.run(loop, 1.0)
    fresh.run(loops.servo("2015"), 1.0)
    np.testing.assert_array_equal(again.q, fresh.q)


def test_smoothing_calms_the_angle_and_forgets_after_a_gap(loops):
    scheme = loops.servo("2016", smoothing=0.1).scheme
    step = np.array([0.0, 0.0, 0.0, 0.1])
    assert scheme.smoothed(np.zeros(4), 0.0)[3] == 0.0
    assert scheme.smoothed(step, 0.1)[3] == pytest.approx(0.1 * (1 - np.exp(-1)))
    assert scheme.smoothed(step, 1.0)[3] == 0.1  # after a gap
    assert scheme.smoothed(-12 * step, 1.03)[3] == pytest.approx(-1.2)  # wrapped round
    scheme.reset()
    assert scheme.smoothed(step, 1.06)[3] == 0.1


def test_schemes_by_name_and_their_faults(loops):
    from aras_visual_servo_controller.errors import ConfigurationError

    law, desired = laws.Proportional(), replace(loops.desired("2016"), kernel=None)
    assert isinstance(
        schemes.create(
            "aras_visual_servo_controller.before.schemes.moments:MomentsScheme", desired, law
        ),
        Scheme,
    )
    for name, words in (
        ("momments", "moments, moments_2016, kernel"),
        ("no_such_package.x:Y", "cannot import no_such_package"),
        ("aras_visual_servo_controller.before.laws:Proportional", "no class Proportional derived"),
        ("kernel", "holds no kernel features"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            schemes.create(name, desired, law)
