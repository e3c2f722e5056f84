"""Poses and rotations: conversions are inverse to each other and agree with SciPy."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from aras_visual_servo_base import poses

ANGLES = st.floats(-math.pi, math.pi) | st.sampled_from([0.0, math.pi / 2, -math.pi / 2, math.pi])
TINY = st.sampled_from([0.0, 1e-12, -1e-9, 1e-7, 1e-5, 1e-3])
PLACES = st.tuples(*[st.floats(-5.0, 5.0)] * 3)
TURNS = st.tuples(ANGLES, ANGLES, ANGLES)
POSES = st.builds(poses.matrix_from_xyz_rpy, PLACES, TURNS)


@st.composite
def rotation_vectors(draw):
    """(3,) with an angle from nothing to half a turn, both ends and their neighbourhood often."""
    axis = np.array(draw(st.tuples(*[st.floats(-1.0, 1.0)] * 3)))
    size = np.linalg.norm(axis)
    axis = np.array([0.6, 0.0, -0.8]) if size < 1e-3 else axis / size
    angle = draw(st.floats(0.0, math.pi) | TINY.map(abs) | TINY.map(lambda x: math.pi - abs(x)))
    return angle * axis


@given(POSES, POSES, POSES)
def test_frames_compose(a, b, c):
    np.testing.assert_allclose(poses.inverse(a) @ a, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(poses.relative_pose(a, b), np.linalg.inv(a) @ b, atol=1e-12)
    distance, angle = poses.pose_difference(a, b)
    turn = Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).magnitude()
    assert (distance, angle) == pytest.approx((np.linalg.norm(a[:3, 3] - b[:3, 3]), turn), abs=1e-7)
    straight = poses.pose_difference(a, c)
    over_b = np.add(poses.pose_difference(a, b), poses.pose_difference(b, c))
    assert (np.array(straight) <= over_b + 1e-7).all()
    assert poses.pose_difference(b, a) == pytest.approx(poses.pose_difference(a, b), abs=1e-7)


@given(PLACES, TURNS)
@example((1.0, 2.0, 3.0), (0.3, math.pi / 2, -0.4))
@example((1.0, 2.0, 3.0), (0.3, -math.pi / 2, 2.5))
def test_roll_pitch_yaw_come_back_as_the_same_attitude(xyz, rpy):
    pose = poses.matrix_from_xyz_rpy(xyz, rpy)
    np.testing.assert_allclose(
        pose[:3, :3], Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(poses.Pose.from_rpy(xyz, rpy).matrix(), pose, atol=1e-14)
    place, angles = poses.xyz_rpy_from_matrix(pose)
    assert tuple(place) == xyz and all(type(angle) is float for angle in angles)
    again = poses.Pose(xyz, poses.quaternion_from_rpy(*rpy)).rpy
    np.testing.assert_allclose(poses.matrix_from_xyz_rpy(place, again), pose, atol=1e-7)
    np.testing.assert_allclose(poses.matrix_from_xyz_rpy(place, angles), pose, atol=1e-7)
    if abs(abs(rpy[1]) - math.pi / 2) > 1e-3:
        np.testing.assert_allclose(poses.matrix_from_xyz_rpy(place, angles), pose, atol=1e-12)


@given(TURNS, PLACES)
def test_quaternions_are_scipys(rpy, vector):
    q = poses.quaternion_from_rpy(*rpy)
    scipys = Rotation.from_euler("xyz", rpy)
    assert abs(np.dot(q, scipys.as_quat())) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(poses.rotate(q, vector), scipys.apply(vector), atol=1e-12)
    back = poses.quaternion_from_matrix(poses.rotation_from_quaternion(q))
    assert abs(np.dot(q, back)) == pytest.approx(1.0, abs=1e-12)
    unit = poses.multiply(q, poses.conjugate(q))
    np.testing.assert_allclose(unit, (0.0, 0.0, 0.0, 1.0), atol=1e-12)


@given(PLACES, rotation_vectors())
def test_the_logarithm_undoes_the_exponential(velocity, turn):
    moved = poses.exponential((*velocity, *turn))
    again = Rotation.from_rotvec(poses.rotation_vector(moved[:3, :3])).as_matrix()
    np.testing.assert_allclose(again, moved[:3, :3], atol=1e-11)
    np.testing.assert_allclose(moved[:3, :3], Rotation.from_rotvec(turn).as_matrix(), atol=1e-12)
    again = poses.exponential(poses.logarithm(moved))
    np.testing.assert_allclose(again, moved, atol=1e-6)
    if np.linalg.norm(turn) < math.pi - 1e-2:
        np.testing.assert_allclose(poses.logarithm(moved), (*velocity, *turn), atol=1e-6)


@given(POSES, PLACES, rotation_vectors())
def test_the_adjoint_takes_twists_to_another_frame(a_T_b, velocity, turn):
    """Moving by a twist of b is moving by its adjoint, seen from a."""
    twist = np.array((*velocity, *turn))
    moved = a_T_b @ poses.exponential(twist) @ poses.inverse(a_T_b)
    np.testing.assert_allclose(
        poses.exponential(poses.adjoint(a_T_b) @ twist), moved, atol=1e-9)


@given(rotation_vectors(), PLACES)
def test_the_rate_of_a_rotation_vector_is_its_derivative(turn, omega):
    if np.linalg.norm(turn) > math.pi - 0.05:
        return
    step, ahead = 1e-6, Rotation.from_rotvec(turn)
    ends = [(ahead * Rotation.from_rotvec(np.array(omega) * s)).as_rotvec() for s in (-step, step)]
    measured = (ends[1] - ends[0]) / (2.0 * step)
    np.testing.assert_allclose(
        poses.rotation_vector_rate(turn) @ omega, measured, rtol=1e-4, atol=1e-5)
