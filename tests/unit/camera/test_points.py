"""Point clouds and depth images, compared with the projection and the scene."""

import numpy as np
import pytest
from scenes import link_pose, looking

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.camera.point_clouds import clip_depth, compute_points
from aras_sim_bridge.description import DepthDescription
from aras_sim_bridge.rendering import create_renderer

WIDE = {"lens": "equidistant", "horizontal_fov": 3.4}
OFF_CENTRE = {"camera_matrix": (80.0, 95.0, 40.0, 22.0)}


def cloud_of(bench, topics, **settings):
    """(sensor, frame, cloud) of a camera that looks at two boxes from aside."""
    bench.box([1.0, 1.0, 0.01], [0, 0, -0.01], "Gazebo/Red")
    bench.box([0.1, 0.2, 0.15], [0.1, 0.05, 0.15], "Gazebo/Blue")
    config = CameraConfig.from_mapping({
        "width": 64, "height": 48, "near": 0.01, "depth": True, "update_rate": 1000.0, **settings})
    sensor = CameraSensor(config, create_renderer("exact", bench.world))
    frame = sensor.capture(link_pose(POSE), 1_000_000)
    points = compute_points(sensor.compute_rays(), frame.depth, frame.image, topics)
    return sensor, frame, points


POSE = looking([0.5, -0.3, 0.9], [0.05, 0.0, 0.1])


@pytest.mark.parametrize("settings", [OFF_CENTRE, WIDE, {
    "distortion_coefficients": (-0.2, 0.05, 0.001, -0.002, 0.0)}])
def test_points_are_the_depth_along_the_pixels_rays(bench, settings):
    sensor, frame, points = cloud_of(bench, DepthDescription(), **settings)
    seen = np.isfinite(frame.depth)
    assert np.array_equal(seen, np.isfinite(points[..., 2])) and seen.sum() > 400
    xyz = points[seen][:, :3]
    v, u = np.nonzero(seen)
    projected = sensor.config.projection.project(xyz)
    np.testing.assert_allclose(projected, np.stack([u, v], 1), atol=2e-3)
    forward = settings is not WIDE
    depth = xyz[:, 2] if forward else np.linalg.norm(xyz, axis=1)
    np.testing.assert_allclose(depth, frame.depth[seen], rtol=2e-7)
    # They lie on the ground, or on a side of the box.
    world = xyz.astype(float) @ POSE[:3, :3].T + POSE[:3, 3]
    ground = abs(world[:, 2]) < 2e-6
    inside = (abs(world - [0.1, 0.05, 0.15]) < np.array([0.1, 0.2, 0.15]) + 2e-6).all(axis=1)
    assert (ground | inside).all() and ground.sum() > 100 and inside.sum() > 50


def test_colours_stand_where_point_cloud_libraries_look_for_them(bench):
    _, frame, points = cloud_of(bench, DepthDescription(), **OFF_CENTRE)
    bytes_ = points.view(np.uint8).reshape(48, 64, 32)
    assert np.array_equal(bytes_[..., 16:19], frame.image[..., ::-1])
    assert not bytes_[..., 19:].any() and not bytes_[..., 12:16].any()
    grey = np.full((48, 64), 0x1234, np.uint16)
    topics = DepthDescription()
    small = compute_points(np.ones((48, 64, 3), np.float32), frame.depth, grey, topics)
    assert (small.view(np.uint8).reshape(48, 64, 32)[..., 16:19] == 0x12).all()


def test_the_reach_of_a_camera():
    depth = np.array([[0.4, 0.5, 2.0, 3.0, np.inf, 70.0]], np.float32)
    nan = np.nan
    assert clip_depth(depth, DepthDescription()) is depth
    np.testing.assert_array_equal(
        clip_depth(depth, DepthDescription(nearest=0.4)), [[nan, 0.5, 2.0, 3.0, np.inf, 70.0]])
    np.testing.assert_array_equal(
        clip_depth(depth, DepthDescription(nearest=0.45, farthest=3.0)),
        [[nan, 0.5, 2.0, nan, nan, nan]])
    millimetres = clip_depth(depth, DepthDescription(nearest=0.4, millimetres=True))
    assert millimetres.dtype == np.uint16
    np.testing.assert_array_equal(millimetres, [[0, 500, 2000, 3000, 0, 0]])
    rays = np.dstack([np.full((1, 6), 0.5), np.full((1, 6), -0.25), np.ones((1, 6))])
    topics = DepthDescription(nearest=0.4, farthest=3.0)
    grey = np.zeros((1, 6), np.uint8)
    xyz = compute_points(rays.astype(np.float32), depth, grey, topics)[..., :3]
    np.testing.assert_array_equal(
        xyz[0], [[nan] * 3, [0.25, -0.125, 0.5], [1, -0.5, 2], *[[nan] * 3] * 3])
