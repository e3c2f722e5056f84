"""Poses and twists, compared with their definitions; rotations: unit/properties/test_poses.py."""

import math

import numpy as np
import pinocchio
import pytest
from scipy.linalg import expm

from aras_visual_servo_base.pose_checks import check_pose, check_vector
from aras_visual_servo_base.poses import (
    LINK_R_OPTICAL,
    Pose,
    exponential,
    inverse,
    logarithm,
    matrix_from_xyz_rpy,
    optical_pose,
    quaternion_from_z_to,
    rotate,
    rotation_vector,
    rotation_vector_rate,
    skew,
)

TURNS = [0.0, 1e-9, 3e-8, 1e-5, 1e-3, 0.5, 3.0, np.pi - 1e-5, np.pi - 1e-7]  # rad
AXIS = np.array([1.0, -2.0, 0.5]) / np.sqrt(5.25)
A = matrix_from_xyz_rpy((1.0, -2.0, 0.5), (0.3, -0.8, 2.5))
B = matrix_from_xyz_rpy((-0.4, 0.7, 3.0), (-1.1, 0.6, 0.2))


def moved(twist):
    """(4, 4) after one second of a body twist (6,), by the series of the matrix exponential."""
    turning = np.cross(twist[3:], np.eye(3)).T  # turning @ p is omega x p
    return expm(np.block([[turning, np.c_[twist[:3]]], [np.zeros((1, 4))]]))


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (0.0, 0.0, -1.0)])
def test_z_is_turned_onto_a_direction(direction):
    assert rotate(quaternion_from_z_to(direction), (0.0, 0.0, 1.0)) == pytest.approx(direction)


def test_poses_of_floats_are_those_of_arrays():
    a, b = Pose.from_matrix(A), Pose.from_matrix(B)
    np.testing.assert_allclose(a.matrix(), A, atol=1e-15)
    np.testing.assert_allclose((a @ b).matrix(), A @ B, atol=1e-14)
    np.testing.assert_allclose(a.inverse().matrix(), inverse(A), atol=1e-14)
    assert a.apply((3.0, 1.0, -2.0)) == pytest.approx((A @ (3.0, 1.0, -2.0, 1.0))[:3])


def test_the_optical_frame_looks_along_the_link():
    seen = optical_pose(A)
    np.testing.assert_array_equal(seen[:3, 2], A[:3, 0])  # forward
    np.testing.assert_array_equal(seen[:3, 0], -A[:3, 1])  # right
    np.testing.assert_array_equal(seen[:3, 1], -A[:3, 2])  # down
    np.testing.assert_array_equal(seen[:3, 3], A[:3, 3])
    with pytest.raises(ValueError, match="read-only"):
        LINK_R_OPTICAL[0, 0] = 1.0


def test_rotations_at_and_near_half_a_turn():
    for axis in np.eye(3):
        turn = rotation_vector(2.0 * np.outer(axis, axis) - np.eye(3))
        np.testing.assert_allclose(np.abs(turn), math.pi * axis, atol=1e-12)
    turn, v, w = 3.1 * AXIS, np.array([0.3, -1.1, 0.7]), np.array([2.0, 0.4, -0.9])
    np.testing.assert_allclose(rotation_vector_rate(turn), pinocchio.Jlog3(pinocchio.exp3(turn)),
                               atol=1e-12)
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-15)


@pytest.mark.parametrize("angle", TURNS)
def test_motions_of_constant_twists_and_their_logarithms(angle):
    twist = np.array([0.4, -0.1, 0.7, *(angle * AXIS)])
    after = moved(twist)
    np.testing.assert_allclose(exponential(twist), after, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(logarithm(after), twist, rtol=0.0, atol=1e-13)


class VectorError(Exception):
    """Error class of a caller."""


@pytest.mark.parametrize(("values", "words"), [
    (3.0, "pull: 3.0 is not a sequence of 3 numbers"), ((1, "a", 2), "not a sequence of 3"),
    ((1.0, 2.0), "pull: needs 3 numbers, got 2"), ((1.0, math.nan, 0.0), "not finite"),
])  # fmt: skip
def test_vectors_are_checked(values, words):
    with pytest.raises(VectorError, match=words):
        check_vector(values, "pull", VectorError)
    assert check_vector([1, 2, 3, 4], "plane", VectorError, 4) == (1.0, 2.0, 3.0, 4.0)


def test_poses_are_checked():
    pose = check_pose(((1, 2, 3), (0, 0, 2, 0)), "model 'a'", VectorError)
    assert pose == Pose((1.0, 2.0, 3.0), (0.0, 0.0, 1.0, 0.0))
    nothing = (1, 2, 3), (0, 0, 0, 0)
    assert check_pose(nothing, "model 'a'", VectorError, zero_is_identity=True) == Pose((1, 2, 3))
    for wrong, words in ((nothing, r"not a unit quaternion; use \(0, 0, 0, 1\) for no"),
                         (((1, 2), (0, 0, 0, 1)), "position: needs 3 numbers"), (7, "is not")):
        with pytest.raises(VectorError, match=f"model 'a'.*{words}"):
            check_pose(wrong, "model 'a'", VectorError)
