"""Falling and thrown bodies, compared with closed forms."""

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World

G = 9.8


def bouncing(coefficient, threshold=0.0):
    """A link's `<collision>` in `<gazebo>`, as Gazebo copies it into the link's own."""
    return ("" if coefficient is None else
            "<collision><surface><bounce><restitution_coefficient>"
            f"{coefficient}</restitution_coefficient><threshold>{threshold}</threshold>"
            "</bounce></surface></collision>")


def floor(make, coefficient=None, threshold=0.0):
    return make.block((6, 6, 0.2), tags=bouncing(coefficient, threshold), at="0 0 -0.1",
                      link="world")


def ball(make, coefficient=None, threshold=0.0, radius=0.02, mass=0.3, gravity=True):
    return make.ball(radius, mass, gravity, bouncing(coefficient, threshold))


def rebound(world, model, height, speed, count=120):
    """Greatest upward speed after the first strike over that before; lowest point below rest, m."""
    model.set_twist(Twist((0.0, 0.0, -speed)))
    before = fastest = lowest = 0.0
    for _ in range(count):
        now = model.twist().linear[2]
        world.step()
        if not before and model.twist().linear[2] > now + 1e-6:
            before = -now
        if before:
            fastest = max(fastest, model.twist().linear[2])
            lowest = min(lowest, model.pose().xyz[2] - height)
    return fastest / before, lowest


@pytest.mark.parametrize(("what", "ground", "speed"), [
    ("ball", "plane", 5.9), ("block", "plane", 0.6), ("block", "box", 5.9), ("plate", "box", 0.6)])
def test_what_falls_stays_where_it_fell(make, ground, what, speed):
    """Wherever in a step it strikes; Bullet alone throws it back at up to 0.14 of its speed."""
    size = (0.3, 0.2, 0.02) if what == "plate" else (0.05, 0.03, 0.04)
    described = ball(make) if what == "ball" else make.block(size, 2.0)
    height = 0.02 if what == "ball" else size[2] / 2
    for share in (0.0, 0.35, 0.9):
        with World() as world:
            world.spawn_ground_plane() if ground == "plane" else world.spawn(floor(make), "floor")
            model = world.spawn(described, "m", Pose((0, 0, height + 0.01 + share * speed * 1e-3),
                                                     Pose.from_rpy((0, 0, 0), (0, 0, 0.4)).quat))
            share_back, lowest = rebound(world, model, height, speed)
            assert share_back < 0.01
            assert lowest > -1e-4
            assert model.pose().xyz[2] == pytest.approx(height, abs=1e-4)


@pytest.mark.parametrize("higher", np.linspace(0.0, 9e-3, 4))
def test_a_plate_that_spins_strikes_with_its_corner(make, higher):
    """Its middle stands still in the air: what reaches the ground is the turning alone."""
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        world.spawn_ground_plane()
        model = world.spawn(make.block((0.3, 0.2, 0.02), 2.0), "m", Pose((0.0, 0.0, 0.13 + higher)))
        model.set_twist(Twist((0.0, 0.0, 0.0), (0.0, 60.0, 0.0)))
        lowest, spins = 1.0, []
        for _ in range(40):
            world.step()
            corners = [model.pose().apply((x, 0.0, z))[2] for x in (-0.15, 0.15)
                       for z in (-0.01, 0.01)]
            lowest = min(lowest, *corners)
            spins.append(model.twist().angular[1])
        assert lowest > -5e-4
        assert min(spins) < 40.0 and max(spins) < 60.001


@pytest.mark.parametrize(("own", "ground", "expected"), [
    ((0.9, 0.0), (0.5, 0.0), 0.5), ((0.4, 0.0), (0.8, 0.0), 0.4), (None, (0.7, 0.0), 0.7),
    ((0.9, 3.0), None, 0.0), ((0.9, 1.0), None, 0.9), ((0.9, 3.0), (0.9, 1.0), 0.9)])
def test_of_two_coefficients_and_thresholds_the_smaller_counts(world, make, own, ground, expected):
    world.spawn(floor(make, *(ground or ())), "floor")
    model = world.spawn(ball(make, *(own or ())), "ball", Pose((0, 0, 0.05)))
    assert rebound(world, model, 0.02, 2.0, 40)[0] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(("radius", "speed"), [(0.3, 2.0), (0.02, 0.12)])
def test_large_and_slow_balls_bounce_too(make, radius, speed):
    """Bullet sees the large one coming for three steps, and by itself bounces nothing so slow."""
    for share in (0.1, 0.9):
        with World() as world:
            world.spawn_ground_plane()
            at = Pose((0, 0, radius + (4.0 + share) * speed * 1e-3))
            model = world.spawn(ball(make, 0.7, radius=radius), "ball", at)
            assert rebound(world, model, radius, speed, 30)[0] == pytest.approx(
                0.7, rel=0.02, abs=0.7 * G * 1e-3 / speed)  # a step's gravity


@pytest.mark.parametrize("coefficient", [None, 0.6, 1.0])
def test_two_balls_keep_their_momentum_and_share_their_speeds(world, make, coefficient):
    """Of unlike masses, in the air, the one from behind at 7 m/s."""
    heavy = world.spawn(ball(make, coefficient, mass=0.9, gravity=False), "a")
    light = world.spawn(ball(make, coefficient, mass=0.3, gravity=False), "b",
                        Pose((0.2003, 0.0, 0.0)))
    heavy.set_twist(Twist((7.0, 0.0, 0.0)))
    light.set_twist(Twist((2.0, 0.0, 0.0)))
    make.step(world, 60)
    a, b = heavy.twist().linear[0], light.twist().linear[0]
    assert 0.9 * a + 0.3 * b == pytest.approx(0.9 * 7.0 + 0.3 * 2.0, rel=1e-6)
    assert b - a == pytest.approx((coefficient or 0.0) * 5.0, abs=0.01)


def test_a_ball_that_spins_takes_its_spin_along_the_wall(world, ground, make):
    model = world.spawn(ball(make, 0.8), "ball", Pose((0, 0, 0.05)))
    model.set_twist(Twist((0.0, 0.0, -4.0), (0.0, 60.0, 0.0)))
    make.step(world, 20)
    linear, angular = model.twist().linear, model.twist().angular
    # It rolls as it leaves: what the ground gave it of speed it lost of spin.
    assert linear[0] == pytest.approx(2 / 7 * 60.0 * 0.02, rel=0.02)
    assert angular[1] == pytest.approx(linear[0] / 0.02, rel=0.02)


@pytest.mark.parametrize(("struck", "speed", "other"), [
    ("base", 7.0, 7.0), ("base", 7.0, 2.0), ("slide", 7.0, 2.0)])
def test_what_moves_ahead_is_struck_when_a_ball_has_caught_up_with_it(make, struck, speed, other):
    """A loose model with a joint, or what slides on a bolted one, 4.3 mm ahead: not before."""
    parts = [make.link("body", 3.0, shapes=make.box("0.06 0.1 0.1"))]
    if struck == "slide":
        parts += ['<link name="world"/>',
                  make.joint("j", "world", "body", "prismatic", axis="1 0 0")]
    else:
        parts += [make.link("fin"), make.joint("j", "body", "fin", xyz="0 0 0.4")]
    lead = parse_urdf(make.robot(*parts))
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        first = world.spawn(lead, "lead")
        second = world.spawn(ball(make, gravity=False), "ball", Pose((-0.0543, 0.01, 0.0)))
        if struck == "slide":
            first.set_velocity_motor("j", other, 1e6)
            world.step()
            second.set_pose(Pose((first.link_pose("body").xyz[0] - 0.0543, 0.01, 0.0)))
        else:
            first.set_twist(Twist((other, 0.0, 0.0)))
        second.set_twist(Twist((speed, 0.0, 0.0)))
        gaps, places = [], [first.link_pose("body").xyz[0]]
        for _ in range(4):
            world.step()
            places.append(first.link_pose("body").xyz[0])
            gaps.append(first.link_pose("body").xyz[0] - second.pose().xyz[0] - 0.05)
        expected = [max(4.3e-3 - (speed - other) * 1e-3 * k, 0.0) for k in range(1, 5)]
        assert gaps == pytest.approx(expected, abs=1e-4)
        assert np.diff(places) == pytest.approx([other * 1e-3] * 4, abs=6e-4)


@pytest.mark.parametrize("change", ["thrown", "put"])
def test_a_ball_that_is_sent_elsewhere_in_flight_is_watched_at_once(world, make, change):
    wall = parse_urdf(make.robot(f'<link name="world">{make.box("0.004 1 1")}</link>'))
    world.spawn(wall, "wall")
    model = world.spawn(ball(make, gravity=False), "ball", Pose((-0.15, 0.0, 0.0)))
    model.set_twist(Twist((0.0, 0.0, 3.0)))
    make.step(world, 3)
    if change == "put":
        model.set_pose(Pose((-0.0901, 0.0, 0.0)))
    model.set_twist(Twist((60.0, 0.0, 0.0)))
    make.step(world, 20)
    assert model.pose().xyz[0] == pytest.approx(-0.022, abs=1e-4)
