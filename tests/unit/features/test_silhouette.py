"""Plane of a solid's outline, compared with geometry by hand."""

import numpy as np
import pytest

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy
from aras_visual_servo_camera import silhouette
from aras_visual_servo_camera.errors import TrackingModelError

BOX = np.array([(x, y, z) for z in (-0.03, 0.03) for y in (-0.025, 0.025) for x in (-0.04, 0.04)])


def test_the_plane_of_an_outline_of_points():
    tilted = matrix_from_xyz_rpy((0.004, -0.002, 0.3), (np.pi - 0.02, 0.03, 0.4))  # camera_T_box
    points = BOX @ tilted[:3, :3].T + tilted[:3, 3]
    top = points[BOX[:, 2] > 0.0]
    assert sorted(map(tuple, silhouette.find_silhouette_points(points))) == sorted(map(tuple, top))
    plane, deviation = silhouette.fit_rim(points)
    assert np.array(plane) @ top.T == pytest.approx(np.ones(4))
    assert deviation < 1e-12
    middle, radius = np.array([0.06, -0.04, 0.35]), 0.05
    around = np.random.default_rng(3).normal(size=(40_000, 3))
    points = middle + radius * around / np.linalg.norm(around, axis=1)[:, None]
    plane, deviation = silhouette.fit_rim(points)
    # The rays that touch it: middle . X = |middle|^2 - radius^2.
    polar = middle / (middle @ middle - radius**2)
    assert np.array(plane) == pytest.approx(polar, rel=3e-3, abs=6e-3)
    assert deviation < 2e-3
    # Four corners in turn at 1/Z = 4 and 3: the plane is 3.5, and in between 1/Z is linear.
    seen = np.array([(0.1, 0.1, 1.0), (-0.1, 0.1, 1.0), (-0.1, -0.1, 1.0), (0.1, -0.1, 1.0)])
    points = seen / np.array([4.0, 3.0, 4.0, 3.0])[:, None]
    plane, deviation = silhouette.fit_rim(points)
    assert np.array(plane) == pytest.approx([0.0, 0.0, 3.5], abs=1e-3)
    # The mean of (3.5 / n - 1)^2 for n from 3 to 4.
    rms = np.sqrt(12.25 / 12.0 - 7.0 * np.log(4.0 / 3.0) + 1.0)
    assert deviation == pytest.approx(rms, rel=1e-3)
    silhouette.fit_outline_plane(points, "box.stl")


def test_planes_of_solids_and_one_that_there_is_not():
    solid = matrix_from_xyz_rpy((0.3, -0.2, 0.05), (0.2, -0.1, 0.7))
    camera = matrix_from_xyz_rpy((0.28, -0.17, 0.4), (np.pi - 0.1, 0.05, -0.4))
    points = (np.column_stack([BOX, np.ones(8)]) @ (inverse(camera) @ solid).T)[:, :3]
    found = silhouette.OutlinePlaneFitter(BOX, solid, "box.stl").compute_plane(camera)
    assert found == pytest.approx(silhouette.fit_outline_plane(points, "box.stl"))
    long = BOX * (1.0, 1.0, 4.0)
    askew = matrix_from_xyz_rpy((0.03, 0.03, 0.34), (np.pi - 0.3, 0.1, 0.0))
    points = long @ askew[:3, :3].T + askew[:3, 3]
    with pytest.raises(TrackingModelError, match=r"visible outline of box.stl .*deviates by 16 %"):
        silhouette.fit_outline_plane(points, "box.stl")
    with pytest.raises(TrackingModelError, match="behind the camera"):
        silhouette.fit_rim(points - (0.0, 0.0, 0.35))
