"""Interpolated set points: values, continuity, and activation."""

import random
from itertools import pairwise
from math import pi

import pytest

from aras_sim_bridge.control.controllers.interpolation import (
    IS_MOVING,
    CommandInterpolator,
    advance_interpolation,
    set_interpolation_target,
)
from aras_sim_bridge.control.joints import JointHandle
from aras_sim_bridge.description import JointLimits

MS = 1_000_000


def interpolation(kind="revolute", velocity=5.0):
    limits = JointLimits(-9.0, 9.0, 1.0, velocity)
    return CommandInterpolator(JointHandle("a", kind, limits))


def follow(it, commands, ms, period=0.001):
    values = []
    for k in range(1, ms + 1):
        if k in commands:
            set_interpolation_target(it.row, commands[k], k * MS)
        values.append(advance_interpolation(it.row, period) if it.row[IS_MOVING] else it.value)
    return values


@pytest.mark.parametrize("interval", [1, 2, 4, 10, 33, 100])
def test_a_steady_stream_is_followed_one_interval_and_3_ms_behind(interval):
    it = interpolation()
    speed = 0.8
    commands = {k: speed * k / 1000 for k in range(1, 6000, interval)}
    values = follow(it, commands, 5900)
    # A command acts from the start of the cycle it arrives in, 1 ms earlier; the lag's own 3 ms.
    behind = [speed * k / 1000 - value for k, value in enumerate(values, 1)]
    wanted = speed * (max(interval, 2) - 1 + 3) / 1000
    assert behind[-200:] == pytest.approx([wanted] * 200, abs=1e-5 * speed * interval)
    steps = [b - a for a, b in pairwise(values[-200:])]
    assert steps == pytest.approx([speed / 1000] * 199, rel=2e-3)


def test_the_time_between_commands_may_vary():
    shift = random.Random(1)
    commands = {10 * k + shift.choice([-2, -1, 0, 1, 2]): 0.008 * k for k in range(1, 200)}
    steps = [b - a for a, b in pairwise(follow(interpolation(), commands, 1900)[-1000:])]
    assert min(steps) > 0.55 * 0.8e-3 and max(steps) < 1.38 * 0.8e-3
    for again_ms in (400, 700_000, -300):
        it = interpolation()
        values = follow(it, {k: 0.0 for k in range(1, 600, 10)}, 700)
        set_interpolation_target(it.row, 0.01, 700 * MS + again_ms * MS)
        values = follow(it, {}, 40)
        # Over 10 ms, not over 33 or 100.
        assert values[8] == pytest.approx(0.01 * (9 - 3 * (1 - 0.75**9)) / 10.0, rel=0.01)
        assert values[39] == pytest.approx(0.01, rel=1e-3)


def test_one_command_is_reached_exactly_whatever_the_control_period():
    it = interpolation()
    it.start(0.25)
    values = follow(it, {1: 0.35}, 300)
    assert values[-1] == 0.35
    # 33 ms of line (0.1 rad takes 20 ms at 5 rad/s), nearly all of it within 50 ms.
    assert values[30] < 0.34 < values[50]
    assert all(0.0 <= b - a <= 0.1 / 33 for a, b in pairwise(values))
    fine, coarse = interpolation(), interpolation()
    for it, period in ((fine, 0.001), (coarse, 0.005)):
        set_interpolation_target(it.row, 0.1, MS)
        for _ in range(round(0.020 / period)):
            advance_interpolation(it.row, period)
    assert coarse.value == pytest.approx(fine.value, abs=0.1 * 0.002 / 0.033)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_far_command_is_approached_at_the_joint_s_velocity_limit(sign):
    values = follow(interpolation(velocity=2.0), {1: sign * 3.0}, 2000)
    assert max(abs(b - a) for a, b in pairwise(values)) == pytest.approx(0.002, rel=1e-6)
    assert sign * values[1400] < 3.0 and values[-1] == sign * 3.0
    for it in (CommandInterpolator(JointHandle("a", "prismatic")),
               interpolation("prismatic", velocity=0.0)):  # none: it takes the usual interval
        assert follow(it, {1: 50.0}, 80)[-1] == pytest.approx(50.0, abs=1e-3)


@pytest.mark.parametrize(("kind", "lower", "upper", "end"), [
    ("revolute", -3000.0, 3000.0, 4.0 - 2 * pi),  # the short way, as a step goes
    ("continuous", None, None, 4.0 - 2 * pi),
    ("revolute", -2.0, 4.5, 4.0),  # the short way leaves the limits
    ("prismatic", -9.0, 9.0, 4.0),
])
def test_a_command_beyond_half_a_turn_goes_the_way_that_steps_go(kind, lower, upper, end):
    limits = JointLimits(lower, upper, 1.0, 50.0)
    it = CommandInterpolator(JointHandle("a", kind, limits))
    values = follow(it, {1: 4.0}, 400)
    assert values[-1] == pytest.approx(end, abs=1e-12)
    assert all(min(end, 0.0) <= value <= max(end, 0.0) for value in values)


TYPES = [
    ("effort_controllers/JointPositionController", "effort_command", {"joint": "a"}),
    ("velocity_controllers/JointPositionController", "velocity_command", {"joint": "a"}),
    ("effort_controllers/JointGroupPositionController", "effort_command", {"joints": ["a"]})]


@pytest.mark.parametrize(("kind", "output", "joints"), TYPES)
def test_position_controllers_interpolate_where_the_parameter_says_so(
    make_rig, make_joint, kind, output, joints
):
    own = {"type": kind, "pid": {"p": 10.0}, "a": {"pid": {"p": 10.0}}, **joints}
    joint = make_joint("a", interface=f"{kind.split('_')[0].title()}JointInterface")
    for given, jump in (({"interpolate": True}, 0.03), ({"interpolate": False}, 1.0), ({}, 1.0)):
        rig = make_rig([joint], {"c": {**own, **given}}, physics=False, q=[0.5])
        rig.run("c").set_command([0.6] if "joints" in joints else 0.6)
        outputs = [0.0]
        for _ in range(200):
            rig.step()
            outputs.append(getattr(rig.hardware.handles["a"], output))
        assert max(b - a for a, b in pairwise(outputs)) == pytest.approx(jump, rel=0.02)
        assert outputs[-1] == pytest.approx(10 * (0.6 - 0.5))


def test_the_set_point_stays_within_the_limits_and_state_shows_it(make_rig, make_joint):
    own = {"type": TYPES[0][0], "joint": "a", "pid": {"p": 10.0}, "interpolate": True}
    rig = make_rig([make_joint("a")], {"c": own}, physics=False)
    controller, states = rig.run("c"), []
    controller.on_state = states.append
    controller.set_command(7.0)
    rig.step(900)
    assert states[0].set_point < 0.2 and states[-1].set_point == 2.0
    for state in states:
        assert state.error == state.set_point - state.process_value
        assert state.command == pytest.approx(10.0 * state.error)
