"""The pose of a plane from points that are not exact: where no other has a smaller error."""

import numpy as np
import pytest
from feature_scenes import CORNERS, GOAL, VIEWS, places
from free_camera import pose
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from aras_visual_servo_controller.features.pose import pose_of_plane


def offsets(pose, there, points):
    """By how much (2n,) places (n, 3) seen from a pose (4, 4) miss points (n, 2)."""
    P = there @ pose[:3, :3].T + pose[:3, 3]
    return (P[:, :2] / P[:, 2:] - points).ravel()


@pytest.mark.parametrize("view", range(len(VIEWS)))
def test_noisy_points_give_the_pose_of_least_squares(view):
    there = places(GOAL)
    exact = VIEWS[view] @ np.linalg.inv(GOAL)
    P = places(VIEWS[view])
    noise = np.random.default_rng(view).normal(0.0, 5e-4, (len(CORNERS), 2))
    points = P[:, :2] / P[:, 2:] + noise
    found = pose_of_plane(there, points)

    def moved(step):
        pose = exact.copy()
        pose[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix() @ exact[:3, :3]
        pose[:3, 3] += step[:3]
        return pose

    exactly = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    best = least_squares(lambda x: offsets(moved(x), there, points), np.zeros(6), **exactly)
    assert np.abs(found - moved(best.x)).max() < 2e-6
    assert np.abs(found - exact).max() > 1e-5  # the noise is felt
    frame = pose((1.5, -2.0, 0.7), (0.6, -1.1, 2.3))  # whichever the places are told in
    elsewhere = there @ frame[:3, :3].T + frame[:3, 3]
    assert np.abs(pose_of_plane(elsewhere, points) @ frame - found).max() < 1e-9
