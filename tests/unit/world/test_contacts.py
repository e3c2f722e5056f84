"""Friction where bodies touch, and the inertia of each link, against closed forms."""

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World

DT = 0.001
G = 9.8
CUBE = (0.2, 0.2, 0.2)


@pytest.fixture
def world(world):
    world.spawn_ground_plane()
    return world


def deceleration(world, model, speed=2.0, count=200):
    """Return the deceleration of a body that slides at `speed` along x, in units of g."""
    for k in range(200 + count):
        if k == 200:
            model.set_twist(Twist((speed, 0.0, 0.0), (0.0, 0.0, 0.0)))
        world.step()
    return (speed - model.twist().linear[0]) / (count * DT) / G


def test_an_impossible_tensor_acts_as_it_is_written_on_a_link_too(world, make, capfd):
    """A thin plate whose file says izz 0.1 and ixx 1e-3: no body has it, but it turns by 1/0.1."""
    odd = (1e-3, 1e-3, 0.1, 0, 0, 0)
    xml = make.robot('<link name="world"/>',
                     make.link("arm", 1.0, "0 0 0", (0.05,) * 3 + (0, 0, 0)),
                     make.link("plate", 1.0, "0 0 0", odd),
                     make.joint("a", "world", "arm", "continuous", axis="1 0 0"),
                     make.joint("b", "arm", "plate", "continuous", axis="0 0 1"))
    world.set_physics(gravity=(0.0, 0.0, 0.0))
    model = world.spawn(parse_urdf(xml), "m", Pose((0, 0, 5)))
    free = world.spawn(parse_urdf(make.robot(make.link("odd", 1.0, "0 0 0", odd))), "free",
                       Pose((9, 0, 5)))
    free.apply_force("odd", (0.0, 0.0, 0.0), (9.0, 0.0, 5.0), (1.0, 0.0, 1.0))
    model.apply_effort("b", 1.0)
    world.step()
    assert np.array(free.twist().angular) / DT == pytest.approx((1000.0, 0.0, 10.0), rel=1e-6)
    assert model.read_joints()[1][1] / DT == pytest.approx(10.0, rel=1e-6)
    model.apply_effort("a", 1.0)
    before = model.read_joints()[1][0]
    world.step()
    assert (model.read_joints()[1][0] - before) / DT == pytest.approx(1 / 0.051, rel=1e-3)
    print("after")
    assert capfd.readouterr() == ("after\n", "")  # Bullet has no remarks


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


def mu1(mu):
    return "" if mu is None else f"<mu1>{mu}</mu1>"


def floor(make, mu):
    return make.block((6, 6, 0.2), tags=mu1(mu), at="0 0 0.9", link="world")


@pytest.mark.parametrize(("floor_mu", "mu"), [(1.0, 0.4), (0.4, None), (0.5, 0.5), (0.3, 0.7),
                                              (3.0, 0.8), (0.0, 0.5)])
def test_of_two_coefficients_the_smaller_counts(world, make, floor_mu, mu):
    world.spawn(floor(make, floor_mu), "floor")
    model = world.spawn(make.block(CUBE, 10.0, mu1(mu)), "m", Pose((-1.0, 0.0, 1.1)))
    expected = min(floor_mu, 1.0 if mu is None else mu)
    assert deceleration(world, model) == pytest.approx(expected, rel=0.01, abs=1e-4)


@pytest.mark.parametrize(("mu", "expected"), [(None, 1.0), (0.2, 0.2), (1.7, 1.7)])
def test_the_ground_is_rougher_than_what_stands_on_it(world, make, mu, expected):
    # A plate with the inertia of a cube pitches too little to change what presses on the ground.
    inertia = (0.2 / 3, 0.2 / 3, 0.2 / 3, 0, 0, 0)
    xml = make.robot(make.link("plate", 10.0, "0 0 0", inertia, make.box("0.4 0.4 0.1")),
                     f'<gazebo reference="plate">{mu1(mu)}</gazebo>')
    model = world.spawn(parse_urdf(xml), "m", Pose((0.0, 0.0, 0.05)))
    assert deceleration(world, model, 4.0, 100) == pytest.approx(expected, rel=0.01)


def test_what_slides_on_a_loose_body_gives_it_what_it_loses(world, make):
    """Both on ice, turned against each other: momentum stays, and both end with one speed."""
    world.spawn(floor(make, 0.0), "floor")
    below = world.spawn(make.block((1.6, 1.2, 0.1), 6.0, mu1(1.0)), "below", Pose((0, 0, 1.05)))
    above = world.spawn(make.block((0.6, 0.1, 0.1), 3.0, mu1(0.5)), "above", Pose((0, 0, 1.15)))
    make.step(world, 200)
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
    model = world.spawn(make.block(CUBE, 10.0, mu1(0.5)), "m", Pose((-1.0, 0.0, 1.1)))
    for k in range(4):
        assert deceleration(world, model) == pytest.approx(0.5, rel=0.01)
        if k == 1:
            world.delete("floor")
            world.spawn(floor(make, 1.0), "floor")
            model.set_pose(Pose((-1.0, 0.0, 1.1)))
        else:
            world.reset_simulation()


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
        make.step(world, 500)
        assert model.read_joints()[0][0] == pytest.approx(0.0, abs=1e-4)
        assert set(model.link_indices) == set(model.description.links)
