"""Conditions under which joint velocities remain valid between two images."""

import numpy as np
import pytest
from arms import bent, make

from aras_visual_servo_controller.kinematics import CommandLimits, DifferentialIK, IKSettings
from aras_visual_servo_controller.kinematics.compiled_ik import REUSE_TIME
from aras_visual_servo_controller.kinematics.task import Task

Q = [0.1, 0.2, 0.6, -0.9, 0.4, 0.5]
SLOW = np.array([0.002, 0.001, 0.001, 0.0, 0.0, 0.002])


def resolve(q, twist, dt=0.01, **limits):
    limits = CommandLimits.for_arm(make("aras"), **limits)
    return DifferentialIK(make("aras"), limits).solve(np.array(q), Task.from_twist(twist), dt)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_it_lasts_while_no_joint_leaves_its_jacobian(joint, sign):
    """At most 2 mrad, whichever way it turns."""
    arm, q = make("ur5"), np.array([0.2, -1.2, 1.4, -0.8, -1.3, 0.3])
    for part, lasts in ((0.99, REUSE_TIME), (1.01, 0.0)):
        speeds = sign * part * 0.002 / 0.05 * np.eye(6)[joint]
        answer = DifferentialIK(arm, elbows=()).solve(
            q, Task.from_twist(arm.jacobian(q) @ speeds), 0.01
        )
        assert np.abs(answer.velocities - speeds).max() < 1e-9 and answer.reuse_time == lasts


def test_it_lasts_while_motion_is_slow_and_reaches_no_limit():
    free = resolve(Q, SLOW)
    assert free.reuse_time == REUSE_TIME and resolve(Q, 20.0 * SLOW).reuse_time == 0.0
    for joint, name in enumerate(make("aras").names):
        speed = free.velocities[joint]
        if abs(speed) < 1e-6:
            continue
        speeds = np.full(6, 1.0)
        speeds[joint] = 0.5 * abs(speed)
        slowed = resolve(Q, SLOW, velocity=speeds.tolist())
        assert (slowed.limiting_joint, slowed.reuse_time) == (name, 0.0)
        for part, lasts in ((0.5, 0.0), (2.0, REUSE_TIME)):  # of the way in that time
            bound = {name: Q[joint] + part * REUSE_TIME * speed}
            side = "upper" if speed > 0.0 else "lower"
            assert resolve(Q, SLOW, **{side: bound}).reuse_time == lasts


@pytest.mark.parametrize("reach", [1e-3, 0.05, 0.5])
def test_it_lasts_where_it_does_not_take_half_of_a_small_bend_away(reach):
    arm = make("ur5")
    resolver = DifferentialIK(arm, settings=IKSettings(reach_bend=reach))
    (fold,) = resolver.elbows
    told = set()
    for bend in (5e-4, 2e-3, 0.01, 0.04):
        q = bent(fold, np.array([0.2, -1.2, 1.4, -0.8, -1.3, 0.3]), bend)
        for speed in (-0.03, -0.01, 0.03):
            twist = arm.jacobian(q)[:, fold.joint] * speed
            answer = resolver.solve(q, Task.from_twist(twist), 0.01)
            passes = bend < reach and -answer.velocities[fold.joint] * REUSE_TIME > 0.5 * bend
            assert answer.reuse_time == (0.0 if passes else REUSE_TIME)
            told.add(passes)
            resolver.reset()
    assert told == {False, True}
