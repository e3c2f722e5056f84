"""Poses at which a goal's points have the same image as at the goal, and their distinction."""

import numpy as np
import pytest

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.diagnosis.ambiguous_poses import AmbiguousPoses
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.observation import Observation

CAMERA = CameraModel(320, 240, (300.0, 0.0, 160.0, 0.0, 300.0, 120.0, 0.0, 0.0, 1.0), ())
TRIANGLE = np.array([[-0.15, -0.1], [0.2, -0.05], [0.02, 0.18]])
PLANE = Plane(0.9, -0.6, 2.0)  # at 0.5 m, tilted
WORLD_T_GOAL = matrix_from_xyz_rpy((0.3, -0.2, 0.9), (2.8, 0.3, 0.7))


def goal_of(points, plane=PLANE, k=1.0):
    plane = Plane(*(np.array(plane) / k))
    pose = WORLD_T_GOAL.copy()
    pose[:3, 3] *= k
    return Goal(features={"points": {"points": np.asarray(points).tolist()}}, plane=plane,
                world_T_camera=pose)  # fmt: skip


def seen(corners, plane, accuracy=0.0):
    corners = None if corners is None else np.asarray(corners)
    return Observation(0.0, 0.0, True, "", CAMERA, corners=corners, plane=plane,
                       corner_accuracy=accuracy)  # fmt: skip


def test_three_points_look_alike_from_other_poses():
    found = AmbiguousPoses(goal_of(TRIANGLE))
    assert found.poses
    for pose in found.poses:
        np.testing.assert_allclose(pose.points, TRIANGLE, atol=1e-9)
        # sides of the triangle are as long as before
        sides = []
        for points, plane in ((TRIANGLE, PLANE), (pose.points, pose.plane)):
            rays = np.column_stack([points, np.ones(3)])
            places = rays / (rays @ np.array(plane))[:, None]
            lengths = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)
            sides.append(np.sort(lengths))
        np.testing.assert_allclose(*sides, rtol=1e-6)
        assert found.find_pose(seen(TRIANGLE, Plane(*pose.plane)))[0] is pose
    assert found.find_pose(seen(TRIANGLE, PLANE)) == (None, ())
    nearest, open_ = found.find_pose(seen(TRIANGLE, None))  # nothing tells the plane
    assert nearest is None and open_ == found.poses
    scaled = AmbiguousPoses(goal_of(TRIANGLE, k=7.0)).poses
    for one, other in zip(found.poses, scaled, strict=True):
        assert other.distance == pytest.approx(7.0 * one.distance, rel=1e-4)
        assert other.angle == pytest.approx(one.angle, rel=1e-4)


def test_a_target_that_is_turned_in_its_plane_is_at_no_other_pose():
    """Kinematics have the plane where it was, whatever the target's place in it."""
    found = AmbiguousPoses(goal_of(TRIANGLE))
    goal = found.goal
    normal = np.array(PLANE) / np.linalg.norm(PLANE)
    turned = matrix_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    turned[:3, 3] = np.cross(normal, (0.0, 0.1, 0.3))  # along the plane
    plane = goal.compute_plane(goal.world_T_camera @ turned)
    assert found.find_pose(seen(TRIANGLE, plane)) == (None, ())


SMALL = np.array([[-0.03, -0.02], [0.035, -0.025], [0.03, 0.028], [-0.02, 0.02]])


def test_a_small_quadrilateral_looks_nearly_alike_from_the_mirrored_tilt():
    found = AmbiguousPoses(goal_of(SMALL))
    (pose,) = found.poses
    off = np.abs(pose.points - SMALL).max()
    assert 1e-5 < off < 5e-3 and pose.angle > 0.3
    assert AmbiguousPoses(goal_of(10.0 * SMALL)).poses == ()  # a wide view tells the two apart
    # by the plane, or, where nothing tells that, by the image if it shows the difference
    assert found.find_pose(seen(SMALL, Plane(*pose.plane)))[0] is pose
    assert found.find_pose(seen(pose.points, None, 0.01 * off))[0] is pose
    assert found.find_pose(seen(SMALL, None, 0.01 * off)) == (None, ())
    assert found.find_pose(seen(SMALL, None, 10.0 * off)) == (None, (pose,))
    assert found.find_pose(seen(None, None)) == (None, (pose,))


def test_a_square_s_other_headings_are_no_other_poses():
    """It looks exactly alike after a quarter of a turn: `up_to` says so."""
    square = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])
    assert AmbiguousPoses(goal_of(square, Plane(0.0, 0.0, 2.0))).poses == ()


@pytest.mark.parametrize("goal", [
    Goal(depth=0.5), goal_of(np.column_stack([np.linspace(-0.1, 0.1, 4), np.zeros(4)])),
    goal_of(TRIANGLE, Plane(0.0, 0.0, -2.0)),
])  # fmt: skip
def test_without_points_of_a_plane_in_view_there_are_none(goal):
    assert AmbiguousPoses(goal).poses == ()
