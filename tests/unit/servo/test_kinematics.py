"""Closed-form kinematics against the robot's joint table and against finite differences."""

import numpy as np
import pytest

from aras_visual_servo_controller.errors import UnreachableError
from aras_visual_servo_controller.kinematics import (
    J1,
    J3,
    JOINT_NAMES,
    Kinematics,
    link_mounting,
    pose_difference,
    transform,
)

# The joint table of the URDF: origin xyz, origin rpy, axis (None: fixed), in chain order.
CHAIN = (
    ("gantry", (0, 0, 1.6263), (1.5708, 0, -1.5708), (0, 0, -1)),
    (None, (0, -0.02888, 0), (-1.5708, 0, 3.1416), None),
    ("J1", (0, 0, 0.168), (0, 0, 0), (0, 0, 1)),
    ("J2", (0, 0, 0.132), (0, 0, 0), (0, 1, 0)),
    ("J3", (0, 0, 0.25), (0, 0, 0), (0, 1, 0)),
    ("J5", (0, 0, 0.16), (0, 0, 3.1416), (0, -1, 0)),
    ("J6", (0, 0, 0.0718), (0, 0, -3.1416), (0, 0, 1)),
    (None, (0, 0, 0.0334), (3.14, -1.57, 0), None),
)
CAMERA_TO_OPTICAL = (-np.pi / 2, 0.0, -np.pi / 2)
NOT_MOVED = np.eye(4)
MOVED = transform((0.01, 0.03, -0.02), (0.3, 0.17, -0.4))  # camera_link in where it was


def turned(rotation):
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


def about(axis, angle):
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], float)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def urdf_pose(q, moved):
    """world_T_optical from the URDF's joints one by one, then the camera's move (4, 4)."""
    joints = dict(zip(JOINT_NAMES, q, strict=True))
    pose = np.eye(4)
    for name, xyz, rpy, axis in CHAIN:
        pose = pose @ transform(xyz, rpy)
        if name == "gantry":
            pose = pose @ transform(np.array(axis) * joints[name], (0, 0, 0))
        elif name is not None:
            pose = pose @ turned(about(axis, joints[name]))
    return pose @ moved @ transform((0, 0, 0), CAMERA_TO_OPTICAL)


def random_joints(seed, count=40):
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (count, 6))


def of_camera(moved):
    """Kinematics of the robot with its camera moved on its mount (4, 4)."""
    _, xyz, rpy, _ = CHAIN[-1]
    return Kinematics(mounting=link_mounting(transform(xyz, rpy) @ moved))


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics()


@pytest.fixture(scope="module", params=[NOT_MOVED, MOVED], ids=["stock", "moved"])
def anywhere(request):
    return of_camera(request.param)


def test_the_robots_own_mounting_is_the_urdfs(kinematics):
    np.testing.assert_array_equal(kinematics.mounting, of_camera(NOT_MOVED).mounting)


@pytest.mark.parametrize("moved", [NOT_MOVED, MOVED], ids=["stock", "moved"])
def test_pose_equals_the_urdf_chain(moved):
    for q in [np.zeros(6), *random_joints(1)]:
        # The URDF writes right angles with five digits: that alone is worth some 10 um.
        pose = of_camera(moved).pose(q)
        np.testing.assert_allclose(pose, urdf_pose(q, moved), atol=3e-5)


def test_camera_at_zero_looks_down_from_782_mm(kinematics):
    pose = kinematics.pose(np.zeros(6))
    np.testing.assert_allclose(pose[:3, 3], (0, 0, 0.78222), atol=1e-6)
    np.testing.assert_allclose(pose[:3, 2], (0, 0, -1), atol=2e-3)
    np.testing.assert_allclose(pose[:3, 0], (1, 0, 0), atol=2e-3)


def test_jacobian_equals_finite_differences(anywhere):
    step = 1e-6
    for q in random_joints(2):
        jacobian = anywhere.jacobian(q)
        rotation = anywhere.pose(q)[:3, :3]
        for joint in range(6):
            delta = np.zeros(6)
            delta[joint] = step
            after, before = anywhere.pose(q + delta), anywhere.pose(q - delta)
            linear = rotation.T @ (after[:3, 3] - before[:3, 3]) / (2 * step)
            spin = rotation.T @ (after[:3, :3] - before[:3, :3]) / (2 * step)
            angular = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            np.testing.assert_allclose(jacobian[:3, joint], linear, atol=1e-8)
            np.testing.assert_allclose(jacobian[3:, joint], angular, atol=1e-8)


def test_pitch_axis_is_what_the_pitch_joints_turn_about(anywhere):
    for q in random_joints(3):
        np.testing.assert_allclose(anywhere.jacobian(q)[3:, J3], anywhere.pitch_axis(q))


def test_inverse_returns_to_the_same_camera_pose(anywhere):
    rng = np.random.default_rng(4)
    for _ in range(40):
        q = rng.uniform(-0.8, 0.8, 6)
        q[J3] = -abs(q[J3])
        again = anywhere.inverse(
            anywhere.pose(q)[:3, 3], anywhere.yaw(q), anywhere.pitch(q), q[J1]
        )
        np.testing.assert_allclose(again, q, atol=1e-7)


def test_inverse_of_the_stretched_pose_is_finite(kinematics):
    q = kinematics.inverse(kinematics.pose(np.zeros(6))[:3, 3], yaw=0.0)
    assert np.isfinite(q).all()
    np.testing.assert_allclose(q, np.zeros(6), atol=1e-6)


def test_inverse_refuses_what_the_arm_cannot_reach(kinematics):
    with pytest.raises(UnreachableError, match="10.00 mm outside the reach") as caught:
        kinematics.inverse((0.0, 0.0, 0.78222 - 0.01), yaw=0.0)
    assert caught.value.excess == pytest.approx(0.01, abs=1e-9)
    with pytest.raises(UnreachableError, match="along the gantry"):
        kinematics.inverse((0.0, 0.0, 0.8), yaw=0.0, shoulder_angle=np.pi / 2)


def test_zero_pose_has_no_vertical_velocity(kinematics):
    down = kinematics.jacobian(np.zeros(6))[2]
    assert np.abs(down).max() < 1e-3  # only the mounting's tilt of 0.8 mrad


def test_pose_difference_is_exact_for_small_angles():
    b = transform((3e-4, 0, 4e-4), (0, 0, 1e-7))
    distance, angle = pose_difference(np.eye(4), b)
    assert distance == pytest.approx(5e-4)
    assert angle == pytest.approx(1e-7)
