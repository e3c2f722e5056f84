"""Images between two physics steps: links and camera have their poses at the exposure."""

import numpy as np
import pytest
from scenes import BRIGHT, link_pose, looking
from scipy.spatial.transform import Rotation, Slerp

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.pose_interpolation import blend_pose, blend_poses
from aras_sim_bridge.rendering import create_renderer
from aras_visual_servo_base.poses import Pose, quaternion_from_rpy

MS = 1_000_000


def matrix(yaw: float, x: float = 0.0) -> np.ndarray:
    return np.array(Pose.from_rpy((x, 0.0, 0.0), (0.0, 0.0, yaw)).matrix())


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_quaternion_and_its_negative_are_one_turn(sign):
    before = np.array([quaternion_from_rpy(0.0, 0.0, 0.1)])
    now = sign * np.array([quaternion_from_rpy(0.0, 0.0, 0.2)])
    (pose,) = blend_poses(np.zeros((1, 3)), before, np.array([[1.0, 2.0, 3.0]]), now, 0.25)
    np.testing.assert_allclose(pose[:3, :3], matrix(0.125)[:3, :3], atol=1e-4)
    np.testing.assert_allclose(pose[:3, 3], [0.25, 0.5, 0.75])


@pytest.mark.parametrize("yaw", [0.3, np.pi - 0.005, -np.pi + 0.002])
def test_the_camera_turns_the_short_way(yaw):
    between = blend_pose(matrix(yaw, 1.0), matrix(yaw + 0.01, 2.0), 0.3)
    np.testing.assert_allclose(between, matrix(yaw + 0.003, 1.3), atol=1e-6)


def test_a_snapshot_is_of_the_last_step_alone(bench):
    """A body that jumps twice: the second picture does not know where it was at first."""
    bench.box([1, 1, 0.01], [0, 0, -0.02])
    body = bench.box([0.03, 0.03, 0.001], [-0.1, 0, 0], "Gazebo/Black")
    config = CameraConfig.from_mapping({"update_rate": 30.0, "near": 0.01, "horizontal_fov": 0.5})
    sensor = CameraSensor(config, create_renderer("exact", bench.world, BRIGHT))
    pose = link_pose(looking([0, 0, 1.0], [0, 0, 0], (0, 1, 0)))
    columns = []
    for k, x in ((34, 0.0), (67, 0.1)):
        assert sensor.needs_previous_pose(k * MS)
        sensor.before_step(pose, (k - 1) * MS)
        body.set_pose(Pose((x, 0.0, 0.0)))
        dark = 255.0 - sensor.capture(pose, k * MS).image[..., 0]
        columns.append((dark * np.arange(320)).sum() / dark.sum())
    pixel = config.K[0, 0] / 0.999
    # The instants lie 1/3 and 2/3 into their steps.
    assert columns == pytest.approx(
        [159.5 + pixel * (-0.1 + 0.1 / 3), 159.5 + pixel * 0.1 * 2 / 3], abs=0.05)


def test_a_model_that_came_in_the_place_of_another_was_never_where_that_one_was(bench):
    renderer = create_renderer("exact", bench.world, BRIGHT)
    bench.box([0.1, 0.1, 0.1], [3.0, 0.0, 0.0])
    renderer.snapshot()
    bench.world.delete(next(iter(bench.world.models)))
    bench.box([0.1, 0.1, 0.1], [0.0, 2.0, 0.0])
    renderer.scene.refresh()
    (pose,) = renderer.scene.interpolate_poses(0.5)
    np.testing.assert_allclose(pose[:3, 3], [0.0, 2.0, 0.0])


def test_a_model_that_came_between_snapshots_is_drawn_between_them(bench):
    renderer = create_renderer("exact", bench.world, BRIGHT)
    renderer.snapshot()
    body = bench.box([0.1, 0.1, 0.1], [0.0, 2.0, 0.0])
    renderer.snapshot()
    body.set_pose(Pose((0.0, 3.0, 0.0)))
    (pose,) = renderer.scene.interpolate_poses(0.25)
    np.testing.assert_allclose(pose[:3, 3], [0.0, 2.25, 0.0])


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_half_way_is_between_two_and_at_either_end_it_is_theirs(seed):
    random = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, :3] = Rotation.random(2, random_state=seed).as_matrix()
    poses[:, :3, 3] = random.normal(size=(2, 3))
    half = np.eye(4)
    half[:3, :3] = Slerp([0, 1], Rotation.from_matrix(poses[:, :3, :3]))(0.5).as_matrix()
    half[:3, 3] = poses[:, :3, 3].mean(axis=0)
    for blend, expected in ((0.0, poses[0]), (0.5, half), (1.0, poses[1])):
        np.testing.assert_allclose(blend_pose(*poses, blend), expected, atol=1e-12)
