"""The resolver: exact where it can be, bounded where it cannot, honest about the difference."""

import numpy as np
import pytest

from aras_visual_servo_controller.kinematics import GANTRY, J1, J2, J3, J6, Kinematics
from aras_visual_servo_controller.resolver import Resolver
from aras_visual_servo_controller.tasks import (
    JointLimitAvoidance,
    JointLimits,
    Posture,
    SingularityAvoidance,
)

BENT = np.array([0.1, 0.2, 0.4, -0.7, 0.3, 0.5])
KINEMATICS = Kinematics()
UP = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
DOWN = -UP


def level_twist(seed):
    """A twist of a level camera: no rotation but about the optical axis."""
    rng = np.random.default_rng(seed)
    return 0.05 * np.array([*rng.standard_normal(3), 0.0, 0.0, rng.standard_normal()])


@pytest.mark.parametrize("seed", range(5))
def test_asked_twist_is_given_away_from_singularities(seed):
    twist = level_twist(seed)
    resolution = Resolver(KINEMATICS).resolve(BENT, twist, dt=0.03)
    np.testing.assert_allclose(resolution.twist[[0, 1, 2, 5]], twist[[0, 1, 2, 5]], atol=1e-9)
    assert resolution.reasons == ()
    # The pitch stays what it was, but for the 1.8 mrad that the camera is mounted askew.
    assert abs(resolution.joint_velocities[2:5].sum()) < 2e-3 * abs(twist[5])


def test_pitch_rate_can_be_asked_for():
    axis = KINEMATICS.pitch_axis(BENT)
    twist = np.concatenate([np.zeros(3), 0.1 * axis])
    twist[5] = 0.0
    resolution = Resolver(KINEMATICS).resolve(BENT, twist, dt=0.03)
    assert resolution.joint_velocities[2:5].sum() == pytest.approx(0.1, abs=1e-3)
    np.testing.assert_allclose(resolution.twist[:3], 0.0, atol=1e-9)


def test_secondary_task_does_not_move_the_camera():
    resolver = Resolver(KINEMATICS, tasks=[Posture(J1, 0.0, gain=2.0)])
    resolution = resolver.resolve(BENT, np.zeros(6), dt=0.03)
    assert resolution.joint_velocities[J1] < -0.05  # back towards 0
    assert abs(resolution.joint_velocities[GANTRY]) > 1e-3  # the gantry makes room
    assert resolution.joint_velocities[J6] == pytest.approx(-resolution.joint_velocities[J1])
    np.testing.assert_allclose(resolution.twist, 0.0, atol=1e-9)


def test_singularity_gradient_raises_manipulability_and_leaves_the_camera_in_place():
    start = q = np.array([0.0, 1.5, 0.6, -0.3, -0.3, 0.0])
    task = SingularityAvoidance(KINEMATICS)
    resolver = Resolver(KINEMATICS, tasks=[task])
    before = task.manipulability(q)
    for _ in range(30):
        q = q + 0.03 * resolver.resolve(q, np.zeros(6), dt=0.03).joint_velocities
    assert task.manipulability(q) > before
    np.testing.assert_allclose(KINEMATICS.pose(q), KINEMATICS.pose(start), atol=1e-4)


@pytest.mark.parametrize("twist", [UP, DOWN])
def test_velocities_are_bounded_at_the_stretched_arm(twist):
    for bend in (0.0, -1e-6, -1e-3, -0.01, 0.02):
        q = np.array([0.0, 0.0, -0.4 * bend, bend, -0.6 * bend, 0.0])
        resolution = Resolver(KINEMATICS).resolve(q, 0.005 * twist, dt=0.03)
        assert np.isfinite(resolution.joint_velocities).all()
        assert np.abs(resolution.joint_velocities).max() <= 2.0


def integrate(q, height, seconds):
    """Drive the camera's height (m) alone with a proportional law; returns postures."""
    resolver, path, dt = Resolver(KINEMATICS), [q], 1.0 / 30.0
    for _ in range(round(seconds / dt)):
        q = path[-1]
        vz = -3.0 * (height - KINEMATICS.pose(q)[2, 3])
        twist = np.array([0, 0, vz, 0, 0, 0.0])
        path.append(q + dt * resolver.resolve(q, twist, dt).joint_velocities)
    return np.array(path)


def test_the_elbow_leaves_the_stretched_pose_on_its_side():
    goal = KINEMATICS.pose(np.zeros(6))[2, 3] + 0.005
    path = integrate(np.zeros(6), goal, 4.0)
    assert path[-1, J3] < -0.2
    assert KINEMATICS.pose(path[-1])[2, 3] == pytest.approx(goal, abs=2e-4)


@pytest.mark.parametrize("beyond", [0.0, 0.003])
def test_the_elbow_stretches_without_passing_straight(beyond):
    goal = KINEMATICS.pose(np.zeros(6))[2, 3] - beyond
    path = integrate(np.array([0.0, 0.0, 0.2, -0.5, 0.3, 0.0]), goal, 6.0)
    assert (path[:, J3] < 1e-6).all()
    assert KINEMATICS.pose(path[-1])[2, 3] - goal == pytest.approx(beyond, abs=3e-4)
    assert abs(KINEMATICS.pitch(path[-1])) < 5e-3


def test_speed_limits_slow_the_whole_motion_and_keep_its_direction():
    twist = np.array([0.3, -2.0, 0.1, 0, 0, 0.2])
    resolution = Resolver(KINEMATICS).resolve(BENT, twist, dt=0.03)
    assert 0.0 < resolution.scale < 1.0
    np.testing.assert_allclose(
        resolution.twist[:3] / np.linalg.norm(resolution.twist[:3]),
        twist[:3] / np.linalg.norm(twist[:3]),
        atol=0.1,
    )
    assert "slowed to" in resolution.reasons[-1]
    limits = np.asarray(JointLimits.velocity)
    assert (np.abs(resolution.joint_velocities) <= limits + 1e-12).all()


def test_a_joint_at_its_limit_stops_and_the_redundancy_takes_over():
    limits = JointLimits(upper=(0.1, 2.0, 2.0, 2.0, 2.0, 3.0))
    q = BENT.copy()  # the gantry stands at its limit of 0.1
    resolver = Resolver(KINEMATICS, limits, tasks=[])
    along_gantry = np.zeros(6)
    along_gantry[:3] = KINEMATICS.pose(q)[:3, :3].T @ (0.02, 0.0, 0.0)
    resolution = resolver.resolve(q, along_gantry, dt=0.03)
    assert resolution.joint_velocities[GANTRY] == 0.0
    np.testing.assert_allclose(resolution.twist[:3], along_gantry[:3], atol=1e-9)  # by J1
    assert resolution.reasons == ("gantry stopped at its limit of 0.1000",)


def test_a_joint_goes_on_to_its_limit_and_not_beyond():
    limits = JointLimits(upper=(1.5, 2.0, 0.401, 2.0, 2.0, 3.0))
    twist = KINEMATICS.jacobian(BENT) @ np.array([0, 0, 0.05, 0, -0.05, 0])
    resolution = Resolver(KINEMATICS, limits).resolve(BENT, twist, dt=0.1)
    assert BENT[J2] + 0.1 * resolution.joint_velocities[J2] == pytest.approx(0.401)


def test_limit_avoidance_pushes_only_inside_its_margin():
    task = JointLimitAvoidance(JointLimits(), margin=0.2, gain=2.0)
    np.testing.assert_array_equal(task.velocity(np.zeros(6)), np.zeros(6))
    q = np.array([1.4, 0, 0, -2.0, 0, 0])
    velocity = task.velocity(q)
    assert velocity[GANTRY] == pytest.approx(-0.2)
    assert velocity[J3] == pytest.approx(2.0 * (2.0 - 2.0943 + 0.2))


def test_not_finite_is_refused():
    with pytest.raises(ValueError, match="not finite"):
        Resolver(KINEMATICS).resolve(np.full(6, np.nan), np.zeros(6), 0.03)


def test_limits_that_are_none_are_refused():
    with pytest.raises(ValueError, match="limits of J1"):
        JointLimits(lower=(-1, 3, -2, -2, -2, -3))
