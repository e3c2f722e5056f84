"""Edge cases found by mutation tests: exact zeros, missing values, a second goal, start states."""

from math import inf, pi

import pytest

from aras_sim_bridge.control.controllers.trajectory_types import (
    ErrorCode,
    JointTolerance,
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
)
from aras_sim_bridge.control.joints import (
    POSITION,
    VELOCITY,
    JointBounds,
    JointHandle,
    resolve_limits,
)
from aras_sim_bridge.control.limits import (
    POSITION_SATURATION,
    POSITION_SOFT,
    VELOCITY_SOFT,
    LimitRule,
    enforce_limits,
)
from aras_sim_bridge.control.loop import ControlLoop
from aras_sim_bridge.errors import HardwareError

S = 1_000_000_000


def running(make_rig, make_joint, kind="revolute"):
    """A rig with a running trajectory controller of one position joint, steps of 10 ms."""
    joints = [make_joint("a", kind, "PositionJointInterface", "none")]
    parameters = {"c": {"type": "position_controllers/JointTrajectoryController",
                        "joints": ["a"]}}
    rig = make_rig(joints, parameters, 10_000_000, physics=False)
    return rig, rig.run("c")


def goal(position, seconds):
    points = [TrajectoryPoint(round(seconds * S), [position])]
    return TrajectoryGoal(Trajectory(["a"], points))


def test_a_goal_s_feedback_has_a_rhythm_of_its_own(make_rig, make_joint):
    """At 20 a second: 50 ms after the cycle that takes it, whatever went before."""
    rig, controller = running(make_rig, make_joint)
    for pause in (2, 3):
        times = []
        handle = controller.submit_goal(goal(1.0, 1.0))
        handle.on_feedback = lambda state, times=times: times.append(state.stamp_ns)
        begin = rig.time_ns
        rig.step(10 + pause)
        assert [(time - begin) // 10_000_000 for time in times] == [6, 11]


def test_the_state_of_the_start_can_be_asked_for(make_rig, make_joint):
    rig, controller = running(make_rig, make_joint)
    state = controller.query_state(rig.time_ns)
    assert [*state.positions, *state.velocities, *state.accelerations] == [0.0, 0.0, 0.0]
    # And a trajectory that begins with it has all its points, be they soon.
    points = [TrajectoryPoint(1, [0.5]), TrajectoryPoint(S, [1.5])]
    controller.set_command(Trajectory(["a"], points, rig.time_ns))
    rig.step(50)
    assert rig.hardware.handles["a"].position_command == pytest.approx(1.0) and not rig.log


@pytest.mark.parametrize("periods", [(0, 1000), (1000, 0), (-1, 1000), (1000, -1), (0,)])
def test_periods_must_be_positive(periods):
    with pytest.raises(HardwareError, match="must be positive"):
        ControlLoop(None, None, *periods)
    ControlLoop(None, None, 1, 1)


@pytest.mark.parametrize("quantity", ["max_velocity", "max_acceleration", "max_effort"])
def test_a_limit_of_zero_is_one(make_joint, quantity):
    joint, _ = make_joint("J")
    switch = f"has_{quantity.removeprefix('max_')}_limits"
    limits = resolve_limits(joint, {switch: True, quantity: 0.0}, "/limits/J", print)
    assert getattr(limits, quantity) == 0.0
    with pytest.raises(HardwareError, match="must not be negative"):
        resolve_limits(joint, {switch: True, quantity: -0.1}, "/limits/J", print)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_range_that_the_urdf_leaves_out_is_zero(make_joint, make_limits, kind):
    joint, _ = make_joint("J", kind, limits=make_limits(lower=None, upper=None))
    limits = resolve_limits(joint, {}, "/limits/J", print)
    assert (limits.min_position, limits.max_position) == (0.0, 0.0)
    assert JointHandle("J", kind, joint.limits).position_limits == (0.0, 0.0)


@pytest.mark.parametrize("command", [9.0, -9.0])
def test_position_rules_without_a_range_limit_speed_alone(make_soft, command):
    limits = JointBounds(max_velocity=5.0)
    for rule in (POSITION_SATURATION, POSITION_SOFT):
        joint = JointHandle("J", "continuous", None, make_soft(), POSITION)
        joint.position = 3.0  # beyond the soft limits, which need a range
        joint.position_command = command
        enforce_limits(LimitRule(rule, limits, joint).row, joint.row, 0.1)
        assert joint.position_command == pytest.approx(3.0 + (0.5 if command > 0 else -0.5))
    free = JointHandle("J", "continuous", None, None, POSITION)
    free.position_command = command
    enforce_limits(LimitRule(POSITION_SATURATION, JointBounds(), free).row, free.row, 0.1)
    assert free.position_command == command


@pytest.mark.parametrize("command", [9.0, -9.0])
@pytest.mark.parametrize("limits", [JointBounds(max_velocity=5.0), JointBounds(-2.0, 2.0, 5.0)])
def test_soft_velocity_without_soft_limits_is_the_hard_one(make_soft, limits, command):
    """Even with a gain of zero, times an infinite distance."""
    joint = JointHandle("J", "revolute", None, make_soft(None, None, 0.0, 0.0), VELOCITY)
    joint.position = 0.3
    joint.velocity_command = command
    enforce_limits(LimitRule(VELOCITY_SOFT, limits, joint).row, joint.row, 0.1)
    assert joint.velocity_command == (5.0 if command > 0 else -5.0)
    assert abs(joint.velocity_command) < inf


def test_an_empty_goal_checks_the_tolerance_that_it_brings(make_rig, make_joint):
    """It holds where it is; a joint pushed away from there does not succeed."""
    joints = [make_joint("a", "revolute", "EffortJointInterface", "none")]
    parameters = {"c": {"type": "effort_controllers/JointTrajectoryController", "joints": ["a"],
                        "gains": {"a": {"p": 0.0}}, "stop_trajectory_duration": 0.5}}
    rig = make_rig(joints, parameters, 10_000_000)
    controller = rig.run("c")
    tight = (JointTolerance("a", position=0.01),)
    handle = controller.submit_goal(TrajectoryGoal(Trajectory(["a"], []), (), tight))
    rig.model.v[0] = 1.0
    rig.step(60)
    assert handle.status == "aborted"
    assert handle.result.error_code == ErrorCode.GOAL_TOLERANCE_VIOLATED


@pytest.mark.parametrize(("wanted", "reached"), [
    *[(0.4 + 2 * pi * turns, 0.4) for turns in (-7, -1, 0, 1, 10)],
    # Only at half a turn the plain difference decides.
    (pi, pi), (-pi, -pi), (pi + 5e-4, 5e-4 - pi), (-pi - 5e-4, pi - 5e-4), (pi - 5e-4, pi - 5e-4),
])
def test_a_continuous_joint_sheds_all_full_turns(make_rig, make_joint, wanted, reached):
    rig, controller = running(make_rig, make_joint, "continuous")
    controller.submit_goal(goal(wanted, 0.1))
    rig.step(20)
    assert rig.hardware.handles["a"].position_command == pytest.approx(reached, abs=1e-9)
