"""Whether the camera is at its goal, and the uncertainty of its pose."""

import numpy as np
import pytest
from loop_rig import CORNERS, TolerantScheme, a_solution, an_output, moments_of, scaled
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import CameraModel, Goal, Moments, Observation
from aras_visual_servo_controller.diagnosis import (
    camera_offset,
    offset_statistics,
    pose_uncertainty,
    view_check,
)
from aras_visual_servo_controller.diagnosis.arrival_check import ArrivalCheck
from aras_visual_servo_controller.diagnosis.goal_plane import GoalPlane
from aras_visual_servo_controller.kinematics.held_directions import compute_held_directions

compute_speed = camera_offset.compute_speed
confidence_length = offset_statistics.compute_confidence_length
bound_symmetry = pose_uncertainty.bound_symmetry
THIRD = view_check.THIRD_ORDER_TOLERANCE
DEEP = Goal(depth=0.2)


class Watched(ArrivalCheck):
    """Arrival of a scheme with tolerances of 1 that stores its last report and counts images."""

    fed, last = 0, None
    reached = property(lambda self: self.last.is_reached)
    short = property(lambda self: self.last.pending_reason)

    def __init__(self, hold, goal=DEEP):
        self.scheme = TolerantScheme(())
        super().__init__(goal, self.scheme, hold)


def shown(arrival, stamp, error, L=None, modelled=(True,) * 6, pose=None, ambiguity="",
          accuracy=None, moments=None, resolution=None, others=None):  # fmt: skip
    """Return what a Watched reports for one image with an error (k,), its L (k, 6), from a pose."""
    arrival.scheme.tolerances = np.ones(len(error))
    arrival.scheme.feature_accuracy = accuracy
    decision = an_output(error, L, None if L is None else modelled, ambiguity=ambiguity)
    seen = Observation(stamp, 0.1, True, "", None, world_T_camera=pose, moments=moments,
                       other_cameras=others or {}, name="left")  # fmt: skip
    return arrival.add(decision, seen, resolution)


AWAY = [0.9] * 6 + [1.4] * 5 + [1.6] * 3 + [1.4] * 6  # by means of five


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("hold", "dt", "errors", "reached"), [
    (0.5, 0.1, [0.9] * 7, "-----++"), (0.5, 0.1, [1.0] * 9, "---------"),  # not within: at them
    (0.5, 0.1, [0.5, -1.4, 1.6, -0.7] * 4, "+"), (0.5, 0.1, [6.0, -6.0] * 8, "-"),
    # what would not have been near enough to arrive is near enough to stay
    (0.4, 0.1, AWAY, "++++++++-------"), (0.4, 0.1, [*AWAY, *[0.9] * 6], "+"),
    (2.0, 0.8, [-3.3, 0.6, -0.1, 0.1, 0.1], "----+"),
    # however long the gap, two images show no rest; four that are near do, also of a fast camera
    (0.5, 1.5, [0.9] * 3, "--+"), (0.3, 0.1, [0.5, -1.1, 0.5, 0.5], "----"),
    (0.4, 0.1, [0.5, -1.1, 0.5, 0.5, 0.5], "+"), (0.0, 0.1, [2.0, 0.5, 1.2, 1.7, 0.5], "-++-+"),
])  # fmt: skip
def test_an_arrival_needs_the_mean_of_its_hold_within_the_tolerances(hold, dt, errors, reached,
                                                                     sign):  # fmt: skip
    arrival = Watched(hold)
    found = [shown(arrival, 36.7 * (1.0 - sign) + dt * i, [sign * e]).is_reached
             for i, e in enumerate(errors)]  # fmt: skip
    assert found[-len(reached):] == [there == "+" for there in reached]


def of_camera(errors, L, modelled=(True,) * 6, poses=None, begin=None, goal=DEEP, **more):
    """A Watched that was shown errors (m, k) of tolerance 1, with L (k, 6), from poses."""
    arrival = Watched(0.3, goal) if begin is None else begin
    for i, error in enumerate(errors):
        arrival.fed += 1
        pose = None if poses is None else poses[i]
        arrival.last = shown(arrival, 0.1 * arrival.fed, error, L, modelled, pose, **more)
    return arrival


# A feature changes by 1 for 0.1 mm and 0.1 degrees of the camera, but for 5 mm along y.
WEAK = np.diag([1e4, 200.0, 1e4, 573.0, 573.0, 573.0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_arrival_asks_how_far_the_camera_is(sign):
    error = np.array([0.0, 0.5 * sign, 0.0, 0.0, 0.0, 0.0])
    short = of_camera([error] * 6, WEAK)
    assert not short.reached and "2.50 mm and 0.00 degrees from its goal" in short.short
    assert not of_camera([0.07 * error] * 6, WEAK).reached  # 0.175 mm
    there = [0.06 * error] * 6
    near = of_camera(there, WEAK)
    assert near.reached and not near.short
    # not of a direction that the task does not speak of, nor of one that no feature sees
    assert of_camera([error] * 6, WEAK, (True, False, True, True, True, True)).reached
    assert of_camera([error] * 6, np.diag([1e4, 0.0, 1e4, 573.0, 573.0, 573.0])).reached
    # and once it is there, half as far again, and no further
    stays = of_camera([*there, *[0.09 * error] * 6], WEAK)
    assert stays.reached and not stays.short
    assert not of_camera([*there, *[0.11 * error] * 6], WEAK).reached
    turned, L = np.array([0, 0, 0, 0, sign, 0]), np.diag([1e4, 1e4, 1e4, 573.0, 10.0, 573.0])
    assert "0.00 mm and 2.86 degrees from its goal" in of_camera([0.5 * turned] * 6, L).short
    assert of_camera([0.03 * turned] * 6, L).reached
    assert not of_camera([0.04 * turned] * 6, L).reached  # 0.23 degrees


def noisy(count, mean=(0.0,) * 6, seed=0):
    return np.random.default_rng(seed).normal(0.0, 0.3, (count, 6)) + mean


def test_noise_that_hides_where_the_camera_is_is_averaged_for_a_while():
    """0.3 of WEAK's second are 1.5 mm: 0.2 mm would take 225 images, and 120 have to do."""
    early = of_camera(noisy(40), WEAK)
    assert not early.reached and "scatter: the pose of the camera is known only to" in early.short
    assert not of_camera(noisy(119, seed=2), WEAK).reached
    assert of_camera(noisy(120, seed=2), WEAK).reached
    assert not of_camera(noisy(200, [0, 0.1, 0, 0, 0, 0]), WEAK).reached  # 0.5 mm off
    # It ends nothing that has converged: 1 or 2 of 25 runs were not there at their last image.
    for L, seed in ((np.diag([1e3] * 3 + [573.0] * 3), 0), (np.diag([1e3] * 3 + [25.0] * 3), 1)):
        arrival = of_camera(noisy(120, seed=seed), L)
        while not arrival.reached:
            of_camera(noisy(1, seed=arrival.fed), L, begin=arrival)
        assert arrival.fed < 200
        for error in noisy(250, seed=100 + seed):
            assert of_camera([error], L, begin=arrival).reached, seed


def at(x, y=0.0, turn=0.0):
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    pose[:2, 3] = x, y
    return pose


@pytest.mark.parametrize(("way", "far"), [
    ((4e-4, 2e-4, 0.0, 0.0, 0.0, 2e-3), 53), *(((0, 0, 0, *7e-3 * axis), 54) for axis in np.eye(3)),
])  # fmt: skip
def test_errors_are_brought_to_where_the_camera_is_now(way, far):
    """A camera that swings along its way, by turns at its goal, whatever the mean of the errors."""
    L = 1e3 * np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
    swing = np.outer(np.sin(0.5 * np.arange(60)), way)
    swing[:, 5] += 2e-3 * np.cos(0.5 * np.arange(60)) * (way[0] != 0.0)
    for last, there in ((50, True), (far, False)):
        seen = swing[: last + 1]
        poses = [at(0.3, -0.2, 1.1) @ matrix_from_xyz_rpy(one[:3], one[3:]) for one in seen]
        found = of_camera(seen @ L + 0.2 * noisy(last + 1), L, poses=poses)
        assert (not found.short) == there, (last, found.short)


@pytest.mark.parametrize("seed", [3, 8])
def test_many_rows_say_of_the_camera_what_few_of_them_say(seed):
    """A picture's rows are many; here one direction, a turn with some of y, changes none."""
    random = np.random.default_rng(seed)
    L = random.normal(size=(6, 6))
    L[:, 5] = 2.0 * L[:, 3] - L[:, 1]
    moves = 2e-2 * random.normal(size=(40, 6))
    poses = [at(0.3) @ matrix_from_xyz_rpy(way[:3], way[3:]) for way in moves]
    errors = (moves + 0.1) @ L.T
    few, many = (of_camera(np.tile(errors, count), np.tile(L, (count, 1)), poses=poses).short
                 for count in (1, 12))
    assert few == many and "but they scatter" in few
    # nor is a direction that changes them by a thousandth of another's overlooked in many
    weak, error = np.diag([1e4, 10.0, 1e4, 573.0, 573.0, 573.0]), (0, 0.5, 0, 0, 0, 0)
    assert "50.00 mm" in of_camera(np.tile(error, (6, 12)), np.tile(weak, (12, 1))).short


def test_noise_is_averaged_over_all_images_of_the_arrival_and_a_motion_over_the_latest():
    random, stamps = np.random.default_rng(5), 0.03 * np.arange(40)
    rows = np.hstack([1e-5 * random.normal(size=(40, 6)), np.tile(np.eye(4).ravel(), (40, 1))])
    for settled, count in ((3, 3), (5, 5), (16, 16), (40, 40)):
        found, short = camera_offset.compute_mean_offset(stamps, rows, np.eye(6), settled, False)
        assert not short and found.count == count
        np.testing.assert_allclose(found.mean, rows[-count:, :6].mean(axis=0))
    rows[:20, :6] += 3e-4  # before, it was elsewhere, and kinematics do not say so
    found, short = camera_offset.compute_mean_offset(stamps, rows, np.eye(6), 40, False)
    assert not short and found.count < 20


@pytest.mark.parametrize("wrong", [0.5, -0.5])
def test_a_speed_is_the_lesser_of_what_images_and_kinematics_say(wrong):
    step = 1e-4 * np.array([3.0, -2.0, 1.0, 20.0, 10.0, -10.0])
    base = matrix_from_xyz_rpy((0.4, -0.7, 0.9), (2.5, 0.4, -0.8))
    poses = [base @ matrix_from_xyz_rpy(0.5 * k * step[:3], 0.5 * k * step[3:]) for k in (-4, 0, 2)]
    offsets = (1.0 + wrong) * np.outer([-2.0, 0.0, 1.0], step)
    rows, stamps = np.hstack([offsets, np.reshape(poses, (3, 16))]), np.array([3.1, 3.3, 3.37])
    lesser = step if wrong > 0.0 else offsets[2]
    sizes = np.linalg.norm(lesser[:3]), np.linalg.norm(lesser[3:])
    assert compute_speed(stamps, rows) == pytest.approx(np.array(sizes) / 0.07, rel=2e-3)
    assert compute_speed(stamps[:1], rows[:1]) == (0.0, 0.0)
    assert compute_speed(np.array([3.37, 3.37]), rows[:2]) == (0.0, 0.0)  # no time has passed
    rows[:, 6:] = np.nan  # the poses are unknown
    by_images = np.linalg.norm(offsets[2, :3]), np.linalg.norm(offsets[2, 3:])
    assert compute_speed(stamps, rows) == pytest.approx(np.array(by_images) / 0.07)


def test_a_motion_that_kinematics_have_wrong_does_not_hide_where_the_camera_is():
    """It swings by 0.6 mm along y, at last to one side; the arm says that this was along x."""
    L, along_y = 1e3 * np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]), np.eye(6)[1]
    swing = 6e-4 * np.sin(0.12 * np.arange(119))
    assert swing[-1] > 5.9e-4
    errors = np.outer(swing, L @ along_y) + 0.01 * noisy(119)
    assert "0.59 mm" in of_camera(errors, L, poses=[at(0.3) @ at(y) for y in swing]).short
    # Exact images of a camera that comes to its goal along y are no noise: the latest image's
    # offset counts alone, with some of its speed; their mean is nearly twice as much.
    y = 1e-4 * 0.8 ** np.arange(12)
    left = left_by(np.outer(y, STRONG @ along_y), STRONG, poses=[at(b) for b in y])
    assert (1.7 + 0.6 * 0.25) * y[-1] < left.distance - MOVES < 2.1 * y[-1]


def test_images_that_tell_nothing_of_where_the_camera_is_do_not_count():
    L, near = np.diag([1e3, 1e3, 1e3, 573.0, 573.0, 573.0]), np.eye(6)[0]
    # A run that has come nearer by another way than L says is judged by where it is at last.
    before, after = [0.9 * near] * 30, [0.02 * near] * 8
    assert of_camera([*before, *after], L, poses=[at(0.0)] * 38).reached
    # A target that moves along is judged by the errors as they are.
    poses = [at(0.01 * k) for k in range(12)]
    assert of_camera([0.05 * near] * 12, L, poses=poses).reached
    assert not of_camera([0.5 * near] * 12, L, poses=poses).reached
    # What is far, and what was before it was cleared, does not count.
    L = np.diag([1e3, 200.0, 1e4, 573.0, 573.0, 573.0])
    after = of_camera([*[13.0 * near] * 3, *[0.1 * near] * 6], L, poses=[at(0.0)] * 9)
    assert after.reached
    after.clear()
    assert not of_camera([0.1 * near] * 3, L, begin=after).reached
    # Errors of another length are a new arrival: 1.2 is near enough only after an arrival.
    of_camera([[0.5]], None, begin=(arrival := Watched(0.0)))
    assert of_camera([[1.2]], None, begin=arrival).reached
    assert not of_camera([[1.2, 1.2]], None, begin=arrival).reached


# -- what is left open -------------------------------------------------------------------------
STRONG = np.diag([1e3, 1e3, 1e3, 573.0, 573.0, 573.0])
MOVES, TURNS = 1e-5, 1e-4  # that a camera at rest is known to, m and rad
HERE = at(0.3, -0.2, 0.4)


def left_by(errors, L, **more):
    """Return the pose uncertainty after images with errors (m, k) of a camera at rest."""
    poses = more.pop("poses", [HERE] * len(errors))
    arrival = of_camera(errors, L, poses=poses, **more)
    assert arrival.reached, arrival.short
    return arrival.last.pose_uncertainty


@pytest.mark.parametrize("seed", range(3))
def test_no_more_than_three_of_a_thousand_are_longer(seed):
    random = np.random.default_rng(seed)
    spread = random.normal(size=(3, 3)) * ([1.0, 0.02, 0.01], 1.0, [1.0, 1.0, 0.1])[seed]
    mean = random.normal(size=3) * (0.0, 1.0, 20.0)[seed]
    drawn = np.linalg.norm(mean + random.normal(size=(400_000, 3)) @ spread.T, axis=1)
    bound = confidence_length(mean, spread @ spread.T)
    assert 0.002 < (drawn > bound).mean() < 0.004
    assert confidence_length(mean, np.zeros((3, 3))) == pytest.approx(np.linalg.norm(mean))


@pytest.mark.parametrize(("rows", "modelled", "joints"), [
    (6, 6, 0), (9, 6, 0), (6, 3, 0), (5, 4, 0), (7, 3, 0), (8, 6, 4), (4, 6, 3),
])  # fmt: skip
@pytest.mark.parametrize("seed", range(3))
def test_what_is_left_open_is_what_the_inverse_of_L_makes_of_it(seed, rows, modelled, joints):
    """Unscaled here; rotations of the camera that are held are off by some milliradians."""
    random = np.random.default_rng([seed, rows])
    depth = (0.5, 0.8, 1.7)[seed]
    camera = CameraModel(320, 240, (100.0, 0.0, 160.0, 0.0, 100.0, 120.0, 0.0, 0.0, 1.0), ())
    goal = Goal(depth=depth, camera=camera, world_T_camera=HERE @ matrix_from_xyz_rpy(
        (0.1, 0.2, 0.7), (3.0, 0.2, 0.1)))  # fmt: skip
    L = random.normal(size=(rows, 6)) * [1e3, 1e3, 1e3, 700.0, 700.0, 700.0]
    error, accuracy = 0.3 * random.normal(size=rows), 0.02 * random.normal(size=(rows, 5))
    accuracy = None if seed == 2 else accuracy
    offsets = camera_offset.PoseOffsets(
        1e-4 * random.normal(size=6), np.cov(1e-4 * random.normal(size=(6, 20))), 1 + 4 * seed,
        (2e-3, 5e-3))
    pose = goal.world_T_camera @ matrix_from_xyz_rpy(
        1e-4 * random.normal(size=3), 3e-3 * random.normal(size=3))  # fmt: skip
    here = Observation(0.0, 0.1, True, "", camera, world_T_camera=pose)
    arm = a_solution(random.normal(size=(6, joints))) if joints else None
    modelled = np.arange(6) < modelled
    other = 2.0 * error
    decision = an_output(error, L, modelled, residual=error if seed else None)
    held_offset, directions = pose_uncertainty.split_directions(here, goal, modelled, arm)
    left = pose_uncertainty.ArrivalMargin(
        decision, GoalPlane(goal, camera), directions, other if seed else error, accuracy,
        np.zeros(len(error)), np.zeros((6, 6)),
    ).bound_uncertainty(here, held_offset, offsets, np.zeros(6), ())  # fmt: skip

    scale, held = np.array([1.0] * 3 + [depth] * 3), np.zeros(6)
    free = arm.jacobian if joints else None
    if not joints:
        directions, off, free = compute_held_directions(here.world_T_camera, goal.world_T_camera,
            modelled,
                                        depth)  # fmt: skip
        held, free = -(off @ directions) / scale, free.T / scale[:, None]
    # What is held moves the features, and the free directions make up for it.
    inverse = free @ np.linalg.pinv(L @ free)
    part, spread = 1.0 / max(4 * seed, 1), np.zeros((6, 6))
    if accuracy is None and rows > 6:
        # What no motion explains is an error of the features' own.
        lengths = np.linalg.norm(L / scale, axis=1)
        even = L / lengths[:, None]
        left_over = error / lengths - even @ np.linalg.pinv(even) @ (error / lengths)
        size = np.linalg.norm(left_over) / np.sqrt(rows - 6)
        spread = 2.0 * 1.1**2 * size**2 * inverse @ np.diag(lengths**2) @ inverse.T
    if accuracy is not None:
        unseen = np.eye(rows) - L @ np.linalg.pinv(L)
        times = 1.0
        if rows > 6:
            times = max(np.linalg.norm(unseen @ error) / np.linalg.norm(unseen @ accuracy)
                        / np.sqrt(2.0), 1.0)  # fmt: skip
        part += 0.25**2
        spread = 2.0 * (1.1 * times) ** 2 * inverse @ accuracy @ accuracy.T @ inverse.T
    noise = part * np.diag(offsets.scatter).reshape(2, 3).sum(axis=1)
    surely = np.maximum(1.0 - noise / (offsets.mean.reshape(2, 3) ** 2).sum(axis=1), 0.0)
    factors = np.repeat(1.0 + np.array([0.7, 0.4]) * surely, 3)
    known = factors * offsets.mean + held - inverse @ L @ held
    covariance = part * offsets.scatter + spread
    distance, angle = (confidence_length(known[part], covariance[part, part].copy())
                       for part in (slice(3), slice(3, 6)))  # fmt: skip
    expected = distance + 5e-5 * depth + 0.06 * 2e-3, angle + 1e-4 + 0.06 * 5e-3
    assert (left.distance, left.angle) == pytest.approx(expected, rel=1e-6)
    parts = left.distance / (1.5e-3 * depth), np.degrees(left.angle) / 0.3
    words = (f"{np.ceil(1e4 * left.distance) / 10.0:g} mm" if parts[0] >= parts[1]
             else f"{np.ceil(10.0 * np.degrees(left.angle)) / 10.0:g} degrees")  # fmt: skip
    assert left.description == (words if max(parts) > 1.0 else "")


def test_a_camera_that_moves_may_go_on_for_some_hundredths_of_a_second():
    """Images in 0.1 s, the last steps 0.02 mm along y and 0.1 mrad about x."""
    way = np.outer(1e-5 * np.array([19.0, 13.0, 8.0, 4.0, 1.0, -1.0]), [0, 1, 0, 5, 0, 0])
    poses = [HERE @ matrix_from_xyz_rpy(step[:3], step[3:]) for step in way]
    left = left_by(way @ STRONG, STRONG, poses=poses)
    assert left.distance == pytest.approx(1.7 * 1e-5 + 0.6 * 2e-5 + MOVES, rel=1e-3)
    assert left.angle == pytest.approx(1.4 * 5e-5 + 0.6 * 1e-4 + TURNS, rel=1e-3)
    # not where the target moves along, nor where noise moves the offset alone
    still = [0.01 * np.ones(6)] * 6
    along = left_by(still, STRONG, poses=[at(0.03 * k) for k in range(6)])
    assert along.distance == pytest.approx(left_by(still, STRONG).distance)
    noise = np.outer(np.tile([1.0, -1.0], 30), 0.01 * np.eye(6)[1])
    assert left_by(noise, STRONG).distance < MOVES + 1.8e-5


def test_noise_leaves_its_mean_s_deviation_open():
    """Of 60 images with a scatter of 0.3 mm along y: 0.3 / sqrt(60) x 3 (one direction)."""
    errors = np.zeros((60, 6))
    errors[:, 1] = 0.3 * np.tile([1.0, -1.0], 30)
    arrival = of_camera(errors[:4] * 0.0, STRONG, poses=[HERE] * 4)
    left = of_camera(errors, STRONG, poses=[HERE] * 60, begin=arrival).last.pose_uncertainty
    assert left.angle == pytest.approx(TURNS, abs=1e-9)
    counted = 3e-4 / np.sqrt(32) * 2.99  # as many images as hold and scatter ask for
    assert 0.3 * counted < left.distance - MOVES < 1.5 * counted
    # Of a turn as much, however deep the target.
    turns = [left_by(np.roll(errors, 3, axis=1), STRONG, goal=Goal(depth=depth)).angle
             for depth in (0.5, 1.0, 2.0)]
    assert turns[0] > TURNS and turns == pytest.approx(turns[:1] * 3)


def test_accuracy_counts_for_the_goal_too_and_in_pictures_noise_does_not_vanish():
    still = [np.zeros(6)] * 6
    exact = left_by(still, STRONG, accuracy=None)
    assert exact.distance == MOVES
    assert (exact.description, exact.reason, exact.remedy) == ("", "", "")
    left = left_by(still, STRONG, accuracy=0.5 * np.eye(6)[:, [1, 4]])
    assert left.distance - MOVES == pytest.approx(1.1 * np.sqrt(2.0) * 0.5e-3 * 2.985, rel=0.01)
    assert left.angle - TURNS == pytest.approx(1.1 * np.sqrt(2.0) * 0.5 / 573.0 * 2.985, rel=0.01)
    assert left.description == "2.4 mm" and "2.33 mm and 0.24 degrees" in left.reason
    turned = left_by(still, STRONG, accuracy=3.0 * np.eye(6)[:, [4]])
    assert turned.description == "1.4 degrees"
    noise = np.outer(np.tile([1.0, -1.0], 60), 0.1 * np.eye(6)[1])
    clean = left_by(noise, STRONG).distance
    assert left_by(noise, STRONG, accuracy=np.zeros((6, 1))).distance > 1.05 * clean
    # It is asked for again as the features come nearer to their goals.
    begun, found = Watched(0.3), []
    for size, accuracy in ((0.09, 0.5), (0.081, 0.1), (0.018, 0.1)):
        now = of_camera([np.full(6, size)] * 6, STRONG, poses=[HERE] * 6, begin=begun,
                        accuracy=accuracy * np.eye(6))  # fmt: skip
        found.append(now.last.pose_uncertainty.distance)
    assert found[1] == pytest.approx(found[0], rel=0.1) and found[2] < 0.3 * found[0]


@pytest.mark.parametrize(("weak", "times"), [(0.9e-6, 5.0 / np.sqrt(2.0)), (1.1e-6, 0.0)])
def test_a_direction_that_changes_less_than_a_millionth_explains_nothing(weak, times):
    L, error = 1e3 * np.diag([1.0, weak]), np.array([0.3, -0.2])
    found = offset_statistics.compute_unexplained_ratio(L, error, 0.04 * np.eye(2))
    assert found == pytest.approx(times)


def test_a_direction_that_nothing_measures_is_left_open():
    def left(L, **more):
        found = left_by([np.zeros(len(L))] * 6, L, **more)
        return found.description, found.distance, found.angle

    round_axis = np.diag([1e3, 1e3, 1e3, 573.0, 573.0, 0.0])
    assert left(round_axis) == ("1 direction", MOVES, np.pi)
    lever = round_axis.copy()  # turns about an axis aside of the camera, 2 cm and about 4 m
    for beside, far in ((-0.02, 0.04 + MOVES), (-3.96, 7.92 + MOVES),
                        (-4.04, np.inf)):  # 20 times the depth: straight on  # fmt: skip
        lever[0, 5] = 1e3 * beside
        assert left(lever)[1:] == (pytest.approx(far), np.pi)
    assert left(np.diag([1e3, 0.0, 1e3, 573.0, 573.0, 573.0]))[:2] == ("1 direction", np.inf)
    for rows in ([0, 1, 3, 4], [0, 1, 2, 3]):  # two turns go anywhere as well
        assert left(STRONG[rows]) == ("2 directions", np.inf, np.pi)
    # what a direction changes is less than what the features are measured to
    weak = left(np.diag([1e3, 1e3, 1e3, 573.0, 573.0, 0.05]), accuracy=0.01 * np.eye(6))
    assert weak[0] == "1 direction" and weak[2] == np.pi


def test_an_arm_of_few_joints_leaves_open_what_it_can_move_alone():
    L = np.diag([1e3, 0.0, 1e3, 0.0, 0.0, 573.0])
    assert left_by([np.zeros(6)] * 6, L).description == "3 directions"
    for joints in ([0, 2, 5], [0]):
        arm = a_solution(np.eye(6)[:, joints])
        assert left_by([np.zeros(6)] * 6, L, resolution=arm).description == ""


@pytest.mark.parametrize(
    ("up_to", "turn"), [("180°", np.pi), ("90°", np.pi), ("120°", 2.0 * np.pi / 3.0)])
def test_a_symmetric_target_is_the_same_from_round_its_axis(up_to, turn):
    square = [[0.1, 0.0], [0.3, 0.0], [0.3, 0.2], [0.1, 0.2]]
    goal = Goal(features={"points": {"points": square}}, plane=Plane(0.0, 0.0, 4.0))
    way = 2.0 * 0.25 * np.hypot(0.2, 0.1) * np.sin(turn / 2.0)
    left = left_by([np.zeros(6)] * 6, STRONG, ambiguity=up_to, goal=goal)
    assert left.description == up_to and left.angle == pytest.approx(min(turn + TURNS, np.pi))
    left = left_by([[0.1]] * 6, None, goal=goal, ambiguity=up_to)  # the features' L is not known
    assert (left.distance, left.angle) == pytest.approx((way, turn))
    left = left_by([[0.1]] * 6, None, goal=goal)
    assert np.isnan(left.distance) and left.description == ""
    assert bound_symmetry("", goal) == (0.0, 0.0)
    assert bound_symmetry("something else", goal) == (np.inf, np.pi)


@pytest.mark.parametrize("up_to", [72, 90, 180])
@pytest.mark.parametrize("plane", [Plane(0.3, -0.5, 4.0), None])
@pytest.mark.parametrize("middle", ["moments", "points", ""])
def test_the_axis_of_a_symmetric_target_goes_through_its_middle(middle, plane, up_to):
    """The camera, at the origin, is turned about it; without a plane it is level at its depth."""
    corners = np.array([[0.1, -0.05], [0.3, -0.05], [0.3, 0.35], [0.1, 0.35]])  # of a rectangle
    goal = Goal(plane=plane, depth=0.4, **{
        "moments": {"moments": Moments.from_polygon(corners, 2)},
        "points": {"features": {"depth": {"Z": 1.0}, "points": {"points": corners.tolist()}}},
        "": {},
    }[middle])  # fmt: skip
    normal = np.array([0.0, 0.0, 2.5] if plane is None else plane)
    place = np.array([*(corners.mean(axis=0) if middle else (0.0, 0.0)), 1.0])
    place = place / (normal @ place)
    turn = np.radians(144 if up_to == 72 else 180)
    axis = Rotation.from_rotvec(turn * normal / np.linalg.norm(normal))
    way = np.linalg.norm(place - axis.apply(place))
    assert bound_symmetry(f"{up_to}°", goal) == pytest.approx((way, turn), abs=1e-12)


# -- is it the goal's own view? -----------------------------------------------------------------
def alike(seen, wanted, is_turned=False):
    check = view_check.ViewCheck(Goal(moments=wanted))
    for stamp in range(3):
        check.add(Observation(stamp, 1.0, True, "", None, moments=seen))
    return not check.has_other_shape(is_turned)


def shaped(moments, order, j, by):
    """The moments with a central one of an order other by so much, free of scale."""
    centred = moments.centred.copy()
    centred[order - j, j] += by * moments.m00 ** (1.0 + 0.5 * order)
    return Moments(moments.order, moments.kind, moments.m00, moments.xg, moments.yg, centred)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("order", "j"), [(2, 0), (2, 1), (2, 2), (3, 0), (3, 1), (3, 2), (3, 3)])
def test_another_view_is_told_by_each_moment_of_second_and_third_order(order, j, sign):
    """The bound is a part of the goal's greatest, whichever it is and whatever its sign."""
    turned = moments_of(CORNERS @ np.array([[0.6, -0.8], [0.8, 0.6]]) * [1.0, 4.0])
    for wanted, distance in ((moments_of(CORNERS), 0.5), (turned, 1.0)):
        bound = THIRD
        if order == 2:
            second = [wanted.mu(2 - k, k) for k in range(3)]
            bound = view_check.SECOND_ORDER_TOLERANCE * np.abs(second).max() / wanted.m00**2
        here = scaled(wanted, distance)
        assert not alike(shaped(here, order, j, sign * 1.05 * bound), wanted)
        assert alike(shaped(here, order, j, sign * 0.95 * bound), wanted)


def test_views_that_cannot_be_compared_are_not_judged_and_half_a_turn_changes_third_moments():
    wanted, other = moments_of(CORNERS), moments_of(CORNERS * [1.0, 3.0])
    empty = Moments(4, "dense", 0.0, 0.0, 0.0, np.zeros((5, 5)))
    points = Moments.from_points(CORNERS * [1.0, 3.0], 4)
    for seen, goal in ((None, wanted), (other, None), (points, wanted), (other, empty)):
        assert alike(seen, goal)
    turned = moments_of(2.0 * np.array([wanted.xg, wanted.yg]) - CORNERS)
    assert not alike(turned, wanted) and alike(turned, wanted, is_turned=True)
    assert alike(wanted, wanted, is_turned=True)
    for seen in (wanted, turned):
        assert not alike(shaped(seen, 3, 1, 1.2 * THIRD), wanted, is_turned=True)


def test_a_known_offset_explains_where_the_target_is_seen():
    """A camera that is 1 cm aside of its goal at 0.5 m, or as far off along a held direction."""
    goal = Goal(depth=0.5, moments=moments_of(CORNERS))
    check, offset = view_check.ViewCheck(goal), np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    seen = moments_of(CORNERS - [0.02, 0.0])
    for stamp in range(3):
        check.add(Observation(stamp, 1.0, True, "", None, moments=seen))
    here = Observation(2.0, 1.0, True, "", None, moments=seen)
    check.set_expected_place(here, STRONG / np.repeat((1.0, 0.5), 3), np.zeros((6, 6)))
    assert check.compare_place(offset)[0] == ""
    assert "10.0 mm" in check.compare_place(np.zeros(6))[0]
    assert "20.0 mm" in check.compare_place(-offset)[0]
    # where no feature sees it, it is left open
    blind = STRONG[[1, 2, 3, 4, 5]]
    check.set_expected_place(here, blind / np.repeat((1.0, 0.5), 3), np.zeros((6, 6)))
    text, unseen = check.compare_place(np.zeros(6))
    assert text == ""
    np.testing.assert_allclose(unseen, offset, atol=1e-9)


def test_another_view_is_believed_from_the_third_image_and_beyond_noise():
    wanted, other = moments_of(CORNERS), moments_of(CORNERS * [1.0, 0.2])
    goal = Goal(depth=0.5, moments=wanted)
    slightly, noise = ([shaped(wanted, 3, 1, sign * size * THIRD) for sign in (1.0, -1.0)]
                       for size in (1.2, 3.0))  # fmt: skip
    right, zero = Observation(0.0, 0.1, True, "", None, moments=other), np.zeros(6)

    def says(goal, views, L=STRONG, **more):
        """Return of which images another view is reported; None interrupts the loop."""
        arrival, said = Watched(0.0, goal), ""
        for view, error in views:
            if view is None:
                arrival.clear()
                continue
            last = of_camera([zero + error], L, begin=arrival, moments=view, **more).last
            said += "-+"[bool(last.wrong_pose_reason)]
        return said

    for views, expected in (
        ([other] * 4, "--++"), ([other, other, wanted], "---"), (noise * 3, "------"),
        ([slightly[0]] * 3, "--+"), ([slightly[1]] * 3, "--+"),
        # what was seen before the loop was interrupted is forgotten
        ([other, other, None, other, other], "----"),
    ):
        assert says(goal, [(view, 0.0) for view in views]) == expected
    # or before an arrival ended
    assert says(goal, [(other, error) for error in (0.0, 9.0, 0.0, 0.0)]) == "----"
    # of several cameras each is held against its own goal, or against the first's if it has none
    for told, expected in (({"right": Goal(moments=other)}, "-"), ({}, "+")):
        both = Goal(depth=0.5, moments=wanted, camera_name="left", other_cameras=told)
        assert says(both, [(wanted, 0.0)] * 3, others={"right": right})[-1] == expected
    # a direction that nothing measures may be why, unless it is smaller
    blind = np.diag([1e3, 1e3, 1e3, 573.0, 573.0, 0.0])
    assert says(goal, [(slightly[0], 0.0)] * 6, blind) == "------"
    assert says(goal, [(other, 0.0)] * 6, blind)[-1] == "+"
