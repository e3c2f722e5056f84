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
    """Return the joints after so long, and the commands. Joints follow a part of the way each tick;
    `ask` is a twist (6,), a joint and its speed, or None."""
    q, commands = np.array(q), []
    end = t + seconds
    while t < end - 1e-9:
        if isinstance(ask, tuple):
            jog.set_joint_speed(*ask, t)
        elif ask is not None:
            jog.set_twist(ask, t)
        command = jog.update(t, q)
        if command is not None:
            commands.append(command)
            q = q + follow * (command - q)
        t += DT
    return q, np.array(commands)


@pytest.fixture
def jog():
    return Jog(the_arm(), the_limits())


@pytest.mark.parametrize(("axis", "sign"), [(0, -1.0), (0, 1.0), (1, 1.0), (2, -1.0)])
def test_the_camera_goes_along_its_own_axes(jog, axis, sign):
    q, _ = drive(jog, 0.05 * sign * np.eye(6)[axis], 1.0)
    moved = logarithm(np.linalg.inv(the_arm().pose(START)) @ the_arm().pose(q))
    assert moved[axis] == pytest.approx(0.05 * sign, rel=0.25)  # a moment passes until it moves
    assert np.abs(np.delete(moved[:3], axis)).max() < 0.05 * np.abs(moved[axis])
    assert np.abs(moved[3:]).max() < 0.01


def test_a_stretched_arm_says_so_and_stays_where_it_is(jog):
    """Its reach ends just below: the elbow comes to rest straight, and never flips."""
    q, commands = drive(jog, 0.05 * np.eye(6)[2], 2.0)
    assert any(word in jog.reason for word in ("stretched", "cannot produce", "slowed"))
    assert (commands[:, 3] < 1e-3).all()
    moved = the_arm().pose(q)[:3, 3] - the_arm().pose(START)[:3, 3]
    assert moved[2] > -0.01 and np.abs(moved[:2]).max() < 0.02


def test_one_joint_moves_with_a_part_of_its_speed_and_no_other(jog):
    q, commands = drive(jog, ("J2", -0.25), 1.0)
    moved = q - START
    assert moved[2] == pytest.approx(-0.25 * 2.0, rel=0.15)
    assert jog.velocity[2] == pytest.approx(-0.25 * 2.0)
    assert not np.delete(moved, 2).any()
    speeds = np.diff(commands[:, 2]) / DT  # which come gradually
    assert np.abs(np.diff(speeds)).max() <= 2.0 * DT / RAMP_TIME + 1e-9


def test_it_ends_when_nobody_asks_any_more(jog):
    q, _ = drive(jog, ("gantry", 0.5), 0.5)
    rest, commands = drive(jog, None, 2.0, q, t=0.5)
    assert 0.0 < rest[0] - q[0] < 0.5 * (COMMAND_LIFETIME + RAMP_TIME + DT)
    # then the joints are left alone
    assert len(commands) < (COMMAND_LIFETIME + RAMP_TIME + DT) / DT
    jolt = np.abs(np.diff(commands[:, 0], 2)).max()  # it slows down as it got up to speed
    assert jolt <= jog.max_speeds[0] * DT * DT / RAMP_TIME + 1e-9
    assert jog.update(3.0, rest) is None and jog.update(3.0, rest) is None
    elsewhere = START + 0.2  # the next drive begins where the joints are
    jog.set_joint_speed("J1", 0.1, 5.0)
    assert jog.update(5.0, elsewhere) == pytest.approx(elsewhere)


def test_the_next_drive_is_as_the_first():
    used, fresh = (Jog(the_arm(), the_limits(acceleration=0.5)) for _ in range(2))
    drive(used, [-0.05, 0.05, 0.0, 0.0, 0.3, 0.0], 0.5)
    drive(used, None, 1.0, t=0.5)
    again, first = (drive(jog, [0.05, -0.02, 0.01, 0.1, 0.0, -0.2], 0.5, t=2.0)[1]
                    for jog in (used, fresh))  # fmt: skip
    np.testing.assert_array_equal(again, first)
    assert np.abs(np.diff(first[:2], axis=0)).max() <= 2 * 0.5 * DT * DT + 1e-9, "it starts at rest"


@pytest.mark.parametrize(("joint", "sign"), [("gantry", 1.0), ("J5", -1.0)])
def test_a_limit_stops_a_joint_and_is_named(jog, sign, joint):
    arm, k = the_arm(), the_arm().names.index(joint)
    bound = arm.upper[k] if sign > 0.0 else arm.lower[k]
    near = START.copy()
    near[k] = bound - 0.01 * sign
    q, commands = drive(jog, (joint, sign), 1.0, near)
    assert (sign * commands[:, k]).max() == pytest.approx(sign * bound)
    assert jog.reason == f"{joint} is at its limit"
    assert jog.velocity[k] == 0.0  # from which a twist would go on
    q, _ = drive(jog, (joint, -sign), 0.5, q, t=1.0)
    assert sign * q[k] < sign * bound - 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_outside_its_limits_may_come_back_and_go_no_further(jog, sign):
    beyond = START.copy()
    beyond[0] = (the_arm().upper if sign > 0.0 else the_arm().lower)[0] + 0.05 * sign
    q, _ = drive(jog, ("gantry", sign), 0.5, beyond)
    assert q[0] == pytest.approx(beyond[0])
    q, commands = drive(jog, ("gantry", -sign), 0.5, q, t=0.5)
    assert np.abs(np.diff(commands[:, 0])).max() <= 2.0 * DT + 1e-9  # and not by a jump
    assert sign * q[0] < sign * beyond[0] - 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_is_blocked_has_no_command_that_runs_away(jog, sign):
    _, commands = drive(jog, ("J3", 0.25 * sign), 3.0, follow=0.0)
    assert (sign * (commands[:, 3] - START[3])).max() == pytest.approx(MAX_LEAD + 0.15 * 0.5)


@pytest.mark.parametrize("ask", [
    [0.0] * 5, [np.nan] + [0.0] * 5, ("J4", 0.1), ("J1", 1.01), ("J1", -1.01), ("J1", np.nan),
])  # fmt: skip
def test_what_cannot_be_is_refused(jog, ask):
    with pytest.raises((ConfigurationError, ServoError)):
        drive(jog, ask, DT)
    assert jog.update(0.0, START) is None


@pytest.mark.parametrize(("away", "part"), [(0.1, 1.0), (0.001, 0.0)])
def test_servoing_begins_where_somebody_else_has_moved_the_arm(away, part):
    """Or where it stood, unless it was moved far."""
    servo, arm = the_servo(), the_arm()
    for t in 0.01 * np.arange(10):
        servo.update(t, arm.read_joints(arm.names, START))
    servo.stop()
    servo.update(0.2, arm.read_joints(arm.names, START))
    servo.update(0.3, arm.read_joints(arm.names, START + away))
    servo.start()
    command = servo.update(0.31, arm.read_joints(arm.names, START + away)).positions
    np.testing.assert_allclose(command, START + part * away, atol=1e-9)


@pytest.mark.parametrize(("begin", "counts"), [(0.75, False), (0.7499, True)])
def test_what_is_asked_counts_until_its_time_is_over(jog, begin, counts):
    jog.set_joint_speed("J1", 0.0, 0.75)
    assert (jog.update(begin + COMMAND_LIFETIME, START) is not None) is counts


def test_a_pause_between_two_ticks_moves_a_joint_no_further_than_a_tenth_of_a_second():
    """Of a joint without a limit of its own, at 1 rad/s; the first tick moves none."""
    limits = replace(the_limits(), velocity=np.array([1.0, np.inf, 2.0, 2.0, 2.0, 2.0]))
    jog = Jog(the_arm(), limits)
    q, commands = drive(jog, ("J1", 1.0), 0.5)
    assert (commands[0] == START).all()
    jog.set_joint_speed("J1", 1.0, 1.0)
    after = jog.update(1.0, q)
    assert after[1] - commands[-1][1] == pytest.approx(0.1)
    assert jog.update(0.9, after) == pytest.approx(after)  # time that goes back moves none


@pytest.mark.parametrize("is_released", [True, False])
def test_what_another_drive_was_at_is_not_gone_on_with(jog, is_released):
    q, _ = drive(jog, ("J5", 1.0), 0.5)
    if is_released:
        jog.release()
        assert jog.update(0.5, q) is None
    ask, t = (("J5", 1.0), 9.0) if is_released else (np.eye(6)[3], 0.5)
    _, commands = drive(jog, ask, 0.1, q, t=t)
    steps = np.abs(np.diff([q, *commands], axis=0)).max(axis=1)
    assert steps[0] < 4.0 * DT * DT / RAMP_TIME and (steps[0] == 0.0 or not is_released)
    assert 0.0 < steps[1] < 8.0 * DT * DT / RAMP_TIME
