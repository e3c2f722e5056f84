"""Parts of the inverse kinematics, compared with NumPy and closed forms."""

import numpy as np
import pytest
from arms import bent, make

from aras_visual_servo_controller.kinematics import (
    algebra,
    chain,
    compiled_ik,
    held_directions,
    limits,
)
from aras_visual_servo_controller.kinematics.differential_ik import DifferentialIK
from aras_visual_servo_controller.kinematics.elbow import find_elbows
from aras_visual_servo_controller.kinematics.limits import Limits
from aras_visual_servo_controller.kinematics.secondary_tasks import JointLimitAvoidance
from aras_visual_servo_controller.kinematics.task import Task


@pytest.fixture
def plain(monkeypatch):
    """Compiled functions run as Python, where an index beyond an array is an error."""
    for module in (algebra, held_directions, compiled_ik, chain):
        for name, value in list(vars(module).items()):
            if hasattr(value, "py_func"):
                monkeypatch.setattr(module, name, value.py_func)


def answers():
    """Return IK solutions of an ordinary posture and of one near a straight elbow and a limit."""
    arm = make("aras")
    limits = Limits.for_arm(arm, velocity=1.0, acceleration=2.0)
    resolver = DifferentialIK(arm, limits, [JointLimitAvoidance(limits)])
    resolver.goal = arm.pose([0.0, 0.1, 0.3, -0.5, 0.2, 0.1])
    found = []
    for modelled, q in (((1, 1, 0, 1, 1, 0), [0.1, 0.2, 0.6, -0.9, 0.4, 0.5]),
                        ((1, 1, 1, 0, 0, 1), [1.4999, 0.0, 0.1, 1e-3, 0.0, 0.0])):  # fmt: skip
        task = Task.from_twist([0.1, 0.0, -0.05, 0.1, 0.0, 0.2], modelled)
        joints, twists = np.empty((4, 6)), np.empty((3, 6))
        numbers = compiled_ik.solve_velocities(
            *arm.chain, np.array(q), np.empty((4, 4)), np.empty((6, 6)), resolver.goal, task.L,
            task.desired_rate, task.modelled, np.full(6, 0.1), resolver.range_tasks,
            resolver.elbow_rows,
            resolver.limit_rows, 0.01, True, np.full(6, 0.01), resolver.last_velocities,
            resolver.setting_values, joints, twists,
        )  # fmt: skip
        found.append((joints, twists, *numbers))
    return found


def test_python_computes_the_same_within_all_arrays(request):
    compiled = answers()
    request.getfixturevalue("plain")
    with np.errstate(all="ignore"):
        interpreted = answers()
    for one, other in zip(compiled, interpreted, strict=True):
        for value, same in zip(one, other, strict=True):
            np.testing.assert_allclose(value, same, atol=1e-9)


# ------------------------------------------------------------------------------- limits


@pytest.mark.parametrize("room", [1e-12, 1e-3, 0.2, 50.0])
@pytest.mark.parametrize("acceleration", [0.3, 8.0, 1e9])
@pytest.mark.parametrize("dt", [1e-3, 0.05, 2.0])
def test_the_greatest_speed_that_still_stops(room, acceleration, dt):
    """Kept for dt, then braked as hard as can be in many short steps."""
    speed = limits.compute_stopping_speed(room, acceleration, dt)
    steps = np.linspace(speed, 0.0, 1001)
    braking = 0.5 * (steps[1:] + steps[:-1]).sum() * (speed / 1000) / acceleration
    assert speed * dt + braking == pytest.approx(room, rel=1e-9, abs=0.0)


def test_speeds_that_no_braking_bounds():
    assert limits.compute_stopping_speed(0.2, np.inf, 0.05) == pytest.approx(4.0)
    assert limits.compute_stopping_speed(0.0, 2.0, 0.05) == 0.0
    for room, acceleration, dt in [(np.inf, 2.0, 0.05), (np.inf, np.inf, 0.05), (0.2, 2.0, 0.0)]:
        assert limits.compute_stopping_speed(room, acceleration, dt) == np.inf


def test_ranges_leave_room_to_stop_on_either_side():
    q = np.array([0.5, 0.9, -1.2, 1.3, 4.0])  # the third and fourth outside
    lower, upper = np.array([-1.0, -2.0, -1.0, -1.0, -np.inf]), np.array([1.0, 1.0, 1.0, 1.0, 5.0])
    acceleration, dt = np.array([2.0, 3.0, 4.0, 5.0, np.inf]), 0.1
    low, high = limits.compute_velocity_ranges(
        q, np.array([lower, upper, np.ones(5), acceleration]), dt
    )
    assert low[3] < 0.0 == high[3] and low[2] == 0.0 < high[2]
    for speeds, rooms in ((-low, q - lower), (high, upper - q)):
        stopped = speeds[:4] * dt + speeds[:4] ** 2 / (2.0 * acceleration[:4])
        np.testing.assert_allclose(stopped, np.maximum(rooms[:4], 0.0), rtol=1e-12)
    assert low[4] == -np.inf and high[4] == pytest.approx(10.0)


def largest(wanted, room):
    """Return the largest factor up to 1 with which all of wanted (n,) are within the rooms (n,)."""
    moving = wanted != 0.0
    return min(1.0, (np.maximum(room, 0.0)[moving] / np.abs(wanted[moving])).min(initial=1.0))


def test_the_part_that_all_rooms_allow_and_whose_is_least():
    random = np.random.default_rng(3)
    for _ in range(50):
        wanted, room = random.normal(size=5), random.uniform(0.0, 2.0, 5)
        part, joint = compiled_ik._find_scale(wanted, room)
        assert part == pytest.approx(largest(wanted, room))
        assert part == 1.0 or joint == (room / np.abs(wanted)).argmin()
    assert compiled_ik._find_scale(np.array([0.5, -1.0, 0.0]), np.array([1.0, -0.1, -0.1])) == (
        0.0,
        1,
    )
    assert compiled_ik._find_scale(np.zeros(3), np.zeros(3))[0] == 1.0


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("unchanged", [False, True])
@pytest.mark.parametrize("strong", [0.2, 1.0, 3.0])
def test_velocities_within_all_limits(limited, unchanged, strong):
    random, dt = np.random.default_rng(4), 0.1
    for _ in range(20):
        wanted, secondary, total = strong * random.normal(size=(3, 5))
        low, high = -random.uniform(0.0, 3.0, 5), random.uniform(0.0, 3.0, 5)
        fastest, acceleration = random.uniform(0.5, 2.0, (2, 5))
        task = total - 0.3 * random.normal(size=5)
        previous = total.copy()
        previous[random.integers(5)] += (5e-10 if unchanged else 2e-9) * random.choice([-1.0, 1.0])
        limits = np.array([low, high, fastest, 10.0 * acceleration])
        got, primary, scale, slowest = compiled_ik._limit_velocities(
            wanted, secondary, low, high, limits, dt, limited, previous, total, task
        )
        part = largest(wanted, fastest)
        direct, kept, slowed = part * wanted, np.zeros(5), part < 1.0
        joint = (fastest / np.abs(wanted)).argmin()
        lowest, highest = np.maximum(low, -fastest), np.minimum(high, fastest)
        if limited:
            before = task if unchanged else previous
            kept, steps, change = previous - before, direct - before, acceleration
            part = largest(steps, change)
            if part < 1.0:
                slowed, joint = True, (change / np.abs(steps)).argmin()
            direct = before + part * steps
            lowest, highest = (
                np.clip(bound, previous - change, previous + change) for bound in (lowest, highest)
            )
        first = np.clip(direct + kept, lowest, highest)
        more = secondary - kept
        part = largest(more, np.where(more > 0.0, highest - first, first - lowest))
        np.testing.assert_allclose(got, first + part * more, atol=1e-12)
        np.testing.assert_allclose(primary, direct, atol=1e-12)
        assert slowest == (joint if slowed else -1)
        along = direct @ wanted / (wanted @ wanted)
        assert scale == pytest.approx(along if slowed else 1.0)


# ------------------------------------------------------------------------ demand, solution


def directions(random, count):
    """Orthonormal (count, 6), and the others (6 - count, 6)."""
    both = np.linalg.qr(random.normal(size=(6, 6)))[0]
    return both[:count], both[count:]


@pytest.mark.parametrize("count", [0, 2, 3])
def test_a_demand_is_what_is_held_and_the_task_in_the_rest(count):
    random, least, fully = np.random.default_rng(count), 0.1, 0.9
    partly = 0
    for rows in (1, 3, 8):
        keep, free = directions(random, count)
        L, rate = random.normal(size=(rows, 6)), random.normal(size=rows)
        L[:, 0] *= 0.02
        speeds, scaled = random.normal(size=count), 0.4 * random.normal(size=(6, 5))
        basis, wanted, weights = compiled_ik._build_rows(
            L, rate, keep, speeds, free, scaled, least, fully
        )
        turned, reach, _ = np.linalg.svd(keep @ scaled, full_matrices=False)
        part = np.clip((reach - least) / (fully - least), 0.0, 1.0)
        smooth = np.array([np.polyval([-2.0, 3.0, 0.0, 0.0], one) for one in part])
        partly += ((part > 0.0) & (part < 1.0)).sum()
        along = turned.T @ keep
        served = along.T @ (smooth * (turned.T @ speeds))
        _, s, vt = np.linalg.svd(L @ free.T, full_matrices=False)
        seen = vt @ free
        twist = np.linalg.pinv(L @ free.T) @ (rate - L @ served) @ free + speeds @ keep
        np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-12)
        np.testing.assert_allclose(basis.T @ wanted, twist, atol=1e-9)
        np.testing.assert_allclose(
            (basis.T * weights) @ basis,
            (seen.T * np.minimum(1.0, s / (0.05 * s[0]))) @ seen + (along.T * smooth) @ along,
            atol=1e-9,
        )
    assert partly or not count


@pytest.mark.parametrize("joints", [4, 6, 7])
@pytest.mark.parametrize("weakest", [0.0, 0.004, 0.5])
def test_a_solution_is_that_of_damped_least_squares(joints, weakest):
    """Of a random arm whose least singular value is given, one of its joints fixed, and whose
    joints' motions count as much as each other in units of their own."""
    random, damping, below = np.random.default_rng(joints), 0.003, 0.012
    free = np.arange(joints + 1) != 2
    for rows in (2, 4, 6):
        u, s, vt = np.linalg.svd(random.normal(size=(6, joints)), full_matrices=False)
        s[-1] = weakest
        scaled = np.insert((u * s) @ vt, 2, random.normal(size=6), axis=1)
        basis, weights = directions(random, rows)[0], random.uniform(0.2, 1.0, rows)
        wanted, wish = random.normal(size=rows), random.normal(size=joints + 1)
        fixed, units = np.where(free, 0.0, 0.7), random.uniform(0.1, 3.0, joints + 1)
        primary, secondary = compiled_ik._solve_damped(
            scaled / units, basis, wanted, weights, wish, free, fixed, damping, below, units
        )
        # In units of its own each joint moves the camera as `scaled` says.
        primary, secondary, fixed = primary / units, secondary / units, fixed / units
        wish = wish / units
        demand = np.diag(weights) @ basis
        task = demand @ scaled[:, free]
        rates = weights * wanted - fixed[2] * demand @ scaled[:, 2]
        damped = np.zeros(joints)
        if weakest < below:
            strength = max(np.linalg.norm(demand @ u[:, -1]), 0.3)
            damped = damping * np.sqrt(1.0 - (weakest / below) ** 2) * strength * vt[-1]
        inverse = np.linalg.pinv(np.vstack([task, damped]), rcond=1e-9)[:, :rows]
        np.testing.assert_allclose(primary[free], inverse @ rates, atol=1e-8)
        np.testing.assert_allclose(secondary[free], (np.eye(joints) - inverse @ task) @ wish[free],
                                   atol=1e-8)  # fmt: skip
        assert primary[2] == fixed[2] and secondary[2] == 0.0


# ----------------------------------------------------------------------- stretched elbows

# Limits of two joints that do not bind; both joints count in the same units.
ROWS = np.array([[9.0] * 2] * 4 + [[1.0] * 2])


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("other", [-0.5, 0.5])
@pytest.mark.parametrize(("bend", "speed", "expected", "straight"), [
    (0.0, 0.1, 0.1, False),  # away from straight: of the bent arm
    (0.03, 0.1, 0.1, False),
    (0.03, -0.1, -0.2, False),  # back to it: of the arm as it is
    (0.03, -0.8, -1.5, True),  # half of the bend is the most
    (0.2, 0.1, 0.2, False), (0.2, -0.1, -0.2, False),  # bent enough: as it is
])  # fmt: skip
def test_only_the_way_out_of_straight_is_that_of_the_bent_arm(
    side, other, bend, speed, expected, straight
):
    """Of two joints that move the camera along an axis each, both elbows; the second is bent."""
    folds = np.array([[0.0, 0.25, side], [1.0, -0.25, 1.0]])
    for second in (-0.3, 0.3):
        solution, _, free, stopped, stretched = compiled_ik._solve_within_ranges(
            np.eye(6)[:, :2] * [0.5, 1.0], np.eye(6)[:, :2], np.eye(6)[:2],
            np.array([side * speed, second]), np.ones(2), np.zeros(2), np.full(2, -9.0),
            np.full(2, 9.0), folds, ROWS,
            np.array([0.25 + side * bend, other - 0.25]), 0.01, 0.1, np.array([0.0, 1e-9]),
        )  # fmt: skip
        np.testing.assert_allclose(solution, [side * expected, second], atol=1e-9)
        assert stretched == straight and free.tolist() == [not straight, True]
        assert not len(stopped)


@pytest.mark.parametrize("bend", [0.03, 0.2])
def test_damping_is_the_same_whichever_arm_is_solved_for(bend):
    """Slightly bent, on the way out of straight, it is the bent one."""
    arms = np.eye(6)[:, :2] * [0.5, 1.0], np.eye(6)[:, :2] * [0.7, 0.9]
    rest = np.eye(6)[:2], np.array([0.3, 0.1]), np.ones(2), np.zeros(2)
    folds, q = np.array([[0.0, 0.0, 1.0]]), np.array([bend, 0.0])
    for damping in ([0.4, 5.0], [0.1, 2.0]):
        solution = compiled_ik._solve_within_ranges(
            *arms, *rest, np.full(2, -9.0), np.full(2, 9.0), folds, ROWS, q, 0.01,
            0.1, np.array(damping))[0]  # fmt: skip
        expected = compiled_ik._solve_damped(arms[int(bend < 0.1)], *rest, np.ones(2, bool),
            np.zeros(2),
                                     *damping, np.ones(2))[0]  # fmt: skip
        np.testing.assert_allclose(solution, expected)
        swapped = compiled_ik._solve_damped(arms[int(bend < 0.1)], *rest, np.ones(2, bool),
            np.zeros(2),
                                     *damping[::-1], np.ones(2))[0]  # fmt: skip
        assert np.abs(solution - swapped).max() > 1e-3


@pytest.mark.parametrize("reached", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_what_one_joint_cannot_do_another_does(reached, sign):
    """Two joints along the same axis; one may only move by 0.1 m/s."""
    room = np.where(np.arange(2) == reached, 0.1, 9.0)
    solution, _, free, stopped, straight = compiled_ik._solve_within_ranges(
        np.eye(6)[:, [0, 0]], np.eye(6)[:, [0, 0]], np.eye(6)[:1], np.array([sign]), np.ones(1),
        np.zeros(2), -room, room, np.zeros((0, 7)), ROWS, np.zeros(2), 0.01, 0.1,
        np.array([0.0, 1e-9]),
    )  # fmt: skip
    np.testing.assert_allclose(solution, sign * np.where(room < 1.0, 0.1, 0.9))
    assert stopped.tolist() == [reached] and free.tolist() == (room > 1.0).tolist()
    assert not straight


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("name", ["aras", "ur5"])
def test_a_bent_posture_is_the_elbow_s_at_its_least_bend(name, side):
    arm, reach = make(name), 0.05
    (fold,) = find_elbows(arm, {arm.names[find_elbows(arm)[0].joint]: side})
    rows = np.array([list(vars(fold).values())], float)
    q = np.linspace(-0.3, 0.4, len(arm))
    for angle, wanted in (
        (0.0, side * reach), (-5e-10, side * reach), (5e-10, side * reach), (0.01, reach),
        (-0.01, -reach), (0.06, None), (-0.06, None),
    ):  # fmt: skip
        here = bent(fold, q, angle)
        posture, other = compiled_ik._bend_elbows(here, rows, reach)
        expected = here if wanted is None else bent(fold, here, wanted)
        np.testing.assert_allclose(posture, expected, atol=1e-12)
        assert other == (wanted is not None)


def test_rotations_are_scaled_by_a_length():
    twists = np.random.default_rng(6).normal(size=(6, 7))
    expected = np.diag([1.0, 1.0, 1.0, 0.3, 0.3, 0.3]) @ twists
    np.testing.assert_allclose(compiled_ik._scale_rotations(twists, 0.3), expected)
