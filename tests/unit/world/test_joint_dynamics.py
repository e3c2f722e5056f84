"""Joint dynamics against Pinocchio, Bullet, and optimality conditions, which one solution has."""

import math
from itertools import pairwise

import numpy as np
import pinocchio
import pytest
from aras_robot import description

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import World, ground_support, joint_dynamics
from aras_sim_bridge.world.description_changes import change_joint
from aras_sim_bridge.world.fixed_base_dynamics import FixedBaseDynamics
from aras_visual_servo_base.poses import Pose

DT = 0.001
GRAVITY = np.array([0.0, 0.0, -9.8])
AXES = ("1 0 0", "0 1 0", "0 0 -1", "0.6 0 0.8", "0.48 -0.6 0.64")


def tree_xml(make, seed):
    """A tree of eight links that branches, slides and turns, with things fixed on, all oblique."""
    rng = np.random.default_rng(seed)

    def numbers(low, high, count=3):
        return " ".join(f"{x:.6f}" for x in rng.uniform(low, high, count))

    def link(name):
        a = rng.normal(size=(3, 3)) * 0.1
        i = a @ a.T + 0.02 * np.eye(3)
        tensor = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        return make.link(name, rng.uniform(0.3, 3.0), numbers(-0.2, 0.2), tensor)

    parents = ["world", "a0", "a1", "a1", "a3", "a0", "a5", "a6"]
    parts = ['<link name="world"/>']
    for k, parent in enumerate(parents):
        kind = ("revolute", "prismatic", "continuous")[rng.integers(3)]
        parts += [link(f"a{k}"), make.joint(
            f"j{k}", parent, f"a{k}", kind, numbers(-0.5, 0.5), AXES[rng.integers(5)],
            rpy=numbers(-3, 3))]
    for k in (1, 4, 7):
        parts += [link(f"tool{k}"), make.joint(f"f{k}", f"a{k}", f"tool{k}", "fixed",
                                               numbers(-0.5, 0.5), rpy=numbers(-3, 3))]
    return make.robot(*parts)


class Reference:
    def __init__(self, text, names):
        self.model = pinocchio.buildModelFromXML(text)
        self.model.gravity.linear = GRAVITY
        self.data = self.model.createData()
        self.joints = [self.model.joints[self.model.getJointId(name)] for name in names]
        self.order = [joint.idx_v for joint in self.joints]

    def configuration(self, q):
        found = np.zeros(self.model.nq)
        for joint, value in zip(self.joints, q, strict=True):
            found[joint.idx_q:joint.idx_q + joint.nq] = (
                [value] if joint.nq == 1 else [math.cos(value), math.sin(value)])
        return found

    def velocity(self, v):
        found = np.zeros(self.model.nv)
        found[self.order] = v
        return found

def space_of(text):
    """A FixedBaseDynamics with its root at the world's origin, and its description."""
    robot = parse_urdf(text)
    space = FixedBaseDynamics(robot, robot.list_moving_joints())
    space.set_root(Pose(), tuple(GRAVITY))
    return space, robot


def with_bounds(array):
    """A copy of an array with NaN behind it, and whether that is as it was."""
    bound = math.nan if array.dtype == float else 1 << 40
    room = np.full(array.size + 64, bound, array.dtype)
    room[:array.size] = array.ravel()
    return room[:array.size].reshape(array.shape), lambda: (
        np.array_equal(room[array.size:], np.full(64, bound), equal_nan=True))


def test_a_push_from_outside_acts_through_the_link_s_jacobian(make):
    """Also where the root is tilted; what acts on the root itself moves nothing."""
    text = tree_xml(make, 4)
    space, described = space_of(text)
    names = described.list_moving_joints()
    reference = Reference(text, names)
    root = Pose.from_rpy((0.3, -0.2, 0.7), (0.4, 0.2, -1.0))
    space.set_root(root, (0.0, 0.0, 0.0))
    turn = root.matrix()[:3, :3]
    q = np.linspace(-0.7, 0.9, 8)
    force, torque, point = (3.0, -4.0, 5.0), (0.5, 1.0, -2.0), (0.4, 0.6, 1.1)
    space.state[0] = q
    space.apply_force("world", (1e3, 0, 0), (1, 1, 1), (0, 1e3, 0))
    space.apply_force("tool4", force, point, torque)
    assert space.advance(DT) == -1
    # Pinocchio: the spatial force about the root's origin, in the root's axes, to the joint's.
    pull, arm = turn.T @ force, turn.T @ (np.array(point) - root.xyz)
    wrench = pinocchio.Force(pull, np.cross(arm, pull) + turn.T @ torque)
    joint = reference.model.getJointId("j4")
    reference.model.gravity.linear = np.zeros(3)
    pinocchio.forwardKinematics(reference.model, reference.data, reference.configuration(q))
    forces = [pinocchio.Force.Zero() for _ in range(reference.model.njoints)]
    forces[joint] = reference.data.oMi[joint].actInv(wrench)
    found = pinocchio.aba(reference.model, reference.data, reference.configuration(q),
                          np.zeros(8), np.zeros(8), forces)
    np.testing.assert_allclose(space.state[1], DT * found[reference.order], rtol=1e-9, atol=1e-12)
    space.state[0], space.state[1] = q, 0.0
    space.advance(DT)
    np.testing.assert_array_equal(space.state[1], 0.0)  # it acted for one step
    mass = space.mass_matrix()
    space.state[0] += 0.5
    assert not np.array_equal(space.mass_matrix(), mass), "it is the caller's"


def test_what_the_root_has_to_bear_is_pinocchio_s(make):
    """Torque and force of all joints' motion and weight, less what touches; two trees on a root."""
    text = tree_xml(make, 2)
    text = text.replace('<parent link="a0"/><child link="a5"/>',
                        '<parent link="world"/><child link="a5"/>')
    space, described = space_of(text)
    names = described.list_moving_joints()
    reference = Reference(text, names)
    rng = np.random.default_rng(3)
    for _ in range(5):
        q, before, effort = rng.uniform(-2, 2, 8), rng.uniform(-3, 3, 8), rng.normal(size=8) * 9.0
        touch, _ = with_bounds(rng.normal(size=6))
        load, kept = with_bounds(np.full(6, math.nan))
        space.state[:] = q, before, effort
        assert space.advance(1e-6) == -1
        rate = (space.state[1] - space.previous_speeds) / 1e-6
        ground_support.is_supported(
            space.tree, space.frames, space.state, space.previous_speeds, space.gravity,
            np.array([1.0, *[0.0] * 5, 1.0, *[0.0] * 4]), np.zeros((3, 6)), touch, load, 1e-6)
        configuration = reference.configuration(q)
        pinocchio.forwardKinematics(reference.model, reference.data, configuration)
        pinocchio.rnea(reference.model, reference.data, configuration,
                       reference.velocity(before), reference.velocity(rate))
        expected = -touch
        for name in ("j0", "j5"):
            joint = reference.model.getJointId(name)
            found = reference.data.oMi[joint].act(reference.data.f[joint])
            expected += np.concatenate([found.angular, found.linear])
        np.testing.assert_allclose(load, expected, atol=1e-4 * abs(expected).max())
        assert kept()


def conditions(space, described, dt, before, effort, goals):
    """Check the step from `before` (q, v) to the space's state; how many joints did what."""
    names = described.list_moving_joints()
    joints = [described.joints[name] for name in names]
    q, v = before
    after = space.state[1].copy()
    np.testing.assert_allclose(space.state[0], q + dt * after, atol=1e-12)
    here = space.state.copy()
    space.state[0], space.state[1] = q, v
    mass, bias = space.mass_matrix(), np.array(space.bias_efforts())
    space.state[:] = here
    damping = np.diag([joint.damping for joint in joints])
    taken = mass @ v + dt * (effort - bias) - (mass + dt * damping) @ after
    size = abs(mass) @ abs(v) + dt * abs(effort) + 1e-9
    stood = np.zeros(3, dtype=int)
    for k, joint in enumerate(joints):
        hold, slack = dt * joint.friction, 1e-9 * size[k]
        bounded = joint.kind != "continuous"
        lower, upper = (joint.limits.lower, joint.limits.upper) if bounded else (-1e9, 1e9)
        place = q[k] + dt * after[k]
        assert lower - 1e-9 <= place <= upper + 1e-9
        rubs = (-hold, -hold) if after[k] < goals[k] else (hold, hold)
        if abs(after[k] - goals[k]) <= 1e-12:
            rubs, stood[0] = (-hold, hold), stood[0] + 1
        low = -math.inf if place < lower + 1e-9 else 0.0
        high = math.inf if place > upper - 1e-9 else 0.0
        stood[1] += place < lower + 1e-9
        stood[2] += place > upper - 1e-9
        assert rubs[0] + low - slack <= taken[k] <= rubs[1] + high + slack, names[k]
    return stood


@pytest.mark.parametrize("dt", [0.001, 0.005])
def test_friction_stops_and_damping_fulfil_their_conditions(make, dt):
    """Random efforts from stop to stop on joints that are coupled, damped, rub and have motors."""
    rng = np.random.default_rng(11)
    text = tree_xml(make, 5).replace('lower="-10.0" upper="10.0"',
                                     f'lower="{-40 * dt}" upper="{50 * dt}"')
    text = text.replace('damping="0.0" friction="0.0"', 'damping="DAMP" friction="RUB"')
    while "DAMP" in text:
        text = text.replace("DAMP", str(rng.choice([0.0, 0.5, 60.0])), 1)
        text = text.replace("RUB", str(rng.choice([0.0, 0.5, 8.0])), 1)
    space, described = space_of(text)
    goals = np.array([0.0, 0.3, 0.0, -0.2, 0.0, 0.0, 0.1, -0.4])
    for slot, name in enumerate(described.list_moving_joints()):
        space.set_motor(slot, goals[slot], described.joints[name].friction)
    total, push = np.zeros(3, dtype=int), np.zeros(8)
    for k in range(400):
        before = space.state[:2].copy()
        if k % 25 == 0:
            push = -push if k % 50 else rng.normal(size=8) * 0.03 / dt
        effort = push + 3.0 * rng.normal(size=8)
        space.state[2] = effort
        assert space.advance(dt) == -1
        total += conditions(space, described, dt, before, effort, goals)
    assert (total > 50).all(), "joints stuck, and stood at either stop"


def test_a_joint_stands_on_its_stop_and_one_that_diverges_is_named(make):
    space, _ = space_of(make.pendulum(kind="revolute"))
    rng = np.random.default_rng(2)
    for bound in rng.uniform(0.05, 3.0, 100):
        space.arrays[8][0, [joint_dynamics.LOWER, joint_dynamics.UPPER]] = -bound, bound
        for stop in (bound, -bound):
            space.state[:, 0] = -stop * rng.uniform(0.1, 0.9), np.sign(stop) * 9e3, 0.0
            space.advance(0.003)
            assert space.state[0, 0] == stop
    space, _ = space_of(make.rotor())
    space.state[0] = math.nan
    assert space.advance(DT) == 0
    for speed, told in ((0.99e6, -1), (1.01e6, 0), (-0.99e6, -1), (-1.01e6, 0)):
        space.state[:] = 0.0
        space.state[2] = speed * 0.01 / DT
        assert space.advance(DT) == told


@pytest.mark.parametrize("outside", [1.3, 1.5, -1.0])
def test_a_joint_outside_its_limits_comes_back_without_a_blow(make, outside):
    """A fifth of the way a step, never faster than the velocity limit (100 rad/s), and stays."""
    space, _ = space_of(make.pendulum(kind="revolute", lower=-0.4, upper=0.5))
    space.state[0] = outside
    over = [max(outside - 0.5, -0.4 - outside)]
    for _ in range(100):
        space.state[2] = math.copysign(500.0, outside)  # pushed outwards all the while
        space.advance(DT)
        assert abs(space.state[1, 0]) <= 100.0 + 1e-9
        q = space.state[0, 0]
        over.append(max(q - 0.5, -0.4 - q))
    assert over[1] == pytest.approx(over[0] - 0.1)
    assert all(b <= a + 1e-12 for a, b in pairwise(over)) and abs(over[-1]) < 1e-6
    back = [b / a for a, b in pairwise(over) if 1e-3 < a < 0.4]
    assert back == pytest.approx([0.8] * len(back)) and len(back) > 20


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_bounds_on_coupled_joints_leave_no_trace_when_they_are_taken_away(make, sign):
    (space, _), (fresh, _) = (space_of(tree_xml(make, 3)) for _ in range(2))
    for bound in (0.1, math.inf):
        for slot in range(space.state.shape[1]):
            space.bound_speed(slot, bound)
        for _ in range(20 if bound == 0.1 else 0):
            space.state[2] = sign * 50.0
            space.advance(DT)
            assert np.abs(space.state[1]).max() <= 0.1 + 1e-12
    assert (space.state[1] == sign * 0.1).sum() > 1
    fresh.state[:] = space.state
    for one in (space, fresh):
        one.state[2] = sign * 50.0
        one.advance(DT)
    np.testing.assert_allclose(space.state, fresh.state, rtol=1e-9)
    assert np.isfinite(fresh.state).all() and (np.abs(fresh.state[1]) > 0.11).any()


def gripper(make, multiplier=-2.0, **options):
    return make.robot(
        '<link name="world"/>', make.link("a", 1.0, "0 0 -0.3"), make.link("b", 0.5, "0.1 0 0"),
        make.joint("leader", "world", "a", "revolute", "0 0 0", "0 1 0", -1.0, 1.0, **options),
        make.joint("follower", "a", "b", "revolute", "0 0 -0.5", "0 1 0", -1.6, 1.9, **options,
                   extra=f'<mimic joint="leader" multiplier="{multiplier}" offset="0.3"/>'))


def test_a_mimicking_joint_is_one_with_its_leader(make):
    space, _ = space_of(gripper(make))
    free, _ = space_of(gripper(make).replace("<mimic", "<nothing"))
    space.state[0] = 0.5, -0.7

    def energy():
        leader, follower = space.state[0]
        free.state[:2] = space.state[:2]
        kinetic = 0.5 * space.state[1] @ free.mass_matrix() @ space.state[1]
        height = -0.3 * math.cos(leader) + 0.5 * (
            -0.5 * math.cos(leader) - 0.1 * math.sin(leader + follower))
        return kinetic + 9.8 * height

    start = energy()
    for _ in range(300):
        assert space.advance(1e-4) == -1
        assert space.state[0, 1] == pytest.approx(-2 * space.state[0, 0] + 0.3, abs=1e-12)
        assert space.state[1, 1] == -2 * space.state[1, 0]
    assert abs(space.state[1, 0]) > 0.02
    assert energy() == pytest.approx(start, abs=2e-4)
    # At multiplier -2 the leader has four times the follower's damping and twice its friction too.
    text = gripper(make, damping=2.0, friction=0.5)
    for stops in ('lower="-1.0" upper="1.0"', 'lower="-1.6" upper="1.9"'):
        text = text.replace(stops, 'lower="-99" upper="99"')
    space, _ = space_of(text)
    space.set_root(Pose(), (0.0, 0.0, 0.0))
    for slot in (0, 1):
        space.set_motor(slot, 0.0, 0.5)
    for _ in range(3000):
        space.state[2] = 10.0, 0.0
        space.advance(DT)
    assert space.state[1, 0] == pytest.approx((10 - 0.5 - 2 * 0.5) / (2 + 4 * 2.0), rel=0.05)


@pytest.mark.parametrize("gui", [False, True])
@pytest.mark.parametrize(("damping", "sagged"), [
    (None, {"J2": 0.06517, "J3": -0.22185}), (60.0, {"J2": 0.29531, "J3": -0.26})])
@pytest.mark.parametrize("dt", [0.001, 0.005])
def test_damped_joints_sag_as_they_should_at_every_step(window, damping, sagged, dt, gui):
    """In 1 s without controllers, by Bullet at steps of 0.1 ms with its own explicit damping."""
    start = {"J2": 0.35, "J3": -0.26, "J5": -0.09, "J6": 0.17}
    described = description()
    if damping is not None:
        described = change_joint(described, "J2", damping=damping)
    with World(time_step=dt, gui=gui) as world:
        arm = world.spawn(described, "arm", joint_positions=start, fixed_base=True)
        for _ in range(round(1.0 / dt)):
            world.step()
        found = dict(zip(arm.joint_names, arm.read_joints()[0], strict=True))
    assert found == pytest.approx({"gantry": 0.0, "J1": 0.0, **start, **sagged}, abs=3e-4)


def test_the_state_moves_between_us_and_bullet_and_back(make):
    """A body that comes brings Bullet, takes it away when it goes; speeds and motors go along."""
    cube = parse_urdf(make.robot(make.link("cube", shapes=make.box("0.1 0.1 0.1"))))
    with World() as world, World() as undisturbed:
        arms = [w.spawn(parse_urdf(make.rotor(friction=0.1, damping=0.02)), "m")
                for w in (world, undisturbed)]
        for k in range(90):
            if k in (0, 45):  # from 45 on, friction alone
                for arm in arms:
                    arm.set_velocity_motor("spin", *((3.0, 0.2) if k == 0 else (0.0, 0.1)))
            if k == 30:
                world.spawn(cube, "cube", Pose((3, 0, 5)))
            if k == 60:
                world.delete("cube")
            world.step()
            undisturbed.step()
            a, b = (np.array(arm.read_joints()[:2]) for arm in arms)
            np.testing.assert_allclose(a, b, rtol=1e-9, err_msg=str(k))
        assert arms[0].link_pose("wheel").quat == pytest.approx(arms[1].link_pose("wheel").quat)


@pytest.mark.parametrize("call", ["advance", "compute_reactions"])
def test_compiled_steps_keep_to_their_arrays(make, call):
    """They know no bounds: what they read or wrote behind an array would be somebody else's."""
    text = tree_xml(make, 5).replace('lower="-10.0" upper="10.0"', 'lower="-0.1" upper="0.1"')
    space, other = (space_of(text)[0] for _ in range(2))
    arrays, kept = zip(*map(with_bounds, other.arrays), strict=True)
    rng = np.random.default_rng(1)
    for k in range(6):
        state, wrenches = rng.normal(size=(3, 8)), rng.normal(size=(8, 6))
        for one in (space.arrays, arrays):
            one[2][:], one[3][:] = state, wrenches
        for room in arrays[5:8]:  # what stood there before does not matter
            room[:] = math.nan
        made = [getattr(joint_dynamics, call)(*one, DT) for one in (space.arrays, arrays)]
        assert made in ([-1, -1], [None, None]) and all(same() for same in kept), k
        for number, (one, bounded) in enumerate(zip(space.arrays, arrays, strict=True)):
            unused = np.isnan(bounded)
            np.testing.assert_array_equal(one[~unused], bounded[~unused])
            assert number in (6, 7) or not unused.any()
    assert not arrays[3].any()


def test_a_follower_of_multiplier_0_stands_at_its_offset_and_hinders_nobody(make):
    """Though its own stop is there; as if it were fixed there."""
    text = gripper(make, 0.0, damping=0.1).replace('lower="-1.6"', 'lower="0.3"')
    space, _ = space_of(text)
    fixed, _ = space_of(make.robot(
        '<link name="world"/>', make.link("a", 1.0, "0 0 -0.3"), make.link("b", 0.5, "0.1 0 0"),
        make.joint("leader", "world", "a", "revolute", "0 0 0", "0 1 0", -1.0, 1.0, damping=0.1),
        make.joint("follower", "a", "b", "fixed", "0 0 -0.5", rpy="0 0.3 0")))
    space.set_motor(1, 0.5, 3.0)  # of what does not move
    for one in (space, fixed):
        one.set_motor(0, 0.0, 0.25)
    space.state[0] = 0.4, 0.3
    fixed.state[0] = 0.4
    for _ in range(20):
        space.state[2], fixed.state[2] = (2.0, 7.0), 2.0
        assert (space.advance(DT), fixed.advance(DT)) == (-1, -1)
        assert space.state[:2, 0] == pytest.approx(fixed.state[:2, 0], rel=1e-9)
        assert space.state[:2, 1].tolist() == [0.3, 0.0]


@pytest.mark.parametrize("multiplier", [0.5, 3.0, -0.5])
def test_the_tighter_of_two_coupled_joints_stops_counts(make, multiplier):
    text = gripper(make, multiplier).replace('lower="-1.6" upper="1.9"', 'lower="0.1" upper="0.6"')
    space, _ = space_of(text)
    space.state[0] = 0.0, 0.3
    for sign, follower in ((1.0, 0.6), (-1.0, 0.1)):
        for _ in range(1500):
            space.state[2] = math.copysign(30.0, sign * multiplier), 0.0
            space.advance(DT)
        assert space.state[0] == pytest.approx(((follower - 0.3) / multiplier, follower), abs=1e-9)


@pytest.mark.parametrize(("goal", "effort", "push"), [
    (0.0, 10.0, -7.0), (0.0, 2.0, 0.0), (0.0, -2.0, 0.0), (0.5, 2.0, -5.0), (0.5, 0.0, -3.0),
    (-0.5, 10.0, -7.0)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_stop_bears_what_friction_and_motors_leave_to_it(make, goal, effort, push, side):
    """3 N m of them: they help against it, or drive the joint into it."""
    space, _ = space_of(make.pendulum(kind="revolute", lower=-1.0, upper=1.0))
    space.set_root(Pose(), (0.0, 0.0, 0.0))
    space.set_motor(0, side * goal, 3.0)
    space.state[:, 0] = side, 0.0, side * 50.0
    assert space.compute_reactions(DT) == pytest.approx([side * (-53.0 if goal > 0.0 else -47.0)])
    space.state[2] = side * effort
    assert space.compute_reactions(DT) == pytest.approx([side * push], abs=1e-9)
