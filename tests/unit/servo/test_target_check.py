"""Detection of a moving target from exact features, with a moving camera."""

import numpy as np
import pytest
from loop_rig import an_image

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_controller import Goal, Moments
from aras_visual_servo_controller.diagnosis.feature_rows import FeatureHistory
from aras_visual_servo_controller.diagnosis.target_motion_check import TargetMotionCheck

DT = 1 / 30  # s: four images are more than the 0.12 s of a row
POSE = matrix_from_xyz_rpy((0.3, -0.2, 0.5), (2.9, 0.2, -0.4))


def twist(*six):
    return lambda t: np.array(six)


def follow(velocity):
    """The motion (6,) in one image of a camera that keeps up with a velocity (3,) in the world."""
    return lambda t: DT * np.concatenate([POSE[:3, :3].T @ velocity, np.zeros(3)])


STEADY, STILL = twist(0.02, -0.01, 0.005, 0.0, 0.0, 0.0), twist(*[0.0] * 6)


def swaying(t):
    return 2e-3 * np.sin([9.0 * t, 6.0 * t, 3.0 * t, 0.0, 0.0, 0.0])


def watched(images, moves, camera=swaying, count=6, known=0.0, check=None, L=None, begin=0.0,
            wraps=(), sits=None, noise=0.0, turns=0.0, dt=DT, jumps=0.0,
            **seen):  # fmt: skip
    """Return what is reported after each image of a target that moves with a twist (6,)."""
    check = check or TargetMotionCheck()
    sits = np.eye(3) if sits is None else sits
    draw = np.random.default_rng(4)
    L = draw.normal(size=(count, 6)) if L is None else L
    tolerances = np.resize([1e-3, 2e-3, 1e-3, 3e-3], count)
    error, said, history = np.zeros(count), [], FeatureHistory()
    for k in range(images):
        t = begin + k * dt
        pose = POSE @ matrix_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, turns * t))
        camera_R_world = pose[:3, :3].T
        own = -np.hstack([L[:, :3] @ camera_R_world, L[:, 3:] @ camera_R_world]) @ moves(t)
        motion = camera(t) + [0.0, 0.0, 0.0, 0.0, 0.0, turns * dt]
        if k:
            error = error + L[:, :3] @ sits @ motion[:3] + L[:, 3:] @ motion[3:] + own * dt
        if k in wraps:
            error = error + 2.0 * np.pi * np.eye(count)[1]
        off = noise * draw.normal(size=count) + jumps * (-1) ** (k // 4)
        image = an_image(**{"stamp": t, "dt": dt, "motion": motion, "world_T_camera": pose, **seen})
        history.add(image, error + off * tolerances, L, known * own, tolerances, True)
        said.append(check.add(history, image, None))
    return said


@pytest.mark.parametrize(("given", "said"), [
    ({}, True), ({"wraps": (20,)}, True), ({"turns": 0.5}, True),  # an angle; seen in turning
    # a motion that the scheme knows is taken off
    ({"known": 1.0}, False), ({"known": 0.5}, True), ({"known": -1.0}, True),
    ({"motion": None}, False), ({"world_T_camera": None}, False),  # of what is not known
])  # fmt: skip
def test_a_steady_target_s_speed_is_told(given, said):
    found = watched(60, STEADY, **given)
    assert any(found) is said and not any(watched(120, STILL, **given))
    if said and "known" not in given:
        assert found[-1] == "it moves at 22.9 mm/s"


def test_a_turn_is_told_by_more_than_two_numbers_an_image():
    turn = twist(0.0, 0.0, 0.0, 0.1, -0.15, 0.2)
    assert watched(60, turn)[-1] == "it rotates"
    for axis in np.eye(3):  # of five numbers neither
        assert "it rotates" not in watched(200, twist(0.0, 0.0, 0.0, *(0.2 * axis)), count=5)
    assert "it rotates" not in watched(200, turn, count=2)


def test_a_swing_is_told_with_its_frequency_once_it_was_seen_for_two_and_a_half_seconds():
    def swing(t):
        return np.cos(2.0 * np.pi * 0.6 * t) * np.array([0.05, -0.03, 0.02, 0.0, 0.0, 0.0])

    said = watched(160, swing)
    told = float(said[-1].removeprefix("it oscillates at ").removesuffix(" Hz"))
    assert told == pytest.approx(0.6, abs=0.05)
    assert not any("oscillates" in words for words in said[:77])


@pytest.mark.parametrize("speed", [1e-3, 3e-4])
def test_a_slow_target_that_the_camera_follows_moves_nothing_in_the_image(speed):
    """Two tolerances a second, and less: it takes some rows together to tell."""
    # Nothing moves in the picture, and no depth of 0 is to explain that.
    fast = np.array([0.02, 0.0, 0.0])
    assert watched(60, twist(*fast, 0, 0, 0), follow(fast))[-1] == "it moves at 20.0 mm/s"
    velocity = np.array([speed, 0.5 * speed, 0.0])
    said = watched(200, twist(*velocity, 0, 0, 0), follow(velocity), noise=0.02)
    assert said[-1].startswith(f"it moves at {1e3 * np.linalg.norm(velocity):.1f} mm/s")
    assert not any(watched(200, STILL, lambda t: 0.1 * swaying(t), noise=0.02))


def test_of_what_is_not_known_nothing_is_told():
    L = np.zeros((6, 6))  # one direction alone has no place of a target
    L[:, 0] = [5.0, 4.0, -3.0, 2.0, 1.0, -6.0]
    assert not any(watched(120, twist(0.05, 0.02, 0.0, 0, 0, 0), L=L))
    # It stood still, long ago, and has moved for the last six seconds.
    check = TargetMotionCheck()
    assert not any(watched(120, STILL, check=check))
    assert watched(190, STEADY, check=check, begin=4.1)[-1]


def test_other_features_and_images_without_any_begin_anew():
    check = TargetMotionCheck()
    assert not any(watched(37, STEADY, check=check))  # nine rows
    said = watched(41, STEADY, count=8, check=check, begin=2.0)  # and ten of others
    assert not any(said[:-1]) and said[-1]
    check = TargetMotionCheck()
    for part in range(20):  # no row is whole between interruptions
        assert not any(watched(4, STEADY, check=check, begin=0.2 * part))


def test_what_has_no_centre_or_no_depth_is_not_judged_by_it():
    seen = Moments.from_polygon(np.array([(-0.1, -0.05), (0.12, -0.04), (0.08, 0.06)]), 2)
    none = Moments(2, "dense", 0.0, 0.0, 0.0, np.zeros((3, 3)))
    for now, goal in ((seen, Goal(moments=seen)), (none, Goal(moments=seen, depth=0.5)),
                      (None, Goal(moments=seen, depth=0.5)), (seen, Goal(depth=0.5))):  # fmt: skip
        check = TargetMotionCheck()
        for k in range(3):
            image = an_image(k * DT, DT, swaying(k * DT), world_T_camera=POSE, moments=now)
            assert not check.add(None, image, goal)


@pytest.mark.parametrize("scale", [0.7, 1.0, 2.0])
def test_a_camera_that_sits_turned_is_no_target_that_moves(scale):
    """Though one that moves would look the same while the camera goes straight on."""
    sits = scale * matrix_from_xyz_rpy((0.0, 0.0, 0.0), (0.2, -0.3, 0.7))[:3, :3]
    ahead = STEADY(0.0) * DT
    assert not any(watched(120, STILL, lambda t: ahead, sits=sits, noise=0.1))


def test_a_depth_explains_however_small_a_motion():
    """Of a camera that creeps by a ten-millionth of what it is believed to; none goes back."""
    ahead = follow(STEADY(0.0)[:3])(0.0) / DT
    for creep, told in ((-1e-7, False), (1e-7, True), (0.0, True)):
        assert any(watched(60, STEADY, lambda t, creep=creep: creep * ahead)) is told
