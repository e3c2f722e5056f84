"""Detection of a moving target from exact features, with a moving camera."""

from types import SimpleNamespace

import numpy as np
import pytest

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.diagnosis.target_check import TargetCheck, _fit_columns
from aras_visual_servo_controller.goals.goal import Goal

DT, ROW = 1 / 30, 4 / 30  # s: four images are more than the 0.12 s of a row
POSE = matrix_from_xyz_rpy((0.3, -0.2, 0.5), (2.9, 0.2, -0.4))


def twist(*six):
    """Return a constant twist of the target in the world."""
    return lambda t: np.array(six)


STEADY, STILL = twist(0.02, -0.01, 0.005, 0.0, 0.0, 0.0), twist(*[0.0] * 6)


def swaying(t):
    """The camera's motion (6,) in one image."""
    return 2e-3 * np.sin([9.0 * t, 6.0 * t, 3.0 * t, 0.0, 0.0, 0.0])


def watched(images, moves, camera=swaying, count=6, known=0.0, check=None, L=None, begin=0.0,
            wraps=(), sits=None, noise=0.0, turns=0.0, dt=DT, jumps=0.0,
            **seen):  # fmt: skip
    """Return what is reported after each image of a target that moves with a twist (6,)."""
    check = check or TargetCheck()
    sits = np.eye(3) if sits is None else sits
    draw = np.random.default_rng(4)
    L = draw.normal(size=(count, 6)) if L is None else L
    tolerances = np.resize([1e-3, 2e-3, 1e-3, 3e-3], count)
    error, said = np.zeros(count), []
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
        said.append(check.add(
            SimpleNamespace(error=error + off * tolerances, L=L, error_drift=known * own),
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


@pytest.mark.parametrize(("loud", "told"), [(0.098, False), (0.102, True)])
def test_how_far_the_features_have_to_move(loud, told):
    """0.3 tolerances in three rows, rms, before a camera at rest."""
    draw = np.random.default_rng(4)
    L = draw.normal(size=(6, 6)) / np.resize([1.0, 0.5, 1.0, 1.0 / 3.0], 6)[:, None]
    velocity = np.array([0.02, -0.01, 0.005])
    moved = 1e3 * L[:, :3] @ POSE[:3, :3].T @ velocity / np.resize([1.0, 2.0, 1.0, 3.0], 6) * ROW
    velocity *= loud / np.sqrt(np.mean(moved**2))
    assert any(watched(60, twist(*velocity, 0, 0, 0), STILL, L=L)[:45]) is told


@pytest.mark.parametrize("speed", [1e-3, 3e-4])
def test_a_slow_target_that_the_camera_follows_moves_nothing_in_the_image(speed):
    """Two tolerances a second, and less: it takes some rows together to tell."""
    velocity = np.array([speed, 0.5 * speed, 0.0])

    def following(t):
        return np.concatenate([POSE[:3, :3].T @ velocity * DT, np.zeros(3)])

    said = watched(200, twist(*velocity, 0, 0, 0), following, noise=0.02)
    assert said[-1].startswith(f"it moves at {1e3 * np.linalg.norm(velocity):.1f} mm/s")
    assert not any(watched(200, STILL, lambda t: 0.1 * swaying(t), noise=0.02))


def test_one_direction_alone_has_no_place_of_a_target():
    L = np.zeros((6, 6))
    L[:, 0] = [5.0, 4.0, -3.0, 2.0, 1.0, -6.0]
    assert not any(watched(120, twist(0.05, 0.02, 0.0, 0, 0, 0), L=L))


@pytest.mark.parametrize("scale", [1e3, 1e-3])
def test_columns_that_are_all_but_alike_explain_nothing(scale):
    """To a millionth: by factors as large as that would take. To a thousandth is no matter."""
    for apart, left in ((1e-6, 1.0), (1e-3, 0.0)):
        found, factors = _fit_columns(
            scale * np.array([[1.0, 1.0], [0.0, apart]]), np.array([0.0, 1.0])
        )
        assert left - 1e-3 < found < left + 1e-3 and found < 1.0 and factors[0] < 0.0 < factors[1]
    assert _fit_columns(np.zeros((2, 2)), np.array([0.6, 0.8]))[0] == pytest.approx(1.0)


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
    error = SimpleNamespace(error=np.zeros(4), L=None, error_drift=0.0)
    for now, goal in ((seen, Goal(moments=seen)), (none, Goal(moments=seen, depth=0.5)),
                      (None, Goal(moments=seen, depth=0.5)), (seen, Goal(depth=0.5))):  # fmt: skip
        check = TargetCheck()
        for k in range(3):
            image = SimpleNamespace(stamp=k * DT, dt=DT, motion=swaying(k * DT),
                                    world_T_camera=POSE, moments=now)  # fmt: skip
            assert not check.add(error, image, goal, np.ones(4), False)
        assert check._last_measurement[0].shape == (0,)


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
    sits = scale * matrix_from_xyz_rpy((0.0, 0.0, 0.0), (0.2, -0.3, 0.7))[:3, :3]
    ahead = STEADY(0.0) * DT
    assert not any(watched(120, STILL, lambda t: ahead, sits=sits, noise=0.1))


@pytest.mark.parametrize(("known", "said"), [(1.0, False), (0.5, True), (0.0, True), (-1.0, True)])
def test_a_target_s_motion_that_the_scheme_knows_is_taken_off(known, said):
    assert any(watched(120, STEADY, known=known)) is said


class Looked:
    """The same check from complete rows, by least squares over all images."""

    def __init__(self):
        self.rows, self.new, self.said, self.images = [], 0, "", []

    def add(self, stamp, error, L, rate, tolerances, motion, pose):
        """Of each image in tolerances; a row is made of all images since the one it begins with."""
        scaled = error / tolerances, L / tolerances[:, None], rate / tolerances
        if self.images and np.abs((scaled[0] - self.images[-1][1][0]) * tolerances).max() > 1.0:
            self.images = [(stamp, scaled, motion)]
            return self.said
        self.images.append((stamp, scaled, motion))
        stamps, seen, motions = zip(*self.images, strict=True)
        if stamps[-1] - stamps[0] < 0.12 - 1e-12:
            return self.said
        self.images = [(stamp, scaled, motion)]
        errors, Ls, rates = (np.array(part) for part in zip(*seen, strict=True))
        past = np.diff(stamps)
        moved = errors[-1] - errors[0] - past @ (rates[1:] + rates[:-1]) / 2.0
        world = np.kron(np.eye(2), pose[:3, :3].T)
        mean = (Ls[1:] + Ls[:-1]).mean(axis=0) / 2.0
        self.rows.append((0.5 * (stamps[0] + stamps[-1]), moved, mean, sum(motions[1:]),
                          -past.sum() * mean @ world))  # fmt: skip
        self.rows = [row for row in self.rows if row[0] >= self.rows[-1][0] - 6.0]
        self.new += 1
        if len(self.rows) >= 10 and self.new >= 5:
            self.new, self.said = 0, self.judged()
        return self.said

    def judged(self):
        stamps, moved, Ls, motions, drifts = zip(*self.rows, strict=True)
        b, drift = np.concatenate(moved), np.vstack(drifts)
        along = np.concatenate([L[:, :3] @ v[:3] for L, v in zip(Ls, motions, strict=True)])
        b = b - np.concatenate([L[:, 3:] @ v[3:] for L, v in zip(Ls, motions, strict=True)])
        depth = along @ b / (along @ along)
        still = b - max(depth, 0.3) * along
        left = still @ still
        if np.sqrt(left / len(b)) < 0.3 or len(b) < 60:
            return ""
        bound = 0.1 * left
        if depth > 0.3:
            bound = min(bound, 0.5 * self.by_another_camera())
        rest, factors = self.rest(np.column_stack([along, drift[:, :3]]), b - along)
        if rest < bound:
            return f"it moves at {1e3 * np.linalg.norm(factors[1:]):.1f} mm/s"
        many = len(b) >= 6 * len(stamps)
        known = np.column_stack([along, drift if many else drift[:, :3]])
        if self.rest(known, b)[0] < bound:
            return "it rotates"
        time = np.concatenate([np.full(len(m), t) for t, m in zip(stamps, moved, strict=True)])
        time = time - stamps[0]
        if time[-1] < 2.5:
            return ""
        found = []
        for frequency in np.arange(1.0, time[-1] * 1.5, 0.25) / time[-1]:
            waves = [drift[:, :3] * wave(2.0 * np.pi * frequency * time)[:, None]
                     for wave in (np.sin, np.cos)]  # fmt: skip
            found.append((self.rest(np.column_stack([known, *waves]), b)[0], frequency))
        least, frequency = min(found)
        return f"it oscillates at {frequency:.2f} Hz" if least < bound else ""

    def by_another_camera(self):
        _, moved, Ls, motions, _ = zip(*self.rows, strict=True)
        columns = np.array([
            [row[i] * v[j] for a in (0, 3) for i in range(a, a + 3) for j in range(a, a + 3)]
            for L, v in zip(Ls, motions, strict=True) for row in L
        ])  # fmt: skip
        b, mixed = np.concatenate(moved), []
        for factors in np.split(np.linalg.lstsq(columns, b, rcond=None)[0], 2):
            # A direction that is moved by too little is moved by that, the others stay.
            M = factors.reshape(3, 3)
            sizes, ways = np.linalg.eigh(M.T @ M)
            longer = np.maximum(1.0, 0.5 / np.sqrt(sizes))
            mixed.append((M @ ways * longer @ ways.T).ravel())
        off = b - columns @ np.concatenate(mixed)
        return off @ off

    @staticmethod
    def rest(columns, values):
        factors = np.linalg.lstsq(columns, values, rcond=None)[0]
        return np.sum((values - columns @ factors) ** 2), factors


@pytest.mark.parametrize(("kind", "count", "seed"), [
    (kind, count, seed) for seed, count in enumerate((3, 6, 7))
    for kind in ("", "it moves", "it rotates", "it oscillates", "another camera")
])  # fmt: skip
def test_the_target_is_judged_as_least_squares_over_all_rows_say(kind, count, seed):
    """Images come irregularly, views, poses and tolerances change, the scheme knows a part."""
    draw = np.random.default_rng(seed)
    check, rows, stamp = TargetCheck(), Looked(), 40.0
    size = {"it moves": 1.0, "it oscillates": 3.0}.get(kind, 0.0)
    velocity = 0.02 * size * draw.normal(size=3)
    turning = 0.2 * (kind == "it rotates") * draw.normal(size=3)
    sits = matrix_from_xyz_rpy(
        (0, 0, 0), (0.2, 0.6, -0.9) if kind == "another camera" else (0, 0, 0)
    )
    base, error = draw.normal(size=(count, 6)), 0.02 * draw.normal(size=count)
    pose, before, said = POSE, None, set()
    for k in range(170):
        dt = draw.uniform(0.02, 0.06)
        stamp += dt
        L = base + 0.3 * np.sin(0.1 * k + np.arange(6))
        tolerances = 1e-3 * (1.0 + np.arange(count)) * (1.0 + 2e-4 * np.sin(0.9 * k))
        motion = 3e-3 * np.sin(np.array([3.1, 2.3, 4.4, 5.0, 1.9, 2.8]) * stamp)
        pose = pose @ matrix_from_xyz_rpy(motion[:3], motion[3:])
        world = np.kron(np.eye(2), pose[:3, :3].T)
        wave = np.cos(2.0 * np.pi * 0.55 * stamp) if kind == "it oscillates" else 1.0
        own = -L @ world @ np.concatenate([velocity * wave, turning])
        rate = 0.3 * own if seed % 2 else np.array([0.02])
        known = own + (0.0 if seed % 2 else 0.02)
        if before is not None:
            moves = np.kron(np.diag([0.8, 1.0]), sits[:3, :3]) @ motion
            error = error + 0.5 * (before[0] + L) @ moves + 0.5 * dt * (before[1] + known)
        before = L, known
        if k == 70:
            error = error + 3.0  # an angle that wrapped
        noisy = error + 0.02 * tolerances * draw.normal(size=count)
        told = check.add(
            SimpleNamespace(error=noisy, L=L, error_drift=rate),
            SimpleNamespace(stamp=stamp, dt=dt, motion=motion, world_T_camera=pose), None,
            tolerances, True,
        )  # fmt: skip
        wanted = rows.add(stamp, noisy, L, np.resize(rate, count), tolerances, motion, pose)
        assert told == wanted, k
        said.add(told)
    if count > 5 or kind != "it rotates":  # of so few numbers a turn may look like anything
        assert said == {""} if "camera" in kind else any(word.startswith(kind) for word in said)


def test_a_depth_explains_however_small_a_motion():
    """Of a camera that creeps by a ten-millionth of what it is believed to; none goes back."""
    ahead = np.concatenate([POSE[:3, :3].T @ STEADY(0.0)[:3], np.zeros(3)])
    assert not any(watched(60, STEADY, lambda t: -1e-7 * ahead))
    assert any(watched(60, STEADY, lambda t: 1e-7 * ahead))
    assert watched(60, STEADY, lambda t: STILL(t))[-1]


@pytest.mark.parametrize(("more", "told"), [(0.93, True), (1.07, False)])
def test_a_tenth_may_be_left_of_what_moves(more, told):
    """Jumps to and fro at the ends of rows, where the camera stands still."""
    L = np.random.default_rng(4).normal(size=(6, 6))
    tolerances = np.resize([1e-3, 2e-3, 1e-3, 3e-3], 6)
    moved = L[:, :3] @ POSE[:3, :3].T @ STEADY(0.0)[:3] * ROW / tolerances
    jumps = more * np.sqrt(np.mean(moved**2) * 0.1 / 0.9) / 2.0
    assert bool(watched(121, STEADY, STILL, jumps=jumps)[-1]) is told


@pytest.mark.parametrize(("factor", "told"), [(0.28, True), (0.32, False)])
def test_a_depth_makes_features_move_by_three_tenths_at_least(factor, told):
    ahead = np.array([0.4, -0.2, 0.1, 0.0, 0.0, 0.0]) * DT
    assert any(watched(60, STILL, lambda t: ahead, sits=factor * np.eye(3))) is told


@pytest.mark.parametrize(("factor", "told"), [(0.47, True), (0.53, False)])
def test_another_camera_moves_in_each_direction_by_half_at_least(factor, told):
    def ahead(t):
        return swaying(t) * [1.0, 1.0, 0.0, 0.0, 0.0, 0.0] + [0.0, 0.0, 8e-3, 0.0, 0.0, 0.0]

    sits = np.diag([1.0, 1.0, factor])
    assert bool(watched(60, STILL, ahead, sits=sits)[-1]) is told


@pytest.mark.parametrize(("frequency", "told"), [(1.4, True), (1.65, False)])
def test_how_fast_a_swing_is_looked_for(frequency, told):
    def swing(t):
        return np.cos(2.0 * np.pi * frequency * t) * np.array([0.09, -0.05, 0.04, 0.0, 0.0, 0.0])

    assert ("oscillates" in watched(160, swing, dt=0.125)[-1]) is told


@pytest.mark.parametrize(("loud", "told"), [(0.048, False), (0.052, True)])
def test_a_centre_has_to_move_by_a_thousandth_s_part(loud, told):
    """0.3 of it in six rows: of the focal length, where the scheme has no L of this view; rms of x
    and y."""
    corners = np.array([(-0.1, -0.05), (0.12, -0.04), (0.08, 0.06)])
    goal, check = Goal(moments=Moments.from_polygon(corners, 2), depth=0.5), TargetCheck()
    step = loud * 1e-3 * np.sqrt(2.0) / 4.0
    said = [check.add(
        SimpleNamespace(error=np.zeros(3), L=None, error_drift=0.0),
        SimpleNamespace(stamp=k * DT, dt=DT, motion=np.zeros(6), world_T_camera=POSE,
                        moments=Moments.from_polygon(corners + [k * step, 0.0], 2)),
        goal, np.ones(3), False) for k in range(165)]  # fmt: skip
    assert any(said) is told


@pytest.mark.parametrize(("jumps", "told"), [(0.19, True), (0.21, False)])
def test_half_may_be_left_of_what_another_camera_leaves(jumps, told):
    """Of a camera that goes straight on, so that another would explain the most of it; what jumps
    leave a number is 4 times their square, and another camera leaves 0.16 besides."""
    def ahead(t):
        return 0.6 * swaying(t) + [4e-3, -2e-3, 1e-3, 0.0, 0.0, 0.0]

    assert bool(watched(161, STEADY, ahead, jumps=jumps)[-1]) is told
