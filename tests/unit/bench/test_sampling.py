"""Random starts: ranges, visibility of the target, and search for joints."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import RandomStart
from aras_visual_servo_bench.plants.base import CameraPlacement
from aras_visual_servo_bench.plants.free_camera_kinematics import FreeCameraKinematics
from aras_visual_servo_bench.setup.start_sampling import draw_pose, draw_start
from aras_visual_servo_bench.targets.geometry import PlacedTarget, PolygonTarget
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.kinematics import Arm

CAMERA = CameraModel(320, 240, (100.0, 0, 166.0, 0, 90.0, 115.0, 0, 0, 1))
SHAPE = PolygonTarget(((-0.03, -0.01), (0.05, -0.02), (0.01, 0.06)))
PLACED = PlacedTarget(SHAPE, matrix_from_xyz_rpy((0.3, -0.2, 0.1), (0.0, 0.0, 0.7)))
MIDDLE = np.array([0.3, -0.2, 0.1]) + Rotation.from_euler("z", 0.7).apply([0.01, 0.01, 0.0])
GOAL = matrix_from_xyz_rpy((0.3, -0.2, 0.5), (np.pi - 0.03, 0.05, 0.4))  # it leans
AXES = (("x", "prismatic", "1 0 0", 2), ("y", "prismatic", "0 1 0", 1.5),
        ("z", "prismatic", "0 0 1", 2.5), ("wrist", "revolute", "0 0 -1", None))


def gantry(low, high):
    """Three slides and a wrist that turns a camera which looks down."""
    parts, parent = [], "world"
    for name, kind, axis, most in AXES:
        a, b = (low, high) if most is None else (-most, most)
        parts.append(f'<link name="{name}_l"/><joint name="{name}" type="{kind}">'
                     f'<parent link="{parent}"/><child link="{name}_l"/><axis xyz="{axis}"/>'
                     f'<limit lower="{a}" upper="{b}" velocity="1" effort="9"/></joint>')
        parent = f"{name}_l"
    return Arm.from_urdf(
        f'<robot name="g"><link name="world"/>{"".join(parts)}<link name="eye"/>'
        '<joint name="down" type="fixed"><parent link="wrist_l"/><child link="eye"/>'
        '<origin rpy="3.141592653589793 0 0"/></joint></robot>', "eye")


@pytest.mark.parametrize(("low", "high", "goal"), [(-9.0, 9.0, 5.0), (-3.1, 3.2, 2.5),
                                                   (-3.2, 3.1, -2.5)])
def test_the_last_joint_begins_at_the_turn_that_was_drawn(low, high, goal):
    """So it comes to the angle within its limits that is one turn away at most."""
    arm, q = gantry(low, high), np.array([0.1, 0.2, 0.3, goal])
    above = PlacedTarget(SHAPE, matrix_from_xyz_rpy((0.1, 0.2, 0.0), (0.0, 0.0, 0.3)))
    sampler, turns = RandomStart(height=(0.3, 0.5), side=0.05, turn=2.9, attempts=1), []
    for seed in range(12):
        kept = q.copy()
        joints = draw_start(sampler, arm, arm.pose(q), q, above, CAMERA, seed)
        np.testing.assert_array_equal(q, kept)
        turned = Rotation.from_matrix(arm.pose(joints)[:3, :3] @ arm.pose(q)[:3, :3].T)
        turn = turned.as_rotvec()[2]
        wanted = next(a for a in goal - turn + np.array([0.0, 2 * np.pi, -2 * np.pi])
                      if low <= a <= high)
        assert joints[3] == pytest.approx(wanted, abs=3e-4)
        turns.append(turn)
    assert min(turns) < -1.5 and max(turns) > 1.5


def test_a_start_lies_above_the_middle_of_a_target_that_is_turned():
    body, sampler = FreeCameraKinematics(GOAL), RandomStart((0.25, 0.25), side=0.0, turn=1.0)
    joints = draw_start(sampler, body, GOAL, np.zeros(6), PLACED, CAMERA, 3)
    np.testing.assert_allclose(body.pose(joints)[:3, 3], MIDDLE + [0, 0, 0.25], atol=1.1e-4)


def test_poses_fill_their_ranges():
    random = np.random.default_rng(2)
    sampler = RandomStart(height=(0.2, 0.5), side=0.08, turn=2.0, tilt=0.3)
    drawn = [draw_pose(sampler, GOAL, MIDDLE, random) for _ in range(800)]
    places = np.array([pose[:3, 3] for pose, _ in drawn]) - MIDDLE
    turns = np.array([turn for _, turn in drawn])
    about = Rotation.from_rotvec(turns[:, None] * [0.0, 0.0, 1.0])
    found = Rotation.from_matrix([pose[:3, :3] for pose, _ in drawn])
    leans = ((about * Rotation.from_matrix(GOAL[:3, :3])).inv() * found).as_rotvec()
    np.testing.assert_allclose(leans[:, 2], 0.0, atol=1e-12)
    lean, towards = np.hypot(*leans.T[:2]), np.arctan2(*leans.T[1::-1])
    for values, low, high in ((places[:, 0], -0.08, 0.08), (places[:, 1], -0.08, 0.08),
                              (places[:, 2], 0.2, 0.5), (turns, -2.0, 2.0), (lean, 0.0, 0.3),
                              (towards, -np.pi, np.pi)):
        near = 0.02 * (high - low)
        assert low <= values.min() < low + near and high - near < values.max() <= high
        assert values.mean() == pytest.approx(0.5 * (low + high), abs=3 * near)
    assert abs(np.corrcoef(places[:, 0], places[:, 1])[0, 1]) < 0.1
    level, turn = draw_pose(RandomStart(turn=2.0), GOAL, MIDDLE, random)
    wanted = Rotation.from_euler("z", turn).as_matrix() @ GOAL[:3, :3]
    np.testing.assert_allclose(level[:3, :3], wanted, atol=1e-12)


class Stuck(FreeCameraKinematics):
    """Body whose camera misses the requested pose by `off`, m, at any joints; it notes these."""

    def __init__(self, off=0.0, slope=0.0, lower=-1.0, upper=1.0):
        super().__init__(np.eye(4))
        self.off, self.slope, self.asked = off, slope, []
        self.lower, self.upper = np.full(6, lower), np.full(6, upper)
        self.lower[2] = -np.inf  # without a limit it is not bent

    def pose_and_jacobian(self, q):
        self.asked.append(q.copy())
        pose = np.eye(4)
        pose[:3, 3] = MIDDLE + [-self.off, 0.0, 0.3]
        return pose, self.slope * np.eye(6)


NEAR = np.array([0.1, -0.2, 0.3, 0.4, 0.5, 0.6])
EXACTLY = RandomStart(height=(0.3, 0.3), side=0.0, turn=0.0, attempts=1)
AHEAD = matrix_from_xyz_rpy((0, 0, 0), (0, 0, 0))
class Anywhere(PolygonTarget):
    """Target that is in the middle of every image."""

    def outline(self, target_T_camera):
        return np.array(self.corners)


SEEN = PlacedTarget(Anywhere(SHAPE.corners), matrix_from_xyz_rpy(
    (*(MIDDLE[:2] - [0.01, 0.01]), 0.1), (0.0, 0.0, 0.0)))


def looked_for(body):
    return draw_start(EXACTLY, body, AHEAD, NEAR, SEEN, CAMERA, 4)


@pytest.mark.parametrize(("off", "asked"), [
    (0.11, 4 * 7),  # what is still away by more than 0.1 m after six steps is out of reach
    (0.09, 4 * 12)])
def test_joints_are_looked_for_from_four_beginnings(off, asked):
    body = Stuck(off)
    with pytest.raises(ExperimentError, match=r"in 1 attempts \(1 out of reach\): reduce start.he"):
        looked_for(body)
    assert len(body.asked) == asked
    begun = np.array(body.asked[::asked // 4]) - NEAR
    np.testing.assert_array_equal(begun[:, [2, 5]], 0.0)  # the last one begins where it is told
    bent = np.abs(begun[:, [0, 1, 3, 4]])
    assert 0.4 < bent.max() <= 0.5 and np.ptp(begun[:, 0]) > 0.1 and begun.min() < 0 < begun.max()


def test_a_pose_is_found_to_a_tenth_of_a_millimetre_and_within_limits():
    assert looked_for(Stuck(0.9e-4))[5] == 0.6
    for body in (Stuck(1.2e-4), Stuck(0.0, upper=0.59), Stuck(0.0, lower=0.61, upper=0.62)):
        with pytest.raises(ExperimentError, match="1 out of reach"):
            looked_for(body)


def test_why_no_start_was_found_is_counted():
    body, sampler = FreeCameraKinematics(GOAL), RandomStart((0.25, 0.25), side=0.0, attempts=3)
    given = (sampler, body, GOAL, np.zeros(6), PLACED, CAMERA, 3)
    words = r"no start found in 3 attempts \({}\): reduce start.height"
    with pytest.raises(ExperimentError, match=words.format("3 in collision")):
        draw_start(*given, find_collision=lambda q: "it")
    came = []
    # the second does
    draw_start(*given, find_collision=lambda q: "" if came or came.append(1) else "it")
    own = CameraPlacement(matrix_from_xyz_rpy((0.02, 0.0, 0.0), (0.0, 0.0, 0.1)))
    draw_start(*given, other_cameras=[(own, CAMERA, PLACED)])
    aside = PlacedTarget(SHAPE, matrix_from_xyz_rpy((2.3, -0.2, 0.1), (0.0, 0.0, 0.0)))
    behind = PlacedTarget(SHAPE, matrix_from_xyz_rpy((0.3, -0.2, 1.1), (0.0, 0.0, 0.0)))
    for other in (aside, behind):
        with pytest.raises(ExperimentError, match=words.format("3 out of view")):
            draw_start(*given, other_cameras=[(own, CAMERA, other)])
    # The margin: 0.29 m before the middle the corners keep some 95 px from the upper border.
    wide = RandomStart(height=(0.25, 0.25), side=0.0, margin=150.0, attempts=3)
    with pytest.raises(ExperimentError, match="3 out of view"):
        draw_start(wide, *given[1:])
