"""Differential IK: exact if possible, otherwise least squares, and always within the limits."""

import itertools

import numpy as np
import pytest
from arms import NAMES, bent, make, urdf, within

from aras_visual_servo_base.poses import pose_difference, rotation_vector
from aras_visual_servo_controller.errors import ConfigurationError, InvalidTaskError
from aras_visual_servo_controller.kinematics import (
    Arm,
    CommandLimits,
    DifferentialIK,
    IKSettings,
    JointLimitAvoidance,
    PostureTask,
    SecondaryTask,
    SingularityAvoidance,
)
from aras_visual_servo_controller.kinematics.command_limits import (
    compute_stopping_speed,
    compute_velocity_ranges,
)
from aras_visual_servo_controller.kinematics.elbow import find_elbows
from aras_visual_servo_controller.kinematics.ik_solution import IKSolution, rank
from aras_visual_servo_controller.kinematics.task import Task

ALL = (True,) * 6
MOMENTS = (True, True, True, False, False, True)
REGULAR = {
    "aras": [0.1, 0.2, 0.6, -0.9, 0.4, 0.5],
    "ur5": [0.2, -1.2, 1.4, -0.8, -1.3, 0.3],
    "panda": [0.2, -0.4, 0.3, -1.8, 0.2, 1.6, 0.5],
}


def four_points(depth=0.4, size=0.05):
    """Return the ill-conditioned interaction matrix (8, 6) of a small square viewed obliquely."""
    rows = []
    for x, y in ((-size, -size), (size, -1.2 * size), (1.1 * size, size), (-size, 1.3 * size)):
        rows.append([-1 / depth, 0, x / depth, x * y, -(1 + x * x), y])
        rows.append([0, -1 / depth, y / depth, 1 + y * y, -x * y, -x])
    return np.array(rows)


def goto(resolver, q, goal, modelled=ALL, gain=2.0, dt=0.02, steps=300):
    """Drive an exact camera to a pose by its twist; returns the joints (steps + 1, n)."""
    path, velocities = [np.array(q, float)], None
    for _ in range(steps):
        pose = resolver.arm.pose_and_jacobian(path[-1])[0]
        place = pose[:3, :3].T @ (goal[:3, 3] - pose[:3, 3])
        turn = rotation_vector(pose[:3, :3].T @ goal[:3, :3])
        task = Task.from_twist(gain * np.concatenate([place, turn]), modelled)
        velocities = resolver.solve(path[-1], task, dt, velocities).velocities
        path.append(path[-1] + velocities * dt)
    return np.array(path)


@pytest.mark.parametrize("name", ["ur5", "panda"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 300.0])
def test_exact_away_from_singularities(name, scale):
    arm, random = make(name), np.random.default_rng(1)
    resolver, q = DifferentialIK(arm, settings=IKSettings()), np.array(REGULAR[name])
    for L in (np.eye(6), scale * four_points()[:6], random.normal(size=(4, 6)), four_points()):
        # A rate that some twist gives, small enough for no limit.
        task = Task.from_interaction(L, 0.01 * L @ random.normal(size=6))
        answer = resolver.solve(q, task, 0.01)
        off = np.abs(task.L @ arm.jacobian(q) @ answer.velocities - task.desired_rate).max()
        assert off < 1e-9 * max(np.abs(task.desired_rate).max(), 1.0)
        assert answer.scale == 1.0 and not answer.reasons
        assert np.abs(answer.achieved_twist - arm.jacobian(q) @ answer.velocities).max() < 1e-12
        assert np.abs(answer.infeasible_twist).max() < 1e-9
    # seven joints take the shortest velocities
    answer, J = resolver.solve(q, Task.from_twist(0.1 * np.ones(6)), 0.01), arm.jacobian(q)
    assert np.abs(answer.velocities - 0.1 * np.linalg.pinv(J) @ np.ones(6)).max() < 1e-12
    assert len(q) == 6 or np.abs(J @ answer.null_direction).max() < 1e-9


@pytest.mark.parametrize("joints", [("J1", "J2", "J3", "J6"), ("gantry", "J2", "J3", "J5", "J6")])
def test_fewer_joints_do_what_they_can(joints):
    arm = Arm.from_urdf(urdf("aras"), joints=joints)
    q = np.array([0.1, 0.6, -0.9, 0.4, 0.5])[-len(joints) :]
    L = np.eye(6)
    L[3:] *= 0.1  # a radian counts as the resolver's length
    twist = np.array([0.01, 0.02, -0.01, 0.05, 0.02, 0.03])
    answer = DifferentialIK(arm).solve(q, Task.from_interaction(L, L @ twist), 0.01)
    scaled = L @ arm.jacobian(q)
    best = np.linalg.lstsq(scaled, L @ twist, rcond=None)[0]
    assert np.abs(answer.velocities - best).max() < 1e-9
    assert np.abs(answer.infeasible_twist - (twist - arm.jacobian(q) @ best)).max() < 1e-9
    assert answer.reasons[0].startswith("the arm cannot produce this motion here: ")
    assert answer.rank == len(joints) and len(answer.singular_values) == len(joints)


@pytest.mark.parametrize(("asked", "named"), [
    ([0.0, 0.04, -0.02001, 0.0, 0.0, 0.0], "vy 0.04 m/s, vz -0.02 m/s"),
    ([0.0, 0.04, 0.02, 0.0, 0.0, 0.0], "vy 0.04 m/s"),
    ([0.0, 0.03, 0.0, 0.5, 0.0, 0.0], "vy 0.03 m/s, wx 0.5 rad/s"),
    ([0.0, 0.0, 0.02, 0.0, 0.5, 0.0], "wy 0.5 rad/s"),
])  # fmt: skip
def test_what_is_lost_is_named_from_half_of_the_most_on(asked, named):
    """A radian counts as 0.1 m. One joint along x of the camera; the rest is lost."""
    slide = Arm.from_urdf("""<robot name="slide"><link name="base"/><link name="camera"/>
        <joint name="along" type="prismatic"><parent link="base"/><child link="camera"/>
        <axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
        </robot>""", "camera")
    answer = DifferentialIK(slide).solve(np.zeros(1), Task.from_twist(asked), 0.01)
    assert answer.reasons == (f"the arm cannot produce this motion here: {named}",)


@pytest.mark.parametrize(("apart", "accuracy", "seen"), [
    (1e-13, 0.0, False),  # as much as rounding
    (1e-7, 0.0, True),  # more, of features that are exact
    (1e-7, 1e-6, False),  # less than they are measured to
    (1e-7, 1e-9, True),
])  # fmt: skip
def test_what_l_does_not_see_is_not_asked_for(apart, accuracy, seen):
    """Two features that are one, but for a part of them."""
    arm, q = make("ur5"), np.array(REGULAR["ur5"])
    L = np.array([[1.0, 0, 0, 0, 0, 0], [1.0, apart, 0, 0, 0, 0]])
    task = Task.from_interaction(L, [0.01, -0.01], accuracy=accuracy)
    answer = DifferentialIK(arm).solve(q, task.measurable_task, 0.01)
    assert (np.abs(answer.velocities).max() > 1.0) == seen
    most = 0.02 / apart if seen else 0.0
    assert np.abs(answer.desired_twist).max() == pytest.approx(most, rel=1e-3)
    assert answer.rank == 1 + seen


@pytest.mark.parametrize("accuracy", [np.nan, None, "small", [0.1, 0.1], np.ones((3, 1))])
def test_an_accuracy_is_one_finite_number_or_has_a_row_for_each_of_l(accuracy):
    with pytest.raises(InvalidTaskError, match="accuracy must be finite|not an array of numbers"):
        Task(np.eye(6)[:2], np.ones(2), np.ones(6, bool), accuracy=accuracy)


def test_nothing_seen_is_nothing_asked_for():
    arm, q = make("ur5"), np.array(REGULAR["ur5"])
    task = Task.from_interaction(np.zeros((2, 6)), [0.1, 0.1])
    nothing = DifferentialIK(arm).solve(q, task, 0.01)
    assert not nothing.velocities.any() and nothing.rank == 0
    for scale, rank_of_task in ((0.0, 0), (1e-6, 6), (1.0, 6)):
        assert Task.from_interaction(scale * np.eye(6), np.zeros(6)).rank == rank_of_task


def test_answer_tells_the_condition_of_the_task():
    arm, q, L = make("ur5"), np.array(REGULAR["ur5"]), four_points()
    answer = DifferentialIK(arm).solve(q, Task.from_interaction(L, np.zeros(8)), 0.01)
    for found, matrix in ((answer.singular_values, L @ arm.jacobian(q)),
                          (answer.singular_values_L, L)):  # fmt: skip
        assert found == pytest.approx(np.linalg.svd(matrix, compute_uv=False), rel=1e-9)
    assert answer.manipulability == pytest.approx(np.prod(answer.singular_values))
    assert answer.margins == pytest.approx(np.minimum(q - arm.lower, arm.upper - q))
    assert answer.rank == 6


# ------------------------------------------------------------------ directions not modelled


@pytest.mark.parametrize("name", NAMES)
def test_attitude_comes_back_to_the_goal_s(name):
    arm = make(name)
    resolver = DifferentialIK(arm, CommandLimits.for_arm(arm, velocity=1.0))
    q = np.array(REGULAR[name])
    if name == "aras":
        q[4] = 0.3  # level
    resolver.goal = arm.pose(q)
    away = q.copy()
    away[2] += 0.1
    path = goto(resolver, away, arm.pose(q), MOMENTS)
    distance, angle = pose_difference(arm.pose(path[-1]), arm.pose(q))
    assert distance < 1e-4 and angle < 1e-4


def test_without_a_goal_the_first_attitude_is_kept_until_reset():
    arm, q = make("ur5"), np.array(REGULAR["ur5"])
    resolver = DifferentialIK(arm)
    still = Task.from_twist(np.zeros(6), (1, 1, 1, 0, 0, 0))
    assert np.abs(resolver.solve(q, still, 0.01).velocities).max() < 1e-12
    away = q + 0.05
    assert np.abs(resolver.solve(away, still, 0.01).velocities).max() > 0.01
    resolver.reset()
    assert np.abs(resolver.solve(away, still, 0.01).velocities).max() < 1e-12


# ------------------------------------------------------------------------------- limits


class Constant(SecondaryTask):
    """Wants always the same."""

    def __init__(self, wish):
        self.wish = np.array(wish, float)

    def velocity(self, q):
        return self.wish


def test_speed_limits_keep_the_direction():
    arm, q = make("ur5"), np.array(REGULAR["ur5"])
    twist = np.array([0.2, 0.1, -0.2, 0.5, 0.3, 1.0])
    free, slow = (DifferentialIK(arm, CommandLimits.for_arm(arm, **limits)).solve(
        q, Task.from_twist(twist), 0.01) for limits in ({}, {"velocity": 0.1}))
    assert np.abs(slow.velocities).max() == pytest.approx(0.1, rel=1e-12)
    assert slow.scale == pytest.approx(0.1 / np.abs(free.velocities).max(), rel=1e-9)
    assert np.abs(slow.achieved_twist - slow.scale * twist).max() < 1e-9
    assert slow.limiting_joint == arm.names[int(np.abs(free.velocities).argmax())]
    percent, joint = 100.0 * slow.scale, slow.limiting_joint
    assert f"velocity scaled to {percent:.0f} % (limit of {joint})" in slow.reasons


@pytest.mark.parametrize("acceleration", [None, 0.5])
def test_secondary_tasks_never_slow_the_task(acceleration):
    arm, q = make("panda"), np.array(REGULAR["panda"])
    limits = CommandLimits.for_arm(arm, velocity=0.5, acceleration=acceleration)
    task, dt = Task.from_twist([0.02, 0.01, -0.02, 0.05, 0.03, 0.1]), 0.01
    alone = DifferentialIK(arm, limits)
    wild = DifferentialIK(arm, limits, [Constant(np.full(7, 50.0))])
    before = other = np.zeros(7)
    for _ in range(60):
        one, two = alone.solve(q, task, dt, before), wild.solve(q, task, dt, other)
        assert two.scale == pytest.approx(one.scale, abs=1e-9)
        assert np.abs(two.achieved_twist - one.achieved_twist).max() < 1e-9
        assert np.abs(two.velocities).max() <= 0.5 + 1e-12
        before, other = one.velocities, two.velocities
    assert one.scale == 1.0
    assert np.abs(two.velocities - one.velocities).max() > 0.2  # and yet they are served


def test_acceleration_limits_keep_the_direction():
    arm, q = make("ur5"), np.array(REGULAR["ur5"])
    resolver = DifferentialIK(arm, CommandLimits.for_arm(arm, velocity=1.0, acceleration=2.0))
    twist, velocities = np.array([0.1, 0.05, -0.1, 0.2, 0.1, 0.3]), np.zeros(6)
    for step in range(40):
        answer = resolver.solve(q, Task.from_twist(twist), 0.01, velocities)
        assert np.abs(answer.velocities - velocities).max() <= 0.02 + 1e-12
        along = answer.achieved_twist @ twist / np.linalg.norm(twist) ** 2
        assert np.abs(answer.achieved_twist - along * twist).max() < 1e-9
        assert answer.scale == pytest.approx(along, abs=1e-9)
        velocities = answer.velocities
        if step == 0:
            assert 0.0 < answer.scale < 1.0
    assert answer.scale == 1.0


def test_a_joint_at_its_limit_stops_and_the_others_go_on():
    arm = make("panda")
    q = np.array(REGULAR["panda"])
    q[6] = arm.upper[6] - 1e-3
    twist = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.5])
    if arm.jacobian(q)[5, 6] < 0.0:
        twist[5] = -0.5
    answer = DifferentialIK(arm).solve(q, Task.from_twist(twist), 0.01)
    assert answer.stopped_joints == (arm.names[6],)
    assert answer.velocities[6] == pytest.approx(0.1, rel=1e-9)  # to the limit itself
    assert f"{arm.names[6]} stopped at its limit" in answer.reasons
    assert np.abs(answer.achieved_twist - twist).max() < 0.05


def near_trouble(arm, random, kind):
    """Joints within 5 degrees (or 5 mm) of a limit, or of a singularity."""
    q = within(arm, random, 0.8)
    if kind == "limit":
        joint = random.integers(len(arm.names))
        gap = random.uniform(0.0, 0.005 if arm.is_prismatic[joint] else np.radians(5.0))
        q[joint] = random.choice([arm.lower[joint] + gap, arm.upper[joint] - gap])
    elif arm.names[0] == "gantry":
        q[3] = random.uniform(-1, 1) * np.radians(5.0)
    elif len(q) == 7:  # the elbow's limit is 4 degrees before it is straight
        q[1] = random.uniform(-1, 1) * np.radians(5.0)
        q[random.choice([3, 5])] = 0.0
        q = np.clip(q, arm.lower, arm.upper)
    else:
        q[random.choice([2, 4])] = random.uniform(-1, 1) * np.radians(5.0)
    return q


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["limit", "singularity"])
def test_no_bound_is_ever_passed(name, kind):
    """50 starts for each arm and kind of trouble, tasks that run into it."""
    arm, random = make(name), np.random.default_rng(7)
    limits = CommandLimits.for_arm(arm, velocity=1.5, acceleration=8.0)
    tasks = [JointLimitAvoidance(limits), Constant(random.normal(size=len(arm.names)))]
    resolver = DifferentialIK(arm, limits, tasks)
    at_limit = 0
    for _ in range(50):
        resolver.reset()
        q, velocities = near_trouble(arm, random, kind), np.zeros(len(arm.names))
        twist = random.normal(size=6) * (0.3, 0.3, 0.3, 1.0, 1.0, 1.0)
        modelled = ALL if random.random() < 0.5 else MOMENTS
        for step in range(40):
            if step % 15 == 14:
                twist = -twist  # a task that changes its mind
            dt = 0.01 if random.random() < 0.8 else 0.033
            answer = resolver.solve(q, Task.from_twist(twist, modelled), dt, velocities)
            change = np.abs(answer.velocities - velocities)
            assert (np.abs(answer.velocities) <= limits.velocity + 1e-9).all()
            assert (change <= limits.acceleration * dt + 1e-9).all()
            velocities = answer.velocities
            q = q + velocities * dt
            assert (q >= limits.lower - 1e-9).all() and (q <= limits.upper + 1e-9).all()
            at_limit += bool(answer.stopped_joints)
    assert at_limit > 10 or kind == "singularity"


@pytest.mark.parametrize("place", range(4))
def test_what_is_not_finite_is_refused(place):
    given = [np.array(REGULAR["aras"]), np.zeros(6), np.eye(6), np.array([0.01])]
    given[place].flat[-1] = np.nan if place else np.inf
    q, rate, L, (dt,) = given
    resolver = DifferentialIK(make("aras"))
    with pytest.raises((ValueError, InvalidTaskError), match="not finite"):
        resolver.solve(q, Task(L, rate, np.ones(6, bool)), dt)
    with pytest.raises(ValueError, match=r"must have \(6,\) for this arm"):
        resolver.solve(np.zeros(5), Task.from_twist(np.zeros(6)), 0.01)


@pytest.mark.parametrize(("options", "words"), [
    ({"velocity": {"J4": 1.0}}, "velocity has the unknown joint J4"),
    ({"velocity": [1.0] * 5}, "velocity has 5 values, must have one for each of"),
    ({"velocity": 0.0}, "gantry: velocity 0 must be positive"),
    ({"velocity": 6.0}, "gantry: velocity 6 is beyond the robot's own limit 5"),
    ({"acceleration": {"J3": -1.0}}, "J3: acceleration -1 must be positive"),
    ({"lower": {"J3": -3.0}}, "J3: lower -3 is beyond the robot's own limit -2.0943"),
    ({"upper": {"J2": 2.2}}, "J2: upper 2.2 is beyond"),
    ({"lower": {"J3": 1.0}, "upper": {"J3": 0.5}}, "J3: lower 1 must be below upper 0.5"),
    ({"upper": {"J3": "far"}}, "upper is"), ({"upper": {"J3": np.nan}}, "upper is .* must be a nu"),
])  # fmt: skip
def test_limits_that_cannot_be(options, words):
    with pytest.raises(ConfigurationError, match=words):
        CommandLimits.for_arm(make("aras"), **options)


def test_limits_are_the_robot_s_unless_narrowed():
    limits = CommandLimits.for_arm(make("aras"), lower={"J3": -1.0}, velocity=[1, 2, 2, 2, 2, 2])
    assert limits.lower.tolist() == [-1.5, -2.0943, -2.0943, -1.0, -2.0943, -3000.0]
    assert limits.velocity.tolist() == [1, 2, 2, 2, 2, 2]
    assert np.isinf(limits.acceleration).all()
    assert limits.margins(np.array([1.4, 0, 0, -1.5, 0, 0]))[[0, 3]] == pytest.approx([0.1, -0.5])


# ----------------------------------------------------------------------- stretched elbows


def test_elbows_are_found_in_the_chain():
    (fold,) = find_elbows(make("aras"), {"J3": -1})
    assert (fold.joint, fold.joint_before, fold.joint_after, fold.bend_side) == (3, 2, 4, -1.0)
    assert fold.straight_position == pytest.approx(0.0, abs=1e-6)
    assert fold.share_before == pytest.approx(-0.16 / 0.41)
    (elbow,) = find_elbows(make("ur5"))
    assert make("ur5").names[elbow.joint] == "elbow_joint"
    assert find_elbows(make("panda")) == ()
    with pytest.raises(ConfigurationError, match="J2 is not an elbow.*J3"):
        find_elbows(make("aras"), {"J2": 1})
    with pytest.raises(ConfigurationError, match="use -1 or 1"):
        find_elbows(make("aras"), {"J3": 0})


def planar(axes=("0 1 0",) * 3, bend=0.0, lengths=(0.3, 0.2), elbow="revolute", lower=-2.0,
           upper=2.0):  # fmt: skip
    """An arm of three joints one above the other, bent by so much at the middle one."""
    places = ((0.0, 0.0), (lengths[0], bend), (lengths[1], 0.0))
    links = "".join(f"<link name='{name}'/>" for name in ("base", "a", "b", "c"))
    joints = "".join(
        f"<joint name='j{i}' type='{elbow if i == 1 else 'revolute'}'><parent link='{parent}'/>"
        f"<child link='{child}'/><origin xyz='0 0 {up}' rpy='0 {turn} 0'/><axis xyz='{axis}'/>"
        f"<limit lower='{lower}' upper='{upper}' effort='1' velocity='1'/></joint>"
        for i, (parent, child, axis, (up, turn)) in enumerate(
            zip(("base", "a", "b"), ("a", "b", "c"), axes, places, strict=True)))
    return Arm.from_urdf(f"<robot name='planar'>{links}{joints}</robot>", "c")


@pytest.mark.parametrize("signs", list(itertools.product((1, -1), repeat=3)))
@pytest.mark.parametrize("bend", [0.0, 0.4, -0.4])
def test_an_elbow_is_one_whichever_way_its_axes_point(signs, bend):
    arm = planar([f"0 {sign} 0" for sign in signs], bend)
    (fold,) = find_elbows(arm)
    assert fold.joint == 1 and fold.straight_position == pytest.approx(-signs[1] * bend)
    q = np.array([0.3, fold.straight_position, 0.2])
    assert np.linalg.norm(arm.pose(q)[:3, 3]) == pytest.approx(0.5)  # stretched
    here = arm.pose(q)
    off = [pose_difference(here, arm.pose(bent(fold, q, angle))) for angle in (0.01, 0.02)]
    assert max(angle for _, angle in off) < 1e-7
    assert 1e-7 < off[0][0] < 1e-4 and off[1][0] == pytest.approx(4.0 * off[0][0], rel=0.02)


@pytest.mark.parametrize(("options", "found"), [
    ({"axes": ("0 1 0", f"0 1 {np.tan(0.5e-4)}", "0 1 0")}, True),
    ({"axes": ("0 1 0", f"0 1 {np.tan(2e-4)}", "0 1 0")}, False),
    ({"axes": (f"0 1 {np.tan(2e-4)}", "0 1 0", "0 1 0")}, False),
    ({"axes": ("0 1 0", "0 1 0", f"0 1 {np.tan(2e-4)}")}, False),
    ({"lengths": (0.3, 0.0011)}, True), ({"lengths": (0.3, 0.0009)}, False),
    ({"lengths": (0.0009, 0.3)}, False), ({"elbow": "prismatic"}, False),
    ({"bend": 0.4, "lower": -0.41}, True), ({"bend": 0.4, "lower": -0.39}, False),
    ({"bend": -0.4, "upper": 0.41}, True), ({"bend": -0.4, "upper": 0.39}, False),
    ({"lower": 0.0}, False), ({"upper": 0.0}, False),
])  # fmt: skip
def test_what_an_elbow_has_to_have(options, found):
    assert len(find_elbows(planar(**options))) == found


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_stretched_arm_comes_back(side):
    arm = make("aras")
    limits = CommandLimits.for_arm(arm, velocity=[1, 2, 2, 2, 2, 2])
    goal = np.array([0.0, 0.0, 0.0, 0.6 * side, 0.0, 0.0])
    goal[2], goal[4] = -0.39 * goal[3], -0.61 * goal[3]
    resolver = DifferentialIK(arm, limits, elbows=find_elbows(arm, {"J3": side}))
    resolver.goal = arm.pose(goal)
    path = goto(resolver, np.zeros(6), arm.pose(goal), MOMENTS)
    assert pose_difference(arm.pose(path[-1]), arm.pose(goal))[0] < 1e-4
    assert path[-1, 3] * side > 0.3 and (path[1:, 3] * side > 0.0).all()


def test_beyond_the_stretched_arm_it_says_so():
    arm = make("aras")
    resolver = DifferentialIK(arm)
    q = np.array([0.0, 0.0, 0.004, -0.01, 0.006, 0.0])
    down = Task.from_twist([0.0, 0.0, 0.05, 0.0, 0.0, 0.0], MOMENTS)
    for _ in range(30):
        answer = resolver.solve(q, down, 0.03)
        q = q + answer.velocities * 0.03
        assert q[3] < 0.0
    assert any("stretched" in reason for reason in answer.reasons)
    assert answer.infeasible_twist[2] == pytest.approx(0.05, rel=0.05)


# ------------------------------------------------------------------------ secondary tasks


def test_posture_moves_what_the_task_does_not_see():
    arm, q = make("aras"), np.array([0.0, 0.5, 0.6, -0.9, 0.3, 0.0])
    tasks = [PostureTask(arm, {"J1": 0.0})]
    answer = DifferentialIK(arm, tasks=tasks).solve(q, Task.from_twist(np.zeros(6), MOMENTS), 0.01)
    # the camera's tilt of 1.8 mrad is all it moves
    assert np.abs(answer.achieved_twist).max() < 2e-3
    assert answer.velocities[1] < -0.05
    for gain, options in ((1.0, {}), (3.0, {"gain": 3.0})):
        posture = PostureTask(arm, {"J1": 0.2, "J5": -0.4}, **options)
        assert posture.velocity(q) == pytest.approx([0, -0.3 * gain, 0, 0, -0.7 * gain, 0])
    with pytest.raises(ConfigurationError, match="unknown joint J4; use one of gantry, J1"):
        PostureTask(arm, {"J4": 0.0})
    for bound in (arm.lower[0], arm.upper[0]):
        assert PostureTask(arm, {"gantry": bound}).velocity(q)[0] == bound
        with pytest.raises(ConfigurationError, match="gantry is .*, must be a number within its"):
            PostureTask(arm, {"gantry": 1.0001 * bound})


def test_joint_limits_are_avoided_from_their_margin_on():
    limits = CommandLimits.for_arm(make("aras"))
    task = JointLimitAvoidance(limits)
    q = np.array([1.4, 0.0, -2.0, 0.0, 0.0, 2999.9])
    assert task.velocity(q) == pytest.approx([-0.2, 0, 2 * (0.2 - 0.0943), 0, 0, -0.2])
    assert not task.velocity(np.zeros(6)).any()
    narrow = JointLimitAvoidance(CommandLimits.for_arm(make("aras"), lower={"J3": -0.1},
        upper={"J3": 0.3}),
                                 margin=0.3, gain=4.0)  # fmt: skip
    q[:4] = 1.1, 0.0, -2.0, 0.25  # a quarter of J3's range is less
    assert narrow.velocity(q) == pytest.approx([0, 0, -4 * (-0.2057), -0.2, 0, -4 * 0.2])


class TestSingularityAvoidance:
    arm = make("aras")
    level = np.array([0.0, 0.0, 0.6, -0.9, 0.3, 0.0])

    def task(self, **options):
        return SingularityAvoidance(self.arm, **options)

    @pytest.mark.parametrize("options", [{}, {"gain": 2.0, "bound": 0.3, "max_gradient": 1e-3}])
    def test_its_step_is_up_the_slope(self, options):
        given = {"gain": 0.5, "bound": 0.1, "max_gradient": 0.1, **options}
        task, q = self.task(**options), np.array([0.0, 0.2, 0.3, -0.9, 0.4, 0.1])
        logarithms = []  # of w, by its singular values
        for turn in 1e-4 * np.vstack([np.zeros(6), np.eye(6), -np.eye(6)]):
            rows = self.arm.jacobian(q + turn)[[0, 1, 2, 5]]
            logarithms.append(np.log(np.linalg.svd(rows, compute_uv=False)).sum())
        here = np.exp(logarithms[0])
        slope = here * (np.array(logarithms[1:7]) - logarithms[7:]) / 2e-4
        steepness = max(np.linalg.norm(slope), given["max_gradient"])
        expected = given["gain"] * (1.0 - here / given["bound"]) * slope / steepness
        assert 0.0 < here < given["bound"] and np.abs(expected).max() > 0.01
        np.testing.assert_allclose(task.velocity(q), expected, atol=1e-5)

    def test_it_switches_off_at_its_bound(self):
        here = self.task().manipulability(self.level)
        assert not self.task(bound=0.999 * here).velocity(self.level).any()
        assert self.task(bound=2.0 * here).velocity(self.level).any()
        almost = self.task(bound=1.001 * here).velocity(self.level)
        assert np.abs(almost).max() < 1e-3 * self.task().gain + 1e-12

# ------------------------------------------------------------- stopping, and what is reported


def test_the_greatest_speed_that_still_stops():
    """Kept for dt, then braked as hard as can be in many short steps."""
    for room, acceleration, dt in itertools.product(
            (1e-12, 1e-3, 0.2, 50.0), (0.3, 8.0, 1e9), (1e-3, 0.05, 2.0)):  # fmt: skip
        speed = compute_stopping_speed(room, acceleration, dt)
        steps = np.linspace(speed, 0.0, 1001)
        braking = 0.5 * (steps[1:] + steps[:-1]).sum() * (speed / 1000) / acceleration
        assert speed * dt + braking == pytest.approx(room, rel=1e-9, abs=0.0)
    assert compute_stopping_speed(0.2, np.inf, 0.05) == pytest.approx(4.0)
    assert compute_stopping_speed(0.0, 2.0, 0.05) == 0.0
    for unbounded in [(np.inf, 2.0, 0.05), (np.inf, np.inf, 0.05), (0.2, 2.0, 0.0)]:
        assert compute_stopping_speed(*unbounded) == np.inf


def test_ranges_leave_room_to_stop_on_either_side():
    q = np.array([0.5, 0.9, -1.2, 1.3, 4.0])  # the third and fourth outside
    lower, upper = np.array([-1.0, -2.0, -1.0, -1.0, -np.inf]), np.array([1.0, 1.0, 1.0, 1.0, 5.0])
    acceleration, dt = np.array([2.0, 3.0, 4.0, 5.0, np.inf]), 0.1
    low, high = compute_velocity_ranges(
        q, np.array([lower, upper, np.ones(5), acceleration]), dt
    )
    assert low[3] < 0.0 == high[3] and low[2] == 0.0 < high[2]
    for speeds, rooms in ((-low, q - lower), (high, upper - q)):
        stopped = speeds[:4] * dt + speeds[:4] ** 2 / (2.0 * acceleration[:4])
        np.testing.assert_allclose(stopped, np.maximum(rooms[:4], 0.0), rtol=1e-12)
    assert low[4] == -np.inf and high[4] == pytest.approx(10.0)


def test_a_rank_counts_what_is_more_than_rounding():
    for size in (1e-9, 1.0, 1e9):
        assert rank(size * np.array([3.0, 3.3e-12, 2.7e-12])) == 2
        assert rank(size * np.array([3.0, 0.0])) == 1
    for nothing in ([], [0.0], [0.0, 0.0]):
        assert rank(np.array(nothing)) == 0


def test_what_a_message_does_not_tell_is_not_a_number():
    asked, twist, velocities = np.arange(6.0), np.arange(1.0, 7.0), np.array([0.1, -0.2, 0.3])
    told = np.array([4.0, 2.0]), np.array([2.0, 1e-5, 1e-12])
    found = IKSolution.from_record(velocities, asked, twist, told, scale=0.5)
    for kept, given in ((found.velocities, velocities), (found.desired_twist, asked),
                        (found.achieved_twist, twist)):  # fmt: skip
        assert kept is given
    assert (found.scale, found.rank) == (0.5, 2)
    assert found.manipulability == pytest.approx(2e-17, rel=1e-9, abs=0.0)
    np.testing.assert_array_equal(found.singular_values_L, told[0])
    for unknown, count in ((found.infeasible_twist, 6), (found.primary, 3), (found.margins, 3)):
        np.testing.assert_array_equal(unknown, np.full(count, np.nan))
    assert found.L.shape == (0, 6) and found.jacobian.shape == (6, 3)
