"""Round bodies roll, stand and lie according to their shape, compared with closed forms."""

import math

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World

G = 9.8
RADIUS, LENGTH, MASS = 0.05, 0.12, 1.5
SHAPES = {"cylinder": f'<cylinder radius="{RADIUS}" length="{LENGTH}"/>',
          "capsule": f'<capsule radius="{RADIUS}" length="{LENGTH}"/>'}
MOMENTS = (0.003, 0.003, 0.0011)


def lying(make, kind, aslant=0.0):
    """A body whose shape lies level, turned about z from y; its link is upright."""
    turned = f'<origin xyz="0 0 0.02" rpy="{math.pi / 2} 0 {aslant}"/>'
    ixx, iyy, izz = MOMENTS
    return parse_urdf(make.robot(
        f'<link name="round"><inertial>{turned}<mass value="{MASS}"/><inertia ixx="{ixx}" '
        f'iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial><collision>{turned}'
        f"<geometry>{SHAPES[kind]}</geometry></collision></link>"))


@pytest.mark.parametrize("kind", list(SHAPES))
@pytest.mark.parametrize(("on", "aslant"), [("plane", 0.7), ("box", 0.0)])
def test_it_rolls_across_its_axis(make, kind, on, aslant):
    """Down a slope that falls across the axis, however that lies: by its own inertia."""
    angle = math.radians(8.0)
    down = G * math.sin(angle)
    with World(gravity=(down * math.cos(aslant), down * math.sin(aslant),
                        -G * math.cos(angle))) as world:
        if on == "plane":
            world.spawn_ground_plane()
        else:
            world.spawn(make.block((8, 8, 1), at="0 0 -0.5", link="world"), "floor")
        body = world.spawn(lying(make, kind, aslant), "m", Pose((0, 0, RADIUS - 0.02)))
        make.step(world, 800)
        x, y, _ = body.link_state("round")[0].apply((0.0, 0.0, 0.02))
        expected = down / (1.0 + MOMENTS[2] / (MASS * RADIUS**2))
        assert math.hypot(x, y) == pytest.approx(expected * 0.8 * 0.801 / 2, rel=2e-3)
        assert math.atan2(y, x) == pytest.approx(aslant, abs=2e-3)


def test_a_cart_coasts_on_thin_wheels(world, make):
    across = (2.6e-3, 2.6e-3, 5e-3, 0, 0, 0)
    wheel = '<collision><geometry><cylinder radius="0.1" length="0.006"/></geometry></collision>'
    parts = [make.link("base", 10.0, "0 0 0", (0.3, 0.5, 0.6, 0, 0, 0))]
    for k, (x, y) in enumerate(((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2))):
        parts += [make.link(f"w{k}", 1.0, "0 0 0", across, wheel),
                  make.joint(f"j{k}", "base", f"w{k}", "continuous", f"{x} {y} 0", "0 0 1",
                             rpy=f"{-math.pi / 2} 0 0")]
    world.spawn_ground_plane()
    cart = world.spawn(parse_urdf(make.robot(*parts)), "cart", Pose((0, 0, 0.1)))
    make.step(world, 100)
    cart.set_twist(Twist((1.0, 0.0, 0.0)))
    cart.joints.restore([(0.0, 10.0)] * 4)
    make.step(world, 2000)
    assert cart.twist().linear[0] == pytest.approx(1.0, abs=1e-3)
    assert cart.pose().xyz == pytest.approx((2.0, 0.0, 0.1), abs=2e-3)


@pytest.mark.parametrize("kind", list(SHAPES))
def test_it_rests_across_an_edge_by_its_middle(world, make, kind):
    world.spawn(make.block((0.5, 0.04, 0.3), at="0 0 0.15", link="world"), "rail")
    body = world.spawn(lying(make, kind), "m", Pose((0, 0, 0.3 + RADIUS - 0.02)))
    make.step(world, 1500)
    assert body.link_pose("round").apply((0, 0, 0.02))[2] == pytest.approx(0.3 + RADIUS, abs=2e-4)
