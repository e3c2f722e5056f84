"""Pose of a plane from inexact points: no other pose has a smaller error."""

import numpy as np
import pytest
from feature_scenes import CORNERS, GOAL, VIEWS, places, seen
from free_camera import pose
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from aras_visual_servo_controller import FEATURES, ConfigurationError, Goal, MeasurementError
from aras_visual_servo_controller.features import pose as features
from aras_visual_servo_controller.features.pose import estimate_planar_pose


def offsets(pose, there, points):
    """Return how far (2n,) points (n, 3), projected at a pose (4, 4), are from points (n, 2)."""
    P = there @ pose[:3, :3].T + pose[:3, 3]
    return (P[:, :2] / P[:, 2:] - points).ravel()


@pytest.mark.parametrize("view", range(len(VIEWS)))
def test_noisy_points_give_the_pose_of_least_squares(view):
    there, exact = places(GOAL), VIEWS[view] @ np.linalg.inv(GOAL)
    points = seen(VIEWS[view]) + np.random.default_rng(view).normal(0.0, 5e-4, (len(CORNERS), 2))
    found = estimate_planar_pose(there, points)

    def moved(step):
        return pose(step[:3], step[3:]) @ exact

    exactly = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    best = least_squares(lambda x: offsets(moved(x), there, points), np.zeros(6), **exactly)
    assert np.abs(found - moved(best.x)).max() < 2e-6
    assert np.abs(found - exact).max() > 1e-5  # the noise is felt
    frame = pose((1.5, -2.0, 0.7), (0.6, -1.1, 2.3))  # whichever the places are told in
    elsewhere = there @ frame[:3, :3].T + frame[:3, 3]
    assert np.abs(estimate_planar_pose(elsewhere, points) @ frame - found).max() < 1e-9


def anywhere(seed, count):
    random = np.random.default_rng(seed)
    for side in np.tile([0.0, np.pi], count)[:count]:
        aslant = Rotation.from_euler("zxz", [random.uniform(-np.pi, np.pi),
                                             side + random.uniform(-1.0, 1.0),
                                             random.uniform(-np.pi, np.pi)])  # fmt: skip
        yield pose((*random.uniform(-0.1, 0.1, 2), random.uniform(0.4, 1.2)), aslant.as_rotvec())


def test_the_homography_alone_gives_the_pose_of_exact_points():
    random = np.random.default_rng(2)
    for place, count in zip(anywhere(0, 30), np.tile([4, 5, 6, 7, 8], 6), strict=True):
        flat = np.column_stack([random.uniform(-0.1, 0.1, (count, 2)), np.zeros(count)])
        found = estimate_planar_pose(places(GOAL, flat), seen(place, flat), iterations=0)
        np.testing.assert_allclose(found, place @ np.linalg.inv(GOAL), atol=1e-8)


@pytest.mark.parametrize("off", [0.02 * np.ones(6), -0.02 * np.ones(6), 0.1 * np.eye(6)[2]])
def test_the_nearest_pose_is_found_from_whichever_side_it_is_come_to(off):
    """Where every step is ahead, or back, or along the axis of a square alone."""
    square = 0.1 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    there = places(pose((0, 0, 1.0), (0, 0, 0)), square)
    begin = pose(off[:3], off[3:])
    found = features.refine_pose(begin[:3, :3], begin[:3, 3], there, there[:, :2] / there[:, 2:])
    np.testing.assert_allclose(found, np.eye(4), atol=1e-10)


@pytest.mark.parametrize("points", [
    [[-0.1, 0.03], [0.0, 0.02], [0.1, 0.01], [0.2, 0.0]], [[0.1, -0.2]] * 4,
])  # fmt: skip
def test_points_on_one_line_or_in_one_place_give_no_pose(points):
    with pytest.raises(MeasurementError, match="give no pose: they lie on one line"):
        estimate_planar_pose(places(GOAL), np.array(points))
    with pytest.raises(ConfigurationError, match="a pose needs four points that are not on one"):
        FEATURES.create("pose").check(Goal(depth=0.5, features={"pose": {"points": points}}))
    along, across = np.array([-1.0, -1.0, 1.0, 1.0]), np.array([1.0, -1.0, 1.0, -1.0])
    for thin, refused in ((0.9e-9, True), (1.1e-9, False)):  # thinner than a rounding
        assert features.are_collinear(np.column_stack([along, thin * across])) is refused
    # one comes from behind where the second and the third are taken for each other
    with pytest.raises(MeasurementError, match="give a pose behind the camera"):
        estimate_planar_pose(places(GOAL), seen(GOAL)[[0, 2, 1, 3]])
