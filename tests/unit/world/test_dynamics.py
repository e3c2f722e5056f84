"""Physics, compared with closed forms: no force is added or lost."""

import math
from itertools import pairwise

import numpy as np
import pinocchio
import pytest
from test_joint_dynamics import tree_xml

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, World


def spawn(world, xml, **options):
    return world.spawn(parse_urdf(xml), "m", **options)


ODD = (1e-3, 1e-3, 0.1, 0, 0, 0)  # which no body has: Bullet refuses to work with it


@pytest.mark.parametrize("inertia", [(0.001,) * 3 + (0, 0, 0), ODD])
def test_heavy_damping_on_a_free_base_is_stable(world, make, inertia):
    world.set_physics(gravity=(0, 0, 0))
    model = spawn(world, make.robot(
        make.link("hull", 1.0, "0 0 0", (0.1, 0.1, 0.1, 0, 0, 0)),
        make.link("wheel", 0.1, "0 0 0", inertia),
        make.joint("spin", "hull", "wheel", "continuous", axis="0 0 1", damping=50.0)))
    model.apply_effort("spin", 20.0)
    rates = []
    for _ in range(100):
        world.step()
        rates.append(model.read_joints()[1][0])
    assert all(0 <= b <= a for a, b in pairwise(rates))
    assert rates[-1] < 1e-6


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
        make.step(world, 1)
        assert bob.read_joints()[1][0] == pytest.approx(0.002 * 4.0 * pull, rel=1e-9)
        world.reset_simulation()
    bob.set_pose(Pose.from_rpy((0, 0, 0), (0, math.pi / 2, 0)))
    make.step(world, 1)
    sideways = math.cos(0.5) * 0.5 / 0.26
    assert abs(bob.read_joints()[1][0]) == pytest.approx(0.002 * 4.0 * sideways, rel=1e-9)


def test_a_free_body_s_joint_has_its_friction_again_once_its_damping_needs_no_motor(world, make):
    world.set_physics(gravity=(0, 0, 0), time_step=0.005)
    xml = make.robot(
        make.link("hull", 1.0, "0 0 0", (0.1, 0.1, 0.1, 0, 0, 0)),
        make.link("wheel", 0.1, "0 0 0", (0.001, 0.001, 0.001, 0, 0, 0)),
        make.joint("spin", "hull", "wheel", "continuous", axis="0 0 1", damping=3.0, friction=0.5))
    model = spawn(world, xml)
    make.step(world, 3, model, spin=2.0)
    world.set_physics(time_step=1e-4)
    make.step(world, 200, model, spin=0.49)
    assert abs(model.read_joints()[1][0]) < 1e-9
    make.step(world, 2000, model, spin=2.0)
    assert model.read_joints()[1][0] == pytest.approx((2.0 - 0.5) / 3.0, rel=1e-3)


def test_damping_of_a_free_body_is_chosen_anew_where_its_joints_are_put_elsewhere(world, make):
    """Explicit damping would throw the arm about once the weight is at its axis."""
    world.set_physics(gravity=(0, 0, 0))
    small = (0.001, 0.001, 0.001, 0, 0, 0)
    xml = make.robot(
        make.link("hull", 5.0, "0 0 0", (1.0, 1.0, 1.0, 0, 0, 0)),
        make.link("arm", 0.1, "0 0 0", small), make.link("weight", 0.5, "0 0 0", small),
        make.joint("turn", "hull", "arm", "continuous", axis="0 0 1", damping=10.0),
        make.joint("slide", "arm", "weight", "prismatic", axis="1 0 0"))
    model = spawn(world, xml, joint_positions={"slide": 0.5})
    turn = model.joint_names.index("turn")
    make.step(world, 5, model, turn=1.0)
    assert model.read_joints()[1][turn] > 0.0
    model.set_joint_positions({"slide": 0.0})
    make.step(world, 1, model, turn=1.0)
    rates = [model.read_joints()[1][turn]]
    for _ in range(20):
        world.step()
        rates.append(model.read_joints()[1][turn])
    assert rates[0] > 0.0
    assert all(0 <= b <= a for a, b in pairwise(rates)), rates


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
def test_a_stiff_spring_stays_stable(make, root, stiffness):
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(sprung(root, stiffness=stiffness, damping=1.0), "r")
        make.step(world, 3000)
        assert model.read_joints()[0][0] == pytest.approx(0.3, abs=2e-3)
