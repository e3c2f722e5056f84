"""Images between two physics steps: links and camera have their poses at the exposure."""

import numpy as np
import pytest
from scenes import BRIGHT
from scipy.spatial.transform import Rotation, Slerp

from aras_sim_bridge.pose_interpolation import blend_pose, blend_poses
from aras_sim_bridge.rendering import create_renderer
from aras_visual_servo_base.poses import Pose

MS = 1_000_000


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("angle", [0.01, 1.9, np.pi - 0.01])
def test_a_pose_between_two_is_on_the_short_way_whatever_the_sign_of_a_quaternion(angle, sign):
    first = Rotation.from_rotvec([0.3, -0.4, 3.0])
    second = first * Rotation.from_rotvec(angle * np.array([0.36, 0.48, 0.8]))
    at = np.array([[[1.0, -2.0, 3.0]], [[2.0, 1.0, -1.0]]])
    ends = np.tile(np.eye(4), (2, 1, 1))
    for blend in (0.0, 0.3 if angle < 0.1 else 0.5, 1.0):  # linear in a small turn
        expected = Slerp([0, 1], Rotation.concatenate([first, second]))(blend).as_matrix()
        poses = np.empty((1, 4, 4))
        blend_poses(at[0], first.as_quat()[None], at[1], sign * second.as_quat()[None], blend,
                    poses)
        ends[:, :3, :3], ends[:, :3, 3] = [first.as_matrix(), second.as_matrix()], at[:, 0]
        for found in (poses[0], blend_pose(*ends, blend)):
            np.testing.assert_allclose(found[:3, :3], expected, atol=1e-6)
            np.testing.assert_allclose(found[:3, 3], at[0, 0] + blend * (at[1] - at[0])[0])


def test_a_model_that_came_after_a_snapshot_is_where_it_is_and_then_between_two(bench):
    renderer = create_renderer("exact", bench.world, BRIGHT)
    bench.box([0.1, 0.1, 0.1], [3.0, 0.0, 0.0])
    renderer.snapshot()
    bench.world.delete(next(iter(bench.world.models)))
    body = bench.box([0.1, 0.1, 0.1], [0.0, 2.0, 0.0])
    renderer.scene.refresh()
    (pose,) = renderer.scene.interpolate_poses(0.5)
    np.testing.assert_allclose(pose[:3, 3], [0.0, 2.0, 0.0])
    renderer.snapshot()
    body.set_pose(Pose((0.0, 3.0, 0.0)))
    for blend, y in ((0.25, 2.25), (2.0, 3.0)):
        (pose,) = renderer.scene.interpolate_poses(blend)
        np.testing.assert_allclose(pose[:3, 3], [0.0, y, 0.0])
