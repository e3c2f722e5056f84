"""Physics, compared with closed forms: no force is added or lost."""

import math

import numpy as np
import pinocchio
import pytest
from test_joint_dynamics import tree_xml

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World

DT = 0.001
G = 9.8


@pytest.fixture
def world():
    """An empty world."""
    with World() as it:
        yield it


def spawn(world, xml, **options):
    """A model named 'm'."""
    return world.spawn(parse_urdf(xml), "m", **options)


def steps(world, count, model=None, **efforts):
    """Advance with constant efforts."""
    for _ in range(count):
        for joint, effort in efforts.items():
            model.apply_effort(joint, effort)
        world.step()


def spin_up(model, joint, velocity):
    """Give a joint a velocity by an effort impulse that the caller's next step carries."""
    inertia = 0.01
    model.apply_effort(joint, inertia * velocity / DT)


def test_torque_free_top_keeps_angular_momentum(world, make):
    world.set_physics(gravity=(0, 0, 0))
    inertia = np.diag((0.1, 0.2, 0.25))
    top = spawn(world, make.robot(make.link("top", 1.0, "0 0 0", (0.1, 0.2, 0.25, 0, 0, 0))))
    top.set_twist(Twist((0, 0, 0), (1.0, 2.0, 0.5)))
    before = inertia @ (1.0, 2.0, 0.5)
    steps(world, 500)
    rows = np.array(top.pose().matrix())[:3, :3]
    after = rows @ inertia @ rows.T @ top.twist().angular
    assert np.linalg.norm(after - before) < 2e-3 * np.linalg.norm(before)


@pytest.mark.parametrize("damping", [0.1, 1.0, 4.0, 6.0, 21.0, 1e3, 1e6])
def test_damping_is_stable_and_monotone_for_any_size(world, make, damping):
    model = spawn(world, make.rotor(damping=damping))
    ratio = damping * DT / 0.01
    spin_up(model, "spin", 1.0 + ratio)  # this step is damped too
    rates = []
    for _ in range(50):
        world.step()
        rates.append(model.read_joints()[1][0])
    assert rates[0] == pytest.approx(1.0, rel=1e-6)
    assert all(0 <= b <= a for a, b in zip(rates, rates[1:], strict=False))
    # Off the exact decay by r²/2, and never by more than implicit Euler's worst, 0.204 at r = 2.5.
    exact = math.exp(-ratio)
    assert rates[1] == pytest.approx(exact, abs=min(0.21, ratio**2 / 2 + 1e-9))


def test_heavy_damping_on_a_free_base_is_stable(world, make):
    world.set_physics(gravity=(0, 0, 0))
    xml = make.robot(
        make.link("hull", 1.0, "0 0 0", (0.1, 0.1, 0.1, 0, 0, 0)),
        make.link("wheel", 0.1, "0 0 0", (0.001, 0.001, 0.001, 0, 0, 0)),
        make.joint("spin", "hull", "wheel", "continuous", axis="0 0 1", damping=50.0),
    )
    model = spawn(world, xml)
    model.apply_effort("spin", 20.0)
    rates = []
    for _ in range(50):
        world.step()
        rates.append(model.read_joints()[1][0])
    assert all(0 <= b <= a for a, b in zip(rates, rates[1:], strict=False))
    assert rates[-1] < 1e-6


@pytest.mark.parametrize("damping", [0.0, 0.5, 100.0])
def test_friction_holds_below_and_slips_above(world, make, damping):
    model = spawn(world, make.rotor(friction=0.3, damping=damping))
    steps(world, 500, model, spin=0.299)
    assert abs(model.read_joints()[0][0]) < 1e-9
    steps(world, 1000, model, spin=0.4)
    expected = 0.1 / damping if damping else 0.1 * 1.0 / 0.01
    assert model.read_joints()[1][0] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("stepper", ["own", "bullet"])
def test_gravity_and_step_act_as_they_were_set_last(world, make, stepper):
    """On a tilted root too, before and after a reset."""
    if stepper == "bullet":
        cube = make.link("cube", shapes=make.box("0.1 0.1 0.1"))
        world.spawn(parse_urdf(make.robot(cube)), "cube", Pose((9, 0, 5)))
    bob = spawn(world, make.pendulum(), joint_positions={"swing": 0.5})
    pull = math.sin(0.5) * 0.5 / 0.26
    world.set_physics(time_step=0.002, gravity=(0, 0, 4.0))
    for _ in range(2):
        steps(world, 1)
        assert bob.read_joints()[1][0] == pytest.approx(0.002 * 4.0 * pull, rel=1e-9)
        world.reset_simulation()
    bob.set_pose(Pose.from_rpy((0, 0, 0), (0, math.pi / 2, 0)))
    steps(world, 1)
    sideways = math.cos(0.5) * 0.5 / 0.26
    assert abs(bob.read_joints()[1][0]) == pytest.approx(0.002 * 4.0 * sideways, rel=1e-9)


def test_a_free_body_s_joint_has_its_friction_again_once_its_damping_needs_no_motor(world, make):
    world.set_physics(gravity=(0, 0, 0), time_step=0.005)
    xml = make.robot(
        make.link("hull", 1.0, "0 0 0", (0.1, 0.1, 0.1, 0, 0, 0)),
        make.link("wheel", 0.1, "0 0 0", (0.001, 0.001, 0.001, 0, 0, 0)),
        make.joint("spin", "hull", "wheel", "continuous", axis="0 0 1", damping=3.0, friction=0.5))
    model = spawn(world, xml)
    steps(world, 3, model, spin=2.0)
    world.set_physics(time_step=1e-4)
    steps(world, 200, model, spin=0.49)
    assert abs(model.read_joints()[1][0]) < 1e-9
    steps(world, 2000, model, spin=2.0)
    assert model.read_joints()[1][0] == pytest.approx((2.0 - 0.5) / 3.0, rel=1e-3)


def test_damping_of_a_free_body_is_chosen_anew_where_its_joints_are_put_elsewhere(world, make):
    """Explicit damping, right with the weight half a metre out, would throw the arm about with the
    weight at its axis."""
    world.set_physics(gravity=(0, 0, 0))
    small = (0.001, 0.001, 0.001, 0, 0, 0)
    xml = make.robot(
        make.link("hull", 5.0, "0 0 0", (1.0, 1.0, 1.0, 0, 0, 0)),
        make.link("arm", 0.1, "0 0 0", small), make.link("weight", 0.5, "0 0 0", small),
        make.joint("turn", "hull", "arm", "continuous", axis="0 0 1", damping=10.0),
        make.joint("slide", "arm", "weight", "prismatic", axis="1 0 0"))
    model = spawn(world, xml, joint_positions={"slide": 0.5})
    turn = model.joint_names.index("turn")
    steps(world, 5, model, turn=1.0)
    assert model.read_joints()[1][turn] > 0.0
    model.set_joint_positions({"slide": 0.0})
    steps(world, 1, model, turn=1.0)
    rates = [model.read_joints()[1][turn]]
    for _ in range(20):
        world.step()
        rates.append(model.read_joints()[1][turn])
    assert rates[0] > 0.0
    assert all(0 <= b <= a for a, b in zip(rates, rates[1:], strict=False)), rates


def test_accelerations_by_efforts_of_a_free_body_are_pinocchio_s(make):
    hull = make.link("hull", 4.0, "0.1 -0.2 0.05", (0.3, 0.4, 0.5, 0.02, -0.03, 0.01))
    text = tree_xml(make, 3).replace('<link name="world"/>', hull).replace('"world"', '"hull"')
    reference = pinocchio.buildModelFromXML(text, pinocchio.JointModelFreeFlyer())
    q = np.linspace(-1.0, 1.3, 8)
    with World() as world:
        model = world.spawn(parse_urdf(text), "m", Pose.from_rpy((1, 2, 3), (0.3, -0.5, 1.0)))
        model.set_joint_positions(dict(zip(model.joint_names, q.tolist(), strict=True)))
        found = model.joints.inverse_inertia()
        joints = [reference.joints[reference.getJointId(name)] for name in model.joint_names]
        configuration = pinocchio.neutral(reference)
        for joint, value in zip(joints, q, strict=True):
            configuration[joint.idx_q:joint.idx_q + joint.nq] = (
                [value] if joint.nq == 1 else [np.cos(value), np.sin(value)])
        mass = pinocchio.crba(reference, reference.createData(), configuration)
        mass = np.triu(mass) + np.triu(mass, 1).T
        order = [joint.idx_v for joint in joints]
        expected = np.linalg.inv(mass)[np.ix_(order, order)]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * abs(expected).max())


def test_a_free_body_with_a_tensor_that_no_body_has_is_damped_as_any_other(make):
    """Bullet refuses to work with the tensor, and the first step ended with a SystemError."""
    odd = (1e-3, 1e-3, 0.1, 0, 0, 0)
    xml = make.robot(make.link("hull", 5.0), make.link("plate", 1.0, "0 0 0", odd),
                     make.joint("spin", "hull", "plate", "continuous", axis="0 0 1", damping=0.5))
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(parse_urdf(xml), "m")
        rates = []
        for _ in range(100):
            model.apply_effort("spin", 1.0)
            world.step()
            rates.append(model.read_joints()[1][0])
        both = 1 / (1 / 0.1 + 1 / 0.1)  # plate against hull
        assert rates[-1] == pytest.approx(2.0 * (1 - np.exp(-0.1 * 0.5 / both)), rel=0.01)


MASS = "<inertial><mass value='{m}'/><inertia ixx='{i}' iyy='{i}' izz='{i}'/></inertial>"


def sprung(root, kind="continuous", stiffness=40.0, rest=0.3, damping=0.0):
    """A link of 0.5 kg m² on a spring; the root is bolted where it is called world."""
    inside = "" if root == "world" else MASS.format(m=1.0, i=1.0)
    return parse_urdf(
        f"<robot name='r'><link name='{root}'>{inside}</link><link name='b'>"
        f"{MASS.format(m=0.5, i=0.5)}</link><joint name='j' type='{kind}'><parent link='{root}'/>"
        "<child link='b'/><axis xyz='0 0 1'/><limit lower='-9' upper='9' effort='9' velocity='9'/>"
        f"<dynamics damping='{damping}'/></joint><gazebo reference='j'><springStiffness>{stiffness}"
        f"</springStiffness><springReference>{rest}</springReference></gazebo></robot>")


@pytest.mark.parametrize("kind", ["continuous", "prismatic"])
@pytest.mark.parametrize(("root", "inertia"), [("world", 0.5), ("a", None)])
def test_a_mass_on_a_spring_swings_about_its_reference(kind, root, inertia):
    """At sqrt(k / I); a free base of 1 swings against it, with 1 and 0.5 in series."""
    inertia = inertia or 1.0 / (1.0 / 1.0 + 1.0 / 0.5)
    period = 2.0 * math.pi * math.sqrt(inertia / 40.0)
    with World(time_step=1e-4, gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(sprung(root, kind), "r")
        made = 0
        for share, expected in ((0.25, 0.3), (0.5, 0.6), (1.0, 0.0)):
            while made < round(share * period / 1e-4):
                world.step()
                made += 1
            assert model.read_joints()[0][0] == pytest.approx(expected, abs=5e-3)


@pytest.mark.parametrize("root", ["world", "a"])
@pytest.mark.parametrize("stiffness", [1e3, 1e6, 1e9])
def test_a_stiff_spring_stays_stable(root, stiffness):
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(sprung(root, stiffness=stiffness, damping=1.0), "r")
        for _ in range(3000):
            world.step()
        assert model.read_joints()[0][0] == pytest.approx(0.3, abs=2e-3)
