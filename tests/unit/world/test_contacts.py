"""Friction where bodies touch, and the inertia of each link, against closed forms."""


import numpy as np
import pybullet
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World, bullet

DT = 0.001
G = 9.8


@pytest.fixture
def world():
    """World with only the ground."""
    with World() as it:
        it.spawn_ground_plane()
        yield it


def deceleration(world, model, speed=2.0, count=200):
    """Return the deceleration of a body that slides at `speed` along x, in units of g."""
    for _ in range(200):
        world.step()
    model.set_twist(Twist((speed, 0.0, 0.0), (0.0, 0.0, 0.0)))
    for _ in range(count):
        world.step()
    return (speed - model.twist().linear[0]) / (count * DT) / G


def turning(world, xml, link, torque=1.0):
    """Angular acceleration about z of a free body's root under a torque on `link`, rad/s²."""
    world.set_physics(gravity=(0.0, 0.0, 0.0))
    model = world.spawn(parse_urdf(xml), "m", Pose((0, 0, 5)))
    model.apply_force(link, (0.0, 0.0, 0.0), model.link_pose(link).xyz, (0.0, 0.0, torque))
    world.step()
    return model.twist().angular[2] / DT


def test_a_free_base_keeps_its_own_inertia_beside_light_links(world, make):
    wheel = (0.001, 0.002, 0.001, 0, 0, 0)
    xml = make.robot(
        make.link("base", 10.0, "0 0 0", (0.3, 0.4, 0.6, 0, 0, 0)),
        make.link("left", 0.5, "0 0 0", wheel), make.link("right", 0.5, "0 0 0", wheel),
        make.joint("l", "base", "left", "continuous", xyz="0 0.2 0"),
        make.joint("r", "base", "right", "continuous", xyz="0 -0.2 0"))
    expected = 1.0 / (0.6 + 2 * (0.001 + 0.5 * 0.2**2))
    assert turning(world, xml, "base") == pytest.approx(expected, rel=1e-6)


def test_an_impossible_tensor_acts_as_it_is_written_on_a_link_too(world, make):
    """A thin plate whose file says izz 0.1 and ixx 1e-3: no body has it, but it turns by 1/0.1."""
    odd = (1e-3, 1e-3, 0.1, 0, 0, 0)
    xml = make.robot('<link name="world"/>',
                     make.link("arm", 1.0, "0 0 0", (0.05,) * 3 + (0, 0, 0)),
                     make.link("plate", 1.0, "0 0 0", odd),
                     make.joint("a", "world", "arm", "continuous", axis="1 0 0"),
                     make.joint("b", "arm", "plate", "continuous", axis="0 0 1"))
    world.set_physics(gravity=(0.0, 0.0, 0.0))
    model = world.spawn(parse_urdf(xml), "m", Pose((0, 0, 5)))
    model.apply_effort("b", 1.0)
    world.step()
    assert model.read_joints()[1][1] / DT == pytest.approx(10.0, rel=1e-6)
    model.apply_effort("a", 1.0)
    before = model.read_joints()[1][0]
    world.step()
    assert (model.read_joints()[1][0] - before) / DT == pytest.approx(1 / 0.051, rel=1e-3)


def test_bullet_has_no_remarks_on_an_impossible_tensor(world, make, capfd):
    xml = make.robot(make.link("odd", 1.0, "0 0 0", (1e-3, 1e-3, 0.1, 0, 0, 0)))
    model = world.spawn(parse_urdf(xml), "m", Pose((0, 0, 5)))
    model.apply_force("odd", (0.0, 0.0, 0.0), (0.0, 0.0, 5.0), (1.0, 0.0, 1.0))
    world.step()
    assert model.twist().angular[0] / DT == pytest.approx(1000.0, rel=1e-6)
    assert model.twist().angular[2] / DT == pytest.approx(10.0, rel=1e-6)
    print("after")
    assert capfd.readouterr() == ("after\n", "")


def test_the_friction_of_a_link_that_is_not_the_root_acts(world, make):
    """Two cubes on one beam: both slide, so the deceleration is that of the links' own friction."""
    def foot(name, y):
        return (make.link(name, 5.0, "0 0 0", (0.03,) * 3 + (0, 0, 0), make.box("0.2 0.2 0.2")) +
                make.joint(f"to_{name}", "beam", name, "fixed", xyz=f"0 {y} 0"))
    xml = make.robot(make.link("beam", 1.0, "0 0 0", (0.1,) * 3 + (0, 0, 0)),
                     foot("left", 0.5), foot("right", -0.5),
                     *(f'<gazebo reference="{name}"><mu1>0.2</mu1></gazebo>'
                       for name in ("left", "right")))
    model = world.spawn(parse_urdf(xml), "m", Pose((0, 0, 0.1)))
    assert deceleration(world, model) == pytest.approx(0.2, rel=0.01)


def cube(make, mu=None, size="0.2 0.2 0.2"):
    """A box of 10 kg with a cube's inertia, its friction coefficient as `mu1`, or Gazebo's own."""
    tag = "" if mu is None else f'<gazebo reference="cube"><mu1>{mu}</mu1></gazebo>'
    return parse_urdf(make.robot(make.link("cube", 10.0, "0 0 0", (0.2 / 3,) * 3 + (0, 0, 0),
                                           make.box(size)), tag))


def floor(make, mu):
    """A floor with its top at 1 m."""
    return parse_urdf(make.robot(
        f'<link name="world">{make.box("6 6 0.2", "0 0 0.9")}</link>',
        f'<gazebo reference="world"><mu1>{mu}</mu1></gazebo>'))


@pytest.mark.parametrize(("floor_mu", "mu"), [(1.0, 0.4), (0.4, None), (0.5, 0.5), (0.3, 0.7),
                                              (3.0, 0.8), (0.0, 0.5)])
def test_of_two_coefficients_the_smaller_counts(world, make, floor_mu, mu):
    world.spawn(floor(make, floor_mu), "floor")
    model = world.spawn(cube(make, mu), "m", Pose((-1.0, 0.0, 1.1)))
    expected = min(floor_mu, 1.0 if mu is None else mu)
    assert deceleration(world, model) == pytest.approx(expected, rel=0.01, abs=1e-4)


@pytest.mark.parametrize(("mu", "expected"), [(None, 1.0), (0.2, 0.2), (1.7, 1.7)])
def test_the_ground_is_rougher_than_what_stands_on_it(world, make, mu, expected):
    model = world.spawn(cube(make, mu, "0.4 0.4 0.1"), "m", Pose((0.0, 0.0, 0.05)))
    assert deceleration(world, model, 4.0, 100) == pytest.approx(expected, rel=0.01)


def beam(make, mass=6.0, mu=0.5, size=(0.6, 0.1, 0.1)):
    """Long and thin: what stops it is far from its middle along one axis alone."""
    x, y, z = size
    inertia = [mass * (a * a + b * b) / 12 for a, b in ((y, z), (x, z), (x, y))]
    return parse_urdf(make.robot(
        make.link("beam", mass, "0 0 0", (*inertia, 0, 0, 0), make.box(f"{x} {y} {z}")),
        f'<gazebo reference="beam"><mu1>{mu}</mu1></gazebo>'))


def test_what_slides_on_a_loose_body_gives_it_what_it_loses(world, make):
    """Both on ice, turned against each other: momentum stays, and both end with one speed."""
    ice = 0.0
    world.spawn(floor(make, ice), "floor")
    below = world.spawn(beam(make, 6.0, 1.0, (1.6, 1.2, 0.1)), "below", Pose((0, 0, 1.05)))
    above = world.spawn(beam(make, 3.0), "above", Pose((0, 0, 1.15)))
    for _ in range(200):
        world.step()
    above.set_twist(Twist((0.8, 0.6, 0.0)))
    for k in range(300):
        world.step()
        if k == 60:  # as they slide: 0.5 g slows the upper one down, along its way
            lost = np.subtract((0.8, 0.6, 0.0), above.twist().linear)
            assert lost[:2] == pytest.approx(0.5 * G * 0.061 * np.array((0.8, 0.6)), rel=0.04)
        both = 6.0 * np.array(below.twist().linear) + 3.0 * np.array(above.twist().linear)
        assert both[:2] == pytest.approx((2.4, 1.8), abs=0.02), k
    assert below.twist().linear[:2] == pytest.approx(above.twist().linear[:2], abs=0.01)


def test_a_changed_coefficient_and_a_reset_begin_with_the_files_numbers(world, make):
    world.spawn(floor(make, 0.5), "floor")
    model = world.spawn(cube(make, 0.5), "m", Pose((-1.0, 0.0, 1.1)))
    assert deceleration(world, model) == pytest.approx(0.5, rel=0.01)
    world.reset_simulation()
    assert deceleration(world, model) == pytest.approx(0.5, rel=0.01)
    world.delete("floor")
    world.spawn(floor(make, 1.0), "floor")
    model.set_pose(Pose((-1.0, 0.0, 1.1)))
    assert deceleration(world, model) == pytest.approx(0.5, rel=0.01)
    world.reset_simulation()
    assert deceleration(world, model) == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize("ground", ["plane", "box"])
@pytest.mark.parametrize("links", [1, 2])
def test_what_is_fixed_to_a_bolted_model_s_first_link_stands_on_what_never_moves(
        make, ground, links):
    """Bullet took it for something that never moves; it fell through the ground."""
    ball = '<collision><origin xyz="0 0 0.05"/><geometry><sphere radius="0.05"/></geometry>' \
        "</collision>"
    middle = [make.link("middle", 0.3), make.joint("to_middle", "slide", "middle", "fixed")]
    with World() as world:
        if ground == "plane":
            world.spawn_ground_plane()
        else:
            world.spawn(parse_urdf(make.robot(
                make.link("world"), make.link("block", 1.0, shapes=make.box("2 2 1", "0 0 -0.5")),
                make.joint("stands", "world", "block", "fixed"))), "block")
        model = world.spawn(parse_urdf(make.robot(
            make.link("world"), make.link("slide", 1.0), *(middle if links == 2 else ()),
            make.link("foot", 0.5, shapes=ball),
            make.joint("lift", "world", "slide", "prismatic", axis="0 0 1"),
            make.joint("ankle", "middle" if links == 2 else "slide", "foot", "fixed"))), "leg",
            joint_positions={"lift": 0.05})
        for _ in range(500):
            world.step()
        assert model.read_joints()[0][0] == pytest.approx(0.0, abs=1e-4)
        assert set(model.link_indices) == set(model.description.links)


def test_contacts_are_told_as_each_of_the_two_feels_them(monkeypatch):
    """Forces on the body that is asked for, at its own point; of itself it feels nothing."""
    rng = np.random.default_rng(5)

    def point(body, link, other, its):
        vectors = [tuple(v) for v in rng.normal(size=(5, 3))]
        here, there, normal, one, two = vectors
        return (0, body, other, link, its, here, there, normal, *rng.normal(size=2),
                rng.normal(), one, rng.normal(), two)

    told = [point(7, -1, 3, 2), point(3, 5, 7, 4), point(7, 0, 7, 1), point(3, 0, 4, 1)]
    monkeypatch.setattr(pybullet, "getContactPoints", lambda physicsClientId: told)
    first, second = bullet.find_contacts(7, 0)
    assert (first[:3], second[:3]) == ((-1, 3, 2), (4, 3, 5))
    for (*_, numbers), seen, here, sign in ((first, told[0], 5, 1.0), (second, told[1], 6, -1.0)):
        assert len(numbers) == 16 and numbers[:3] == seen[here] and numbers[15] == -seen[8]
        for at, force, along in ((3, seen[9], seen[7]), (7, seen[10], seen[11]),
                                 (11, seen[12], seen[13])):
            felt = numbers[at] * np.array(numbers[at + 1:at + 4])
            assert felt == pytest.approx(sign * force * np.array(along))
    (*_, other), = [one for one in bullet.find_contacts(3, 0) if one[0] == 2]
    assert other[:3] == told[0][6]
    for at in (3, 7, 11):  # to every force one that is as large
        assert other[at] == -first[3][at] and other[at + 1:at + 4] == first[3][at + 1:at + 4]
