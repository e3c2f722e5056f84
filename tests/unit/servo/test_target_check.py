"""Whether the target moves by itself: exact features of one that does, before a moving camera."""

from types import SimpleNamespace

import numpy as np
import pytest

from aras_visual_servo_base.poses import transform
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.judging.target_check import TargetCheck, _left

DT, ROW = 1 / 30, 4 / 30  # s: four images are more than the 0.12 s of a row
POSE = transform((0.3, -0.2, 0.5), (2.9, 0.2, -0.4))


def twist(*six):
    """Of the target, the same at all times, in the world."""
    return lambda t: np.array(six)


STEADY, STILL = twist(0.02, -0.01, 0.005, 0.0, 0.0, 0.0), twist(*[0.0] * 6)


def swaying(t):
    """The camera's motion (6,) in one image."""
    return 2e-3 * np.sin([9.0 * t, 6.0 * t, 3.0 * t, 0.0, 0.0, 0.0])


def watched(images, moves, camera=swaying, count=6, known=0.0, check=None, L=None, begin=0.0,
            wraps=(), sits=None, noise=0.0, turns=0.0, dt=DT, **seen):  # fmt: skip
    """What is said after each of so many images of a target that moves by a twist (6,)."""
    check = check or TargetCheck()
    sits = np.eye(3) if sits is None else sits
    draw = np.random.default_rng(4)
    L = draw.normal(size=(count, 6)) if L is None else L
    tolerances = np.resize([1e-3, 2e-3, 1e-3, 3e-3], count)
    error, said = np.zeros(count), []
    for k in range(images):
        t = begin + k * dt
        pose = POSE @ transform((0.0, 0.0, 0.0), (0.0, 0.0, turns * t))
        camera_R_world = pose[:3, :3].T
        own = -np.hstack([L[:, :3] @ camera_R_world, L[:, 3:] @ camera_R_world]) @ moves(t)
        motion = camera(t) + [0.0, 0.0, 0.0, 0.0, 0.0, turns * dt]
        if k:
            error = error + L[:, :3] @ sits @ motion[:3] + L[:, 3:] @ motion[3:] + own * dt
        if k in wraps:
            error = error + 2.0 * np.pi * np.eye(count)[1]
        said.append(check.add(
            SimpleNamespace(error=error + noise * tolerances * draw.normal(size=count), L=L,
                            rate=known * own),
            SimpleNamespace(**{"stamp": t, "dt": dt, "motion": motion, "world_T_camera": pose,
                               **seen}), None, tolerances, True,
        ))  # fmt: skip
    return said


def test_a_steady_target_s_speed_is_told():
    assert watched(60, STEADY)[-1] == "it moves at 22.9 mm/s"
    assert watched(60, STEADY, wraps=(20,))[-1] == "it moves at 22.9 mm/s"  # an angle
    assert watched(60, STEADY, turns=0.5)[-1] == "it moves at 22.9 mm/s"  # seen in turning
    assert not any(watched(120, STILL))


def test_a_turn_is_told_by_more_than_two_numbers_an_image():
    turn = twist(0.0, 0.0, 0.0, 0.1, -0.15, 0.2)
    assert watched(60, turn)[-1] == "it turns"
    assert "it turns" not in watched(200, turn, count=2)


def test_a_swing_is_told_with_its_frequency_once_it_was_seen_for_two_and_a_half_seconds():
    def swing(t):
        return np.cos(2.0 * np.pi * 0.6 * t) * np.array([0.05, -0.03, 0.02, 0.0, 0.0, 0.0])

    said = watched(160, swing)
    told = float(said[-1].removeprefix("it swings at ").removesuffix(" Hz"))
    assert told == pytest.approx(0.6, abs=0.05)
    assert not any("swings" in words for words in said[:77])


def test_a_target_that_the_camera_follows_moves():
    """Nothing moves in the picture, and no depth of 0 is to explain that."""
    def follow(t):
        return DT * np.concatenate([POSE[:3, :3].T @ [0.02, 0.0, 0.0], np.zeros(3)])

    assert watched(60, twist(0.02, 0, 0, 0, 0, 0), follow)[-1] == "it moves at 20.0 mm/s"


@pytest.mark.parametrize(("count", "rows", "images"), [
    (6, 10, 4), (5, 15, 4), (12, 10, 4), (6, 10, 1),
])  # fmt: skip
def test_how_much_has_to_be_seen(count, rows, images):
    """Ten rows that hold sixty numbers; every fifth row is looked at. A row is 0.12 s."""
    said = watched(images * rows + 1, STEADY, count=count, dt=DT if images > 1 else 0.12)
    assert not any(said[:-1]) and said[-1]


@pytest.mark.parametrize(("loud", "told"), [(0.29, False), (0.31, True)])
def test_how_far_the_features_have_to_move(loud, told):
    """Tolerances in a row, rms, before a camera at rest."""
    draw = np.random.default_rng(4)
    L = draw.normal(size=(6, 6)) / np.resize([1.0, 0.5, 1.0, 1.0 / 3.0], 6)[:, None]
    velocity = np.array([0.02, -0.01, 0.005])
    moved = 1e3 * L[:, :3] @ POSE[:3, :3].T @ velocity / np.resize([1.0, 2.0, 1.0, 3.0], 6) * ROW
    velocity *= loud / np.sqrt(np.mean(moved**2))
    assert any(watched(60, twist(*velocity, 0, 0, 0), STILL, L=L)) is told


def test_one_direction_alone_has_no_place_of_a_target():
    L = np.zeros((6, 6))
    L[:, 0] = [5.0, 4.0, -3.0, 2.0, 1.0, -6.0]
    assert not any(watched(120, twist(0.05, 0.02, 0.0, 0, 0, 0), L=L))


@pytest.mark.parametrize("scale", [1e3, 1e-3])
def test_columns_that_are_all_but_alike_explain_nothing(scale):
    """To a millionth: by factors as large as that would take. To a thousandth is no matter."""
    for apart, left in ((1e-6, 1.0), (1e-3, 0.0)):
        found, factors = _left(scale * np.array([[1.0, 1.0], [0.0, apart]]), np.array([0.0, 1.0]))
        assert left - 1e-3 < found < left + 1e-3 and found < 1.0 and factors[0] < 0.0 < factors[1]
    assert _left(np.zeros((2, 2)), np.array([0.6, 0.8]))[0] == pytest.approx(1.0)


def test_other_features_and_images_without_any_begin_anew():
    check = TargetCheck()
    assert not any(watched(37, STEADY, check=check))  # nine rows
    said = watched(41, STEADY, count=8, check=check, begin=2.0)  # and ten of others
    assert not any(said[:-1]) and said[-1]
    check = TargetCheck()
    for part in range(20):  # no row is whole between interruptions
        assert not any(watched(4, STEADY, check=check, begin=0.2 * part))
        check.interrupt()


def test_what_has_no_centre_or_no_depth_is_not_judged_by_it():
    seen = Moments.from_polygon(np.array([(-0.1, -0.05), (0.12, -0.04), (0.08, 0.06)]), 2)
    none = Moments(2, "dense", 0.0, 0.0, 0.0, np.zeros((3, 3)))
    error = SimpleNamespace(error=np.zeros(4), L=None, rate=0.0)
    for now, goal in ((seen, Goal(moments=seen)), (none, Goal(moments=seen, depth=0.5)),
                      (None, Goal(moments=seen, depth=0.5)), (seen, Goal(depth=0.5))):  # fmt: skip
        check = TargetCheck()
        for k in range(3):
            image = SimpleNamespace(stamp=k * DT, dt=DT, motion=swaying(k * DT),
                                    world_T_camera=POSE, moments=now)  # fmt: skip
            assert not check.add(error, image, goal, np.ones(4), False)
        assert check._before[0].shape == (0,)


@pytest.mark.parametrize("unknown", ["motion", "world_T_camera"])
def test_where_the_camera_s_motion_is_not_known_nothing_is(unknown):
    assert not any(watched(60, STEADY, **{unknown: None}))


def test_what_is_long_ago_is_forgotten():
    """It stood still, and has moved for the last six seconds."""
    check = TargetCheck()
    assert not any(watched(120, STILL, check=check))
    check.interrupt()
    assert watched(190, STEADY, check=check, begin=4.0)[-1]


@pytest.mark.parametrize("scale", [0.7, 1.0, 2.0])
def test_a_camera_that_sits_turned_is_no_target_that_moves(scale):
    """Though one that moves would look the same while the camera goes straight on."""
    sits = scale * transform((0.0, 0.0, 0.0), (0.2, -0.3, 0.7))[:3, :3]
    ahead = STEADY(0.0) * DT
    assert not any(watched(120, STILL, lambda t: ahead, sits=sits, noise=0.1))


@pytest.mark.parametrize(("known", "said"), [(1.0, False), (0.5, True), (0.0, True), (-1.0, True)])
def test_a_target_s_motion_that_the_scheme_knows_is_taken_off(known, said):
    assert any(watched(120, STEADY, known=known)) is said
