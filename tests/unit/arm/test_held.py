"""Motion of the camera in directions that the task does not control, compared with SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_visual_servo_controller.kinematics.held_directions import compute_held_directions

LENGTH = 0.35  # m


def random_pose(random):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=random).as_matrix()
    pose[:3, 3] = random.uniform(-1.0, 1.0, 3)
    return pose


def masks(upright):
    """(6,) of all tasks whose vertical is held, or of all others."""
    every = [np.array([bit == "1" for bit in f"{n:06b}"]) for n in range(64)]
    return [mask for mask in every if (tuple(mask[3:]) == (False, False, True)) == upright]


@pytest.mark.parametrize("seed", range(5))
def test_what_the_task_does_not_speak_of_goes_straight_to_the_goal(seed):
    random = np.random.RandomState(seed)
    view, goal = random_pose(random), random_pose(random)
    turn = Rotation.from_matrix(view[:3, :3].T @ goal[:3, :3]).as_rotvec()
    off = np.append(view[:3, :3].T @ (goal[:3, 3] - view[:3, 3]), LENGTH * turn)
    for modelled in masks(upright=False):
        held, errors, free = compute_held_directions(view, goal, modelled, LENGTH)
        np.testing.assert_array_equal(held, np.eye(6)[~modelled])
        np.testing.assert_array_equal(free, np.eye(6)[modelled])
        np.testing.assert_allclose(errors, off[~modelled], atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_vertical_goes_the_short_way_to_its_place_in_the_camera(seed):
    random = np.random.RandomState(seed)
    view, goal = random_pose(random), random_pose(random)
    for modelled in masks(upright=True):
        held, errors, free = compute_held_directions(view, goal, modelled, LENGTH)
        both = np.vstack([held, free])
        np.testing.assert_allclose(both @ both.T, np.eye(6), atol=1e-12)
        np.testing.assert_allclose(free[-1], [0.0, 0.0, 0.0, *view[2, :3]])
        np.testing.assert_array_equal(free[:-1], np.eye(6)[:3][modelled[:3]])
        turn = errors @ held[:, 3:] / LENGTH
        turned = Rotation.from_rotvec(turn).inv().apply(view[2, :3])
        np.testing.assert_allclose(turned, goal[2, :3], atol=1e-12)
        assert np.linalg.norm(turn) == pytest.approx(np.arccos(view[2, :3] @ goal[2, :3]))
        away = view[:3, :3].T @ (goal[:3, 3] - view[:3, 3])
        np.testing.assert_allclose(errors[:-2], away[~modelled[:3]])


def test_upside_down_any_way_round_is_as_good():
    view = np.eye(4)
    view[:3, :3] = Rotation.from_rotvec([0.4, -0.7, 0.2]).as_matrix()
    goal = view.copy()
    goal[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ view[:3, :3]
    held, errors, _ = compute_held_directions(view, goal, masks(upright=True)[-1], LENGTH)
    assert np.linalg.norm(errors) == pytest.approx(np.pi * LENGTH)
    turned = Rotation.from_rotvec(errors @ held[:, 3:] / LENGTH).apply(view[2, :3])
    np.testing.assert_allclose(turned, -view[2, :3], atol=1e-12)


@pytest.mark.parametrize("angle", [
    0.0, 1e-9, 1e-7, 0.9e-6, 1.1e-6, 1e-4, 1e-2, np.pi, np.pi - 3e-5, np.pi + 3e-5, np.pi - 1e-3])
@pytest.mark.parametrize("axis", [(0.9, -0.3, 0.2), (0.1, 0.8, -0.5), (-0.2, 0.4, 0.9)])
def test_small_turns_and_half_a_turn_are_about_their_own_axes(axis, angle):
    """There the sine of the angle divides nothing any more, or tells no axis."""
    view = random_pose(np.random.RandomState(7))
    goal = view.copy()
    wanted = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis))
    goal[:3, :3] = view[:3, :3] @ wanted.as_matrix()
    errors = compute_held_directions(view, goal, np.zeros(6, bool), LENGTH)[1]
    np.testing.assert_allclose(errors[:3], 0.0, atol=1e-12)
    turn = Rotation.from_rotvec(errors[3:] / LENGTH)
    assert (turn.inv() * wanted).magnitude() < 1e-8
    size = min(angle, 2.0 * np.pi - angle)
    assert np.linalg.norm(errors[3:]) == pytest.approx(LENGTH * size, rel=1e-6)
    if angle < 3.0:
        np.testing.assert_allclose(errors[3:], LENGTH * wanted.as_rotvec(), rtol=1e-9, atol=1e-15)
