"""Geometry of targets, compared with projections by hand; and their motion."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment import cameras
from aras_visual_servo_bench.targets.geometry import (
    PlacedTarget,
    PolygonTarget,
    PoseHistory,
    TargetMotion,
)
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.moments import Moments

SQUARE = PolygonTarget(((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)))
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])  # looks along the target's -z, x to the right


def above(x=0.0, y=0.0, z=0.5):
    pose = DOWN.copy()
    pose[:3, 3] = x, y, z
    return pose


def test_the_plane_gives_every_corners_depth():
    pose = above(0.1, -0.05, 0.6)
    pose[:3, :3] = pose[:3, :3] @ [[1, 0, 0], [0, np.cos(0.3), -np.sin(0.3)],
                                   [0, np.sin(0.3), np.cos(0.3)]]  # fmt: skip
    a, b, c = SQUARE.plane(pose)
    seen = (SQUARE.vertices() - pose[:3, 3]) @ pose[:3, :3]
    x, y = SQUARE.outline(pose).T
    np.testing.assert_allclose(1.0 / (a * x + b * y + c), seen[:, 2])


def test_a_target_moves_about_its_own_origin():
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 0.0, 0.0
    motion = TargetMotion((0.1, 0, 0, 0, 0, np.pi), (0.0, 0.02, 0.0), 0.25, begin=1.0)
    target = PlacedTarget(SQUARE, pose, motion)
    np.testing.assert_array_equal(target.world_T_target(0.9), pose)
    moved = target.world_T_target(2.0)
    np.testing.assert_allclose(moved[:3, 3], [1.1, 0.02, 0.0], atol=1e-12)
    np.testing.assert_allclose(moved[:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    np.testing.assert_allclose(
        target.world_T_target(2.0) @ target.target_T_camera(above(), 2.0), above(), atol=1e-12)
    moving = PlacedTarget(SQUARE, pose, TargetMotion((0.1, 0, 0, 0, 0, 0)))
    # without a time, at 0 s
    np.testing.assert_allclose(pose @ moving.target_T_camera(above()), above(), atol=1e-12)
    for kind in ({"velocity": (0.0,) * 5 + (0.1,)}, {"step": (0.0, 0.0, 0.1)},
                 {"amplitude": (0.0, 0.1, 0.0), "frequency": 1.0},
                 {"circle": 0.1, "frequency": 1.0}, {"path": ((1.0, 0.1, 0.0, 0.0),)}):
        assert not TargetMotion(**kind).is_static
    assert TargetMotion(begin=3.0, hold=1.0, frequency=2.0).is_static


def test_a_drawn_picture_has_the_outlines_moments():
    """Straight edges are curves to a fisheye."""
    K = (105.0, 0.0, 159.5, 0.0, 105.0, 119.5, 0.0, 0.0, 1.0)
    camera = CameraModel(320, 240, K, (0.0,) * 4, "equidistant")
    outline = SQUARE.outline(above(0.03, 0.02, 0.45))
    dark = cameras.WHITE_LEVEL - cameras.draw_outline(outline, camera).astype(float)
    area = dark / (cameras.WHITE_LEVEL - cameras.DARK_LEVEL) * camera.tables.area
    exact = Moments.from_polygon(outline, 2)
    x, y = (grid.ravel() for grid in (camera.tables.x, camera.tables.y))
    seen = Moments.from_samples(x, y, area.ravel(), 2)
    assert seen.m00 == pytest.approx(exact.m00, rel=2e-3)
    assert (seen.xg, seen.yg) == pytest.approx((exact.xg, exact.yg), abs=2e-4)


EVERYTHING = TargetMotion(
    velocity=(0.1, -0.2, 0.3, 0.4, -0.5, 0.6), amplitude=(0.01, 0.02, -0.03), frequency=0.3,
    circle=0.05, step=(0.2, -0.1, 0.07), hold=0.75,
    path=((1.0, 0.1, 0.2, 0.3), (3.0, -0.1, 0.4, 0.2, 0.3, -0.2, 0.5)), begin=0.5)


@pytest.mark.parametrize("since", [0.0, 0.2, 0.74, 0.76, 1.0, 1.49, 1.51, 2.2, 2.9, 7.3])
def test_all_motions_are_one_on_top_of_the_other(since):
    pose = matrix_from_xyz_rpy((0.3, 0.2, 0.1), (0.1, 0.2, 0.3))
    swing, share = 2 * np.pi * 0.3 * since, np.clip((since - 1.0) / 2.0, 0.0, 1.0)
    first, last = np.array([0.1, 0.2, 0.3]), np.array([-0.1, 0.4, 0.2])
    on_path = since * first if since < 1.0 else first + share * (last - first)
    turn = share * Rotation.from_euler("xyz", (0.3, -0.2, 0.5)).as_rotvec()
    there = (np.array([0.1, -0.2, 0.3]) * since + np.array([0.01, 0.02, -0.03]) * np.sin(swing)
             + [0.05 * np.sin(swing), 0.05 * (1 - np.cos(swing)), 0] + on_path)
    if int(since // 0.75) in (0, 2, 8):
        there = there + [0.2, -0.1, 0.07]
    spin = Rotation.from_rotvec(np.array([0.4, -0.5, 0.6]) * since) * Rotation.from_rotvec(turn)
    for motion, step in ((EVERYTHING, 0.0), (dataclasses.replace(EVERYTHING, hold=0.0), None)):
        found = PlacedTarget(SQUARE, pose, motion).world_T_target(0.5 + since)
        wanted = there
        if step is None and int(since // 0.75) not in (0, 2, 8):
            wanted = there + [0.2, -0.1, 0.07]  # away for ever
        np.testing.assert_allclose(found[:3, 3] - pose[:3, 3], wanted, atol=1e-9)
        np.testing.assert_allclose(found[:3, :3], spin.as_matrix() @ pose[:3, :3], atol=1e-9)
        np.testing.assert_array_equal(PlacedTarget(SQUARE, pose, motion).world_T_target(0.49), pose)


def test_a_course_knows_the_pose_of_the_last_change():
    course = PoseHistory()
    poses = [matrix_from_xyz_rpy((k, 0.0, 0.0), (0.0, 0.0, 0.1 * k)) for k in range(3)]
    assert course.find_pose(5.0) is None
    for time, k in ((1.0, 0), (1.5, 0), (2.0, 1), (3.0, 2)):
        course.add(time, poses[k] + 1e-10)
    target = PlacedTarget(SQUARE, np.eye(4), TargetMotion(velocity=(1.0, 0, 0, 0, 0, 0)), course)
    np.testing.assert_allclose(target.world_T_target(0.5)[:3, 3], [0.5, 0, 0])  # not known yet
    for time, k in ((1.0, 0), (1.99, 0), (2.0 - 1e-8, 1), (2.5, 1), (3.0, 2), (9.0, 2)):
        np.testing.assert_allclose(target.world_T_target(time), poses[k], atol=1e-9)


@pytest.mark.parametrize(("path", "complaint"), [
    (((0.0, 0.1, 0.0, 0.0),), "times are 0 s, must be above 0 and increase"),
    (((2.0, 0.1, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), "times are 2, 1 s, must be above 0 and incre"),
    (((1.0, 0.1, 0.0),), r"waypoint \[1.0, 0.1, 0.0\], must be \[t, x, y, z\]")])  # fmt: skip
def test_a_path_that_is_none_is_refused(path, complaint):
    with pytest.raises(ExperimentError, match=complaint):
        TargetMotion(path=path)
    with pytest.raises(ExperimentError, match="at least 3"):
        PolygonTarget(((0.0, 0.0), (1.0, 0.0)))
