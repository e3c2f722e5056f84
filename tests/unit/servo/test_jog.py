"""Jogging: motion follows requests within the limits and ends when they stop."""

from dataclasses import replace

import numpy as np
import pytest
from loop_rig import STARTS, the_arm, the_limits, the_servo

from aras_visual_servo_base.poses import logarithm
from aras_visual_servo_controller.errors import ConfigurationError, ServoError
from aras_visual_servo_controller.teleop.jog import COMMAND_LIFETIME, MAX_LEAD, RAMP_TIME, Jog

START = np.array(STARTS["2016"])
DT = 0.02


def drive(jog, ask, seconds, q=START, follow=1.0, t=0.0):
    """The joints after so long, and the commands; joints follow a part of the way each tick."""
    q, commands = np.array(q), []
    end = t + seconds
    while t < end - 1e-9:
        ask(t)
        command = jog.update(t, q)
        if command is not None:
            commands.append(command)
            q = q + follow * (command - q)
        t += DT
    return q, np.array(commands)


@pytest.mark.parametrize(("axis", "sign"), [(0, -1.0), (0, 1.0), (1, 1.0), (2, -1.0)])
def test_the_camera_goes_along_its_own_axes(axis, sign):
    arm, twist = the_arm(), np.zeros(6)
    twist[axis] = 0.05 * sign
    jog = Jog(arm, the_limits())
    q, _ = drive(jog, lambda t: jog.set_twist(twist, t), 1.0)
    moved = logarithm(np.linalg.inv(arm.pose(START)) @ arm.pose(q))
    assert moved[axis] == pytest.approx(0.05 * sign, rel=0.25)  # a moment passes until it moves
    others = np.delete(moved[:3], axis)
    assert np.abs(others).max() < 0.05 * np.abs(moved[axis])
    assert np.abs(moved[3:]).max() < 0.01


def test_a_stretched_arm_says_so_and_stays_where_it_is():
    """Its reach ends just below: the elbow comes to rest straight, and never flips."""
    arm, jog = the_arm(), Jog(the_arm(), the_limits())
    q, commands = drive(jog, lambda t: jog.set_twist([0.0, 0.0, 0.05, 0.0, 0.0, 0.0], t), 2.0)
    assert "stretched" in jog.reason or "cannot produce" in jog.reason or "slowed" in jog.reason
    assert (commands[:, 3] < 1e-3).all()
    assert arm.pose(START)[2, 3] - arm.pose(q)[2, 3] < 0.01
    assert np.abs(arm.pose(q)[:2, 3] - arm.pose(START)[:2, 3]).max() < 0.02


def test_one_joint_moves_with_a_part_of_its_speed_and_no_other():
    jog = Jog(the_arm(), the_limits())
    q, _ = drive(jog, lambda t: jog.set_joint_speed("J2", -0.25, t), 1.0)
    moved = q - START
    assert moved[2] == pytest.approx(-0.25 * 2.0, rel=0.15)
    assert jog.velocity[2] == pytest.approx(-0.25 * 2.0)
    assert not np.delete(moved, 2).any()


def test_it_ends_when_nobody_asks_any_more():
    jog = Jog(the_arm(), the_limits())
    q, _ = drive(jog, lambda t: jog.set_joint_speed("gantry", 0.5, t), 0.5)
    rest, commands = drive(jog, lambda t: None, 2.0, q, t=0.5)
    assert 0.0 < rest[0] - q[0] < 0.5 * (COMMAND_LIFETIME + RAMP_TIME + DT)
    assert jog.update(3.0, rest) is None
    # then the joints are left alone
    assert len(commands) < (COMMAND_LIFETIME + RAMP_TIME + DT) / DT
    jolt = np.abs(np.diff(commands[:, 0], 2)).max()  # it slows down as it got up to speed
    assert jolt <= jog.max_speeds[0] * DT * DT / RAMP_TIME + 1e-9
    assert jog.update(3.0, rest) is None


def test_the_next_drive_is_as_the_first():
    used, fresh = (Jog(the_arm(), the_limits(acceleration=0.5)) for _ in range(2))
    twist = [0.05, -0.02, 0.01, 0.1, 0.0, -0.2]
    drive(used, lambda t: used.set_twist([-0.05, 0.05, 0.0, 0.0, 0.3, 0.0], t), 0.5)
    drive(used, lambda t: None, 1.0, t=0.5)
    again, first = (drive(jog, lambda t, jog=jog: jog.set_twist(twist, t), 0.5, t=2.0)[1]
                    for jog in (used, fresh))
    np.testing.assert_array_equal(again, first)
    assert np.abs(np.diff(first[:2], axis=0)).max() <= 2 * 0.5 * DT * DT + 1e-9, "it starts at rest"


def test_the_next_drive_begins_where_the_joints_are():
    jog = Jog(the_arm(), the_limits())
    drive(jog, lambda t: jog.set_joint_speed("gantry", 0.5, t), 0.5)
    drive(jog, lambda t: None, 1.0, t=0.5)
    elsewhere = START + 0.2
    jog.set_joint_speed("J1", 0.1, 5.0)
    assert jog.update(5.0, elsewhere) == pytest.approx(elsewhere)


@pytest.mark.parametrize(("joint", "sign"), [("gantry", 1.0), ("J5", -1.0)])
def test_a_limit_stops_a_joint_and_is_named(sign, joint):
    arm = the_arm()
    jog, k = Jog(arm, the_limits()), arm.names.index(joint)
    bound = arm.upper[k] if sign > 0.0 else arm.lower[k]
    near = START.copy()
    near[k] = bound - 0.01 * sign
    q, commands = drive(jog, lambda t: jog.set_joint_speed(joint, sign, t), 1.0, near)
    assert (sign * commands[:, k]).max() == pytest.approx(sign * bound)
    assert jog.reason == f"{joint} is at its limit"
    assert jog.velocity[k] == 0.0  # from which a twist would go on
    q, _ = drive(jog, lambda t: jog.set_joint_speed(joint, -sign, t), 0.5, q, t=1.0)
    assert sign * q[k] < sign * bound - 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_outside_its_limits_may_come_back_and_go_no_further(sign):
    arm = the_arm()
    beyond = START.copy()
    beyond[0] = (arm.upper[0] if sign > 0.0 else arm.lower[0]) + 0.05 * sign
    jog = Jog(arm, the_limits())
    q, _ = drive(jog, lambda t: jog.set_joint_speed("gantry", sign, t), 0.5, beyond)
    assert q[0] == pytest.approx(beyond[0])
    q, commands = drive(jog, lambda t: jog.set_joint_speed("gantry", -sign, t), 0.5, q, t=0.5)
    assert np.abs(np.diff(commands[:, 0])).max() <= 2.0 * DT + 1e-9  # and not by a jump
    assert sign * q[0] < sign * beyond[0] - 0.05


def test_a_joint_that_is_blocked_has_no_command_that_runs_away():
    for sign in (1.0, -1.0):
        jog = Jog(the_arm(), the_limits())
        _, commands = drive(jog, lambda t, s=sign, j=jog: j.set_joint_speed("J3", 0.25 * s, t), 3.0,
                            follow=0.0)  # fmt: skip
        ahead = sign * (commands[:, 3] - START[3])
        assert ahead.max() == pytest.approx(MAX_LEAD + 0.15 * 0.5)


def test_speed_comes_and_goes_gradually():
    jog = Jog(the_arm(), the_limits())
    _, commands = drive(jog, lambda t: jog.set_joint_speed("J1", 1.0, t), 0.5)
    speeds = np.diff(commands[:, 1]) / DT
    assert np.abs(np.diff(speeds)).max() <= 2.0 * DT / RAMP_TIME + 1e-9
    assert speeds.max() == pytest.approx(2.0)


@pytest.mark.parametrize("ask", [
    lambda jog: jog.set_twist([0.0] * 5, 0.0),
    lambda jog: jog.set_twist([np.nan] + [0.0] * 5, 0.0),
    lambda jog: jog.set_joint_speed("J4", 0.1, 0.0),
    lambda jog: jog.set_joint_speed("J1", 1.01, 0.0),
    lambda jog: jog.set_joint_speed("J1", -1.01, 0.0),
    lambda jog: jog.set_joint_speed("J1", float("nan"), 0.0),
])  # fmt: skip
def test_what_cannot_be_is_refused(ask):
    jog = Jog(the_arm(), the_limits())
    with pytest.raises((ConfigurationError, ServoError)):
        ask(jog)
    assert jog.update(0.0, START) is None


@pytest.mark.parametrize(("away", "begins"), [(0.1, "there"), (0.001, "where it stood")])
def test_servoing_begins_where_somebody_else_has_moved_the_arm(away, begins):
    servo, arm = the_servo(), the_arm()
    for i in range(10):
        servo.update(0.01 * i, arm.read_joints(arm.names, START))
    servo.stop()
    servo.update(0.2, arm.read_joints(arm.names, START))
    after = START + away
    servo.update(0.3, arm.read_joints(arm.names, after))
    servo.start()
    command = servo.update(0.31, arm.read_joints(arm.names, after)).positions
    np.testing.assert_allclose(command, after if begins == "there" else START, atol=1e-9)


def test_what_is_asked_counts_until_its_time_is_over():
    for t, counts in ((0.75 + COMMAND_LIFETIME, False), (0.7499 + COMMAND_LIFETIME, True)):
        jog = Jog(the_arm(), the_limits())
        jog.set_joint_speed("J1", 0.0, 0.75)
        assert (jog.update(t, START) is not None) is counts


def test_a_pause_between_two_ticks_moves_a_joint_no_further_than_a_tenth_of_a_second():
    """Of a joint without a limit of its own, at 1 rad/s; the first tick moves none."""
    limits = replace(the_limits(), velocity=np.array([1.0, np.inf, 2.0, 2.0, 2.0, 2.0]))
    jog = Jog(the_arm(), limits)
    q, commands = drive(jog, lambda t: jog.set_joint_speed("J1", 1.0, t), 0.5)
    assert (commands[0] == START).all()
    jog.set_joint_speed("J1", 1.0, 1.0)
    after = jog.update(1.0, q)
    assert after[1] - commands[-1][1] == pytest.approx(0.1)
    assert jog.update(0.9, after) == pytest.approx(after)  # time that goes back moves none


@pytest.mark.parametrize("end", ["released", "turned to"])
def test_what_another_drive_was_at_is_not_gone_on_with(end):
    """Neither after a release in the middle, nor where the camera is driven after a joint."""
    jog = Jog(the_arm(), the_limits())
    q, _ = drive(jog, lambda t: jog.set_joint_speed("J5", 1.0, t), 0.5)
    if end == "released":
        jog.release()
        assert jog.update(0.5, q) is None
        ask, t = (lambda t: jog.set_joint_speed("J5", 1.0, t)), 9.0
    else:
        ask, t = (lambda t: jog.set_twist(np.eye(6)[3], t)), 0.5
    _, commands = drive(jog, ask, 0.1, q, t=t)
    steps = np.abs(np.diff([q, *commands], axis=0)).max(axis=1)
    assert steps[0] < 4.0 * DT * DT / RAMP_TIME and (steps[0] == 0.0 or end == "turned to")
    assert 0.0 < steps[1] < 8.0 * DT * DT / RAMP_TIME


