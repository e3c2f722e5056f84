"""Resting free bases: at rest like fixed ones, and free when the ground cannot hold them."""

import itertools
import math
from functools import partial

import numpy as np
import pybullet
import pytest
from scipy.spatial import ConvexHull

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World, ground_support, resting_base
from aras_sim_bridge.world.description_changes import change_joint

G = 9.8


def slide(make, load=2.0, height=0.5, axis="1 0 0", travel=20.0):
    """A mass on a rail of a link called base."""
    return (make.link("slide", load, "0 0 0", (0.01,) * 3 + (0, 0, 0)) + make.joint(
        "rail", "base", "slide", "prismatic", f"0 0 {height}", axis, -travel, travel))


def cart(make, mass=10.0, load=2.0, height=0.5, mu=0.5, travel=20.0, shapes=None):
    """A block of 0.6 m with a slide on top of it; `height`: of the slide above the ground."""
    x, y, z = 0.6, 0.6, 0.2
    inertia = [mass * (a * a + b * b) / 12 for a, b in ((y, z), (x, z), (x, y))]
    return parse_urdf(make.robot(
        make.link("base", mass, "0 0 0.1", (*inertia, 0, 0, 0),
                  shapes or make.box("0.6 0.6 0.2", "0 0 0.1")),
        slide(make, load, height, travel=travel),
        f'<gazebo reference="base"><mu1>{mu}</mu1></gazebo>'))


@pytest.fixture
def world(world):
    world.spawn_ground_plane()
    return world


def steps(world, count, model=None, rail=0.0):
    """Advance with a constant effort in the rail."""
    for _ in range(count):
        if model is not None:
            model.apply_effort("rail", rail)
        world.step()


@pytest.fixture
def held(world, make):
    model = world.spawn(cart(make), "cart")
    steps(world, 200)
    assert model.fixed_base
    return model


def test_a_base_at_rest_is_held_where_it_stands(world, make):
    model = world.spawn(cart(make), "cart", Pose.from_rpy((1.0, 2.0, 0.0), (0.0, 0.0, 0.7)))
    assert not model.fixed_base
    steps(world, 200)
    assert model.fixed_base
    at = model.pose()
    assert at.xyz == pytest.approx((1.0, 2.0, 0.0), abs=2e-4)
    steps(world, 1000, model, 3.0)
    assert model.pose() == at
    assert model.read_joints()[1][0] == pytest.approx(3.0 / 2.0, rel=1e-4)
    assert model.read_joints()[2] == [3.0]


def cube_mesh(path) -> str:
    """A <mesh> of a cube of 0.6 m about the origin."""
    corners = itertools.product((-0.3, 0.3), repeat=3)
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners)
                    + "".join(f"f {face}\n" for face in faces))
    return f'<mesh filename="file://{path}"/>'


def collision(geometry: str, origin: str) -> str:
    return f'<collision><origin xyz="{origin}"/><geometry>{geometry}</geometry></collision>'


def test_a_base_on_feet_that_are_links_is_held(world, make):
    """Bullet leaves a millimetre around the hulls of links: it stands on that."""
    shape, feet = collision('<cylinder radius="0.03" length="0.2"/>', "0 0 0.1"), []
    for k, (x, y) in enumerate(itertools.product((-0.3, 0.3), repeat=2)):
        feet += [make.link(f"foot{k}", 1.0, "0 0 0.1", (0.01,) * 3 + (0, 0, 0), shape),
                 make.joint(f"at{k}", "base", f"foot{k}", "fixed", f"{x} {y} 0")]
    model = world.spawn(parse_urdf(make.robot(
        make.link("base", 20.0, "0 0 0.3", (1,) * 3 + (0,) * 3, make.box("0.6 0.6 0.2", "0 0 0.3")),
        *feet, slide(make))), "table")
    steps(world, 300)
    assert model.fixed_base and model.pose().xyz[2] < 1.1e-3
    (one,) = world.resting_bases.fixed_bases
    corners = one.corners[:, :3] + one.ground[7:10] + model.pose().xyz
    assert np.abs(corners[:, 2]).max() < 1e-6  # on the ground, where forces act
    assert np.abs(corners[:, :2]).max(axis=0) == pytest.approx(0.33, abs=1e-3)
    steps(world, 200, model, 5.0)
    assert model.fixed_base
    steps(world, 1, model, 250.0)  # more than the ground bears
    assert not model.fixed_base


@pytest.mark.parametrize("what", ["mesh", "cylinder"])
def test_a_base_of_any_shape_is_held_at_its_own_height(world, make, tmp_path, what):
    """Bullet adds a millimetre to hulls, on which such bases stood, and were never held."""
    shape = collision(cube_mesh(tmp_path / "cube.obj"), "0 0 0.3") if what == "mesh" else collision(
        '<cylinder radius="0.3" length="0.2"/>', "0 0 0.1")
    model = world.spawn(cart(make, shapes=shape), "cart")
    steps(world, 200)
    assert model.fixed_base
    assert model.pose().xyz == pytest.approx((0.0, 0.0, 0.0), abs=2e-5)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("shape", "tilt"), [
    ('<sphere radius="0.1"/>', 0.3), ('<capsule radius="0.1" length="0.3"/>', 0.0),
    ('<capsule radius="0.1" length="0.3"/>', math.pi / 2)], ids=["sphere", "upright", "lying"])
def test_a_base_that_could_roll_is_left_to_bullet(world, make, shape, tilt):
    model = world.spawn(parse_urdf(make.robot(
        make.link("base", 10.0, "0 0 0", (0.3, 0.3, 0.6, 0, 0, 0), collision(shape, "0 0 0")),
        slide(make, height=0.0))), "ball", Pose.from_rpy((0.0, 0.0, 0.3), (tilt, 0.0, 0.0)))
    steps(world, 1500)
    assert not model.fixed_base and np.isfinite(model.pose().xyz).all()


def test_what_joints_did_goes_on_when_the_base_is_held(world, make):
    model, found = world.spawn(cart(make), "cart"), []
    for _ in range(300):
        model.apply_effort("rail", 2.0)
        world.step()
        found.append([part[0] for part in model.read_joints()[1:]])
    speeds, efforts = np.transpose(found)
    assert model.fixed_base and (efforts == 2.0).all()
    assert np.diff(speeds)[100:] == pytest.approx(1e-3, rel=1e-3)  # 2 N on 2 kg
    model.set_fixed_base(False)
    assert model.read_joints()[2] == [2.0]


@pytest.mark.parametrize("gui", [False, True])
def test_a_push_of_the_arm_beyond_friction_moves_the_base(window, make, gui):
    """12 kg with 0.5 hold 58.8 N; of 100 N the base takes what is left."""
    with World(gui=gui) as world:
        world.spawn_ground_plane()
        model = world.spawn(cart(make, height=0.1), "cart")
        steps(world, 200)
        steps(world, 50, model, 50.0)
        assert model.joints.has_own_dynamics is not gui
        assert model.fixed_base
        steps(world, 100, model, 100.0)
        assert not model.fixed_base
        expected = -(100.0 - 0.5 * 12.0 * G) / 10.0 * 0.1
        assert model.twist().linear[0] == pytest.approx(expected, rel=0.02)
        model.joints.restore([(0.0, 0.0)])
        steps(world, 400)  # others that rest are looked at each 50 steps, this one after a second
        assert math.hypot(*model.twist().linear) < 1e-6 and not model.fixed_base


@pytest.mark.parametrize("height", [0.5, 1.5])
def test_a_push_of_the_arm_that_would_tip_the_base_frees_it(world, make, height):
    """0.3 m from the edge, the block's weight balances 35 N m: 40 N at 1.5 m are too much."""
    model = world.spawn(cart(make, load=0.2, height=height, mu=2.0), "cart")
    steps(world, 400)
    assert model.fixed_base
    steps(world, 30, model, 40.0)
    assert model.fixed_base is (height == 0.5)
    assert height == 0.5 or abs(model.twist().angular[1]) > 0.05


def test_a_blow_that_the_ground_cannot_take_reaches_the_base(world, make):
    """A slide of 2 kg hits its stop at 5 m/s: the 10 kg of the base move on with 10 N s."""
    model = world.spawn(cart(make, height=0.1, mu=0.05, travel=0.1), "cart")
    steps(world, 200)
    model.joints.restore([(0.08, 5.0)])
    steps(world, 2)
    assert model.fixed_base
    steps(world, 8)
    assert not model.fixed_base
    base = model.twist().linear[0]
    # Less what friction takes in the few steps since.
    assert 10.0 * base + 2.0 * (base + model.read_joints()[1][0]) == pytest.approx(10.0, rel=0.05)


DISTURBED = {  # what happens, and whether the base moves
    "pushed": (lambda world, model: model.apply_force(
        "base", (1.0, 0.0, 0.0), model.pose().xyz), False),
    "turned": (lambda world, model: model.apply_force(
        "base", (0, 0, 0), (0, 0, 0), (0, 0, 1.0)), False),
    "moved": (lambda world, model: model.set_pose(Pose((1.0, 0.0, 0.5))), True),
    "thrown": (lambda world, model: model.set_twist(Twist((0.5, 0.0, 0.0))), True),
    "gravity": (lambda world, model: world.set_physics(gravity=(0.0, 0.0, 1.0)), True),
    "no ground": (lambda world, model: world.delete("ground_plane"), True),
    "ground moved": (lambda world, model: world.model("ground_plane").set_pose(
        Pose((0, 0, -1.0))), True),
    "changed": (lambda world, model: world.change_model(
        "cart", change_joint(model.description, "rail", damping=1.0)), False),
}


@pytest.mark.parametrize("what", DISTURBED)
def test_whatever_happens_to_a_held_base_finds_it_free(world, held, what):
    before, (disturb, moves) = held.pose(), DISTURBED[what]
    disturb(world, held)
    assert not held.fixed_base
    steps(world, 30)
    assert (math.dist(before.xyz, held.pose().xyz) > 2e-4) is moves


def test_a_push_at_the_slide_is_the_arm_s(world, held):
    for _ in range(100):
        held.apply_force("slide", (0.0, 30.0, 0.0), held.link_pose("slide").xyz)
        world.step()
    assert held.fixed_base
    for _ in range(5):
        held.apply_force("slide", (0.0, 90.0, 0.0), held.link_pose("slide").xyz)
        world.step()
    assert not held.fixed_base


def test_a_push_at_the_slide_ends_with_its_step_where_bullet_steps_too(window, make):
    with World(gui=True) as world:  # Bullet makes all steps
        world.spawn_ground_plane()
        model = world.spawn(cart(make, 200.0), "cart")
        steps(world, 300)
        assert model.fixed_base and not model.joints.has_own_dynamics
        model.apply_force("slide", (20.0, 0.0, 0.0), model.link_pose("slide").xyz)
        speeds = []
        for _ in range(20):
            world.step()
            speeds.append(model.read_joints()[1][0])
    assert speeds[0] == pytest.approx(0.01, rel=0.05)  # 20 N on 2 kg for 1 ms
    assert max(speeds) <= speeds[0] + 1e-9


def test_a_reset_starts_free_and_comes_to_the_same_again(world, held):
    found = [(held.pose(), held.read_joints()[0])]
    for _ in range(2):
        world.reset_simulation()
        assert not held.fixed_base
        steps(world, 200)
        assert held.fixed_base
        found.append((held.pose(), held.read_joints()[0]))
    assert found[2] == found[1]
    assert found[1][0].xyz == pytest.approx(found[0][0].xyz, abs=1e-9)
    held.set_pose(Pose((1.0, 0.0, 0.0)))
    world.step()
    assert not held.fixed_base
    world.reset_world()  # of poses alone: it stands at the next step
    steps(world, 3)
    assert held.fixed_base and held.pose() == held.spawn_pose


@pytest.mark.parametrize("cause", [
    lambda world, make, model: world.delete("block"),
    lambda world, make, model: model.set_pose(Pose((0.0, 0.0, 0.5))),
    lambda world, make, model: (model.apply_effort("rail", 1000.0), world.step()),
    lambda world, make, model: loose_box(make, world, "box", 1.0, (3.0, 0.0, 3.0)),
], ids=["the ground of one", "one of two", "a push of one", "a box that is heavy for one"])
def test_both_of_two_bases_are_let_go_where_one_has_to_be(world, make, cause):
    block = make.block((2, 2, 0.2), at="0 0 -0.1", link="world")
    world.spawn(block, "block", Pose((0.0, 5.0, 1.0)))
    models = [world.spawn(cart(make, mass), name, at)
              for mass, name, at in ((10.0, "a", Pose()), (1000.0, "b", Pose((0.0, 5.0, 1.0))))]
    steps(world, 300)
    assert [one.fixed_base for one in models] == [True, True]
    cause(world, make, models[0])
    assert [one.fixed_base for one in models] == [False, False]


def test_a_bolted_model_that_moves_comes_and_goes_leaves_it_held(world, make, held):
    shelf = make.block((0.1, 0.1, 0.1), at="0 0 8", link="world")
    target = world.spawn(shelf, "shelf", Pose((0.0, 5.0, 0.0)))
    for k in range(50):
        target.set_pose(Pose((0.01 * k, 5.0, 0.0)))
        world.step()
        assert held.fixed_base
    world.delete("shelf")
    assert held.fixed_base


def on_a_table(make, world, bolted):
    """A cart on a loose table, or on a lift."""
    top = make.link("top", 50.0, "0 0 0.1", (5, 5, 5, 0, 0, 0), make.box("2 2 0.2", "0 0 0.1"))
    lift = make.link("world") + make.joint("up", "world", "top", "prismatic", axis="0 0 1",
                                           lower=0.0, upper=1.0)
    world.spawn(parse_urdf(make.robot(top, lift if bolted else "")), "table")
    return world.spawn(cart(make), "cart", Pose((0, 0, 0.2)))


def in_a_groove(make, world):
    sides = "".join(f'<collision><origin xyz="{x} 0 0.2" rpy="0 {turn} 0"/><geometry>'
                    '<box size="1 2 0.2"/></geometry></collision>'
                    for x, turn in ((-0.5, 0.3), (0.5, -0.3)))
    world.spawn(parse_urdf(make.robot(f'<link name="world">{sides}</link>')), "groove")
    return world.spawn(cart(make, mu=0.9), "cart", Pose((0, 0, 0.25)))


def on_wheels(make, world):
    wheel = make.link("{0}", 1.0, "0 0 0", (0.01,) * 3 + (0, 0, 0), make.box("0.2 0.1 0.2"))
    return world.spawn(parse_urdf(make.robot(
        make.link("base", 5.0), *(wheel.format(n) for n in "ab"),
        make.joint("ja", "base", "a", "continuous", "0 0.5 0", damping=1e6),
        make.joint("jb", "base", "b", "continuous", "0 -0.5 0", damping=1e6))), "carriage",
        Pose((0, 0, 0.1)))


@pytest.mark.parametrize("build", [
    lambda *it: on_a_table(*it, False), lambda *it: on_a_table(*it, True), on_wheels, in_a_groove,
], ids=["on a table", "on a lift", "on wheels", "in a groove"])
def test_what_stands_otherwise_is_left_to_bullet(world, make, build):
    model = build(make, world)
    steps(world, 400)
    assert not model.fixed_base


def loose_box(make, world, name, mass, at):
    return world.spawn(make.block((0.1, 0.1, 0.1), mass, "<mu1>0.5</mu1>"), name, Pose(at))


def test_what_no_longer_lies_on_a_held_base_is_no_longer_felt(world, make):
    at = Pose.from_rpy((0.05, -0.02, 0.0), (0.0, 0.0, 0.5))
    world.spawn(cart(make, 200.0), "cart", at)
    box = loose_box(make, world, "on", 1.0, (0.2, 0.1, 0.251))
    loose_box(make, world, "far", 1.0, (5.0, 0.0, 0.05))
    steps(world, 500)
    (one,) = world.resting_bases.fixed_bases
    weight = (0.0, 0.0, -G)
    lever = at.inverse().apply(box.pose().xyz)
    assert one.contact_wrench[:3] == pytest.approx(np.cross(lever, weight), abs=0.1)
    assert one.contact_wrench[3:] == pytest.approx(weight, abs=0.5)
    box.set_twist(Twist((0.0, 0.0, 3.0)))  # up and off
    steps(world, 50)
    assert world.resting_bases.fixed_bases == [one]
    assert box.pose().xyz[2] > 0.3
    assert not one.contact_wrench.any()


@pytest.mark.parametrize("first", ["base", "box"])
def test_what_rubs_along_a_held_base_is_felt_along_its_way(world, make, first):
    spawn = {"base": lambda: world.spawn(cart(make, 200.0), "cart"),
             "box": lambda: loose_box(make, world, "on", 1.0, (-0.1, 0.0, 0.25))}
    for name in sorted(spawn, key=lambda name: name != first):
        spawn[name]()
    steps(world, 100)
    world.model("on").set_twist(Twist((0.8, 0.6, 0.0)))
    steps(world, 20)
    (one,) = world.resting_bases.fixed_bases
    assert one.contact_wrench[3:] == pytest.approx(G * np.array((0.4, 0.3, -1.0)), rel=0.1)


def test_a_hard_velocity_limit_outlives_a_base_that_is_let_go(world, held):
    held.bound_speed("rail", 0.2)
    held.apply_force("base", (1.0, 0.0, 0.0), held.pose().xyz)
    assert not held.fixed_base
    steps(world, 2000)
    assert held.fixed_base
    steps(world, 200, held, 10.0)
    assert held.read_joints()[1][0] == pytest.approx(0.2)


def polygon(points, normal):
    """Hull of points on a plane (m, 6): corners, each with the outward normal of its edge."""
    axes = np.linalg.svd(normal[None])[2][1:]
    hull = ConvexHull(points @ axes.T)
    corners = points[hull.vertices]
    along = np.roll(corners, -1, axis=0) - corners
    outward = np.cross(along, normal)
    outward *= np.sign(np.einsum("ij,ij->i", outward, corners - corners.mean(axis=0)))[:, None]
    return np.hstack([corners, outward / np.linalg.norm(outward, axis=1, keepdims=True)])


def bears(mass, normal, point, friction, corners, shift, touch=(0.0,) * 6):
    """Whether the ground holds a base at rest with its weight this far from the middle."""
    ground = np.array([mass, *point + shift + 0.4 * normal, *normal, *point, friction])
    return ground_support.is_supported(
        np.array([[0, -1, 0, 0]]), np.zeros((1, 46)), np.zeros((3, 1)), np.zeros(1), -G * normal,
        ground, corners, np.array(touch), np.zeros(6), 1e-3)


def test_a_push_along_the_ground_is_borne_up_to_nine_tenths_of_its_friction():
    """And a weight as far to a side; on ground of any slant, where all is known exactly."""
    rng = np.random.default_rng(8)
    grid = [one for one in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(one)]
    for normal in (*grid, *rng.normal(size=(14, 3))):
        normal /= np.linalg.norm(normal)
        aside = np.cross(normal, rng.normal(size=3))
        aside /= np.linalg.norm(aside)
        across = np.cross(normal, aside)
        size, mass = (1.0, 10.0) if rng.integers(2) else (0.05, 0.04)
        square = size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ np.stack([aside, across])
        point, friction, corners = rng.normal(size=3), 0.6, polygon(square, normal)
        turn = rng.uniform(0, 2 * math.pi)
        push = math.cos(turn) * aside + math.sin(turn) * across
        lean = size * (0.5 * aside - 0.3 * across)
        away = np.linalg.norm(square - lean, axis=1)
        beside = size * (-0.4 * aside + 0.7 * across)
        lever = abs(np.cross(beside - lean, push) @ normal)

        borne = partial(bears, mass, normal, point, friction, corners)
        for share, expected in ((0.899, True), (0.901, False)):
            most = share * friction * mass * G
            assert expected == borne(0.0, [*-most * np.cross(point, push), *-most * push])
            for side in (aside, -across):
                assert expected == borne(share * size * side)
            # A torque about the normal as far as the nearest corner can bear it, wherever the
            # weight leans to, and a push along the ground beside the middle of its pressure.
            torque = most * away.min() ** 2 / away.max() * normal
            force = most * push / (1.0 + lever * away.max() / away.min() ** 2)
            assert expected == borne(lean, [*torque, 0.0, 0.0, 0.0])
            assert expected == borne(lean, [*np.cross(point + beside, force), *force])


def ground_of(world, model):
    for _ in range(5):
        pybullet.performCollisionDetection(physicsClientId=world.client)
    return resting_base.RestingBase.from_contacts(
        model, {m.body_id: m for m in world.models.values()})


@pytest.mark.parametrize("ground", ["plane", "box"])
def test_what_a_base_stands_on_is_known_by_its_corners(world, make, ground):
    """Five feet, two within the others' hull, on a slope; what hangs higher is none of them."""
    slope = Pose.from_rpy((0.2, -0.1, 0.3), (0.1, -0.2, 0.5))
    feet = [(-0.31, -0.22), (0.42, -0.17), (0.05, 0.36), (0.1, 0.02), (0.0, -0.1)]
    shapes = "".join(make.box("0.02 0.02 0.1", f"{x} {y} 0.05") for x, y in feet)
    text = make.robot(
        make.link("base", 30.0, "0.03 0.01 0.1", (1, 1, 1, 0, 0, 0),
                  shapes + make.box("0.1 0.1 0.1", "0.9 0 0.3")
                  + make.box("0.02 0.02 0.1", "-0.6 0.4 0.0502")),
        make.link("post", 3.0, "0 0.3 0"),
        make.joint("foot", "base", "post", "fixed", "0.5 0.1 0.4"),
        make.link("slide", 2.0), make.joint("rail", "post", "slide", "prismatic", "0 0 0.5"),
        '<gazebo reference="base"><mu1>0.6</mu1></gazebo>')
    shape = '<collision><geometry><plane normal="0 0 1"/></geometry></collision>'
    floor = shape if ground == "plane" else make.box("4 4 0.2", "0 0 -0.1")
    below = world.spawn(parse_urdf(make.robot(
        f'<link name="world">{floor}</link>',
        '<gazebo reference="world"><mu1>0.4</mu1></gazebo>')), "slope", slope)
    world.delete("ground_plane")
    model = world.spawn(parse_urdf(text), "table", slope @ Pose((0.0, 0.0, -5e-6)))
    found = ground_of(world, model)
    assert found.grounds == {below.body_id} and found.mass == 33.0  # with the post
    assert not found.contact_wrench.any()
    numbers, corners = found.ground, found.corners
    assert numbers[1:4] == pytest.approx(
        [(30 * a + 3 * b) / 33 for a, b in ((0.03, 0.5), (0.01, 0.4), (0.1, 0.4))])
    assert numbers[4:7] == pytest.approx([0.0, 0.0, 1.0], abs=1e-3)
    assert numbers[10] == 0.4
    assert corners[:, :3].mean(axis=0) == pytest.approx([0.0] * 3, abs=1e-9)
    hull = {(-0.32, -0.23), (-0.32, -0.21), (-0.3, -0.23), (0.43, -0.18), (0.43, -0.16),
            (0.06, 0.37), (0.04, 0.37)}
    at = corners[:, :3] + numbers[7:10]
    if ground == "plane":  # of what touches a box Bullet tells some corners
        assert {tuple(np.round(one, 3).tolist()) for one in at[:, :2]} == hull
    assert np.abs(at[:, 2]).max() < 2e-5
    ahead = np.roll(at, -1, axis=0) - at
    assert np.linalg.norm(corners[:, 3:], axis=1) == pytest.approx([1.0] * len(at))
    assert np.einsum("ij,ij->i", ahead, corners[:, 3:]) == pytest.approx([0.0] * len(at), abs=1e-6)
    # Each edge has all corners on its inner side.
    assert (np.einsum("ik,ijk->ij", corners[:, 3:], at[None] - at[:, None]) < 1e-6).all()


@pytest.mark.parametrize("twist", [
    Twist((0.05, 0.0, 0.0)), Twist((0.0, 0.0, 0.0), (0.0, 0.0, 0.3))], ids=["slides", "turns"])
def test_a_base_that_still_moves_on_slippery_ground_is_not_held(world, make, twist):
    model = world.spawn(cart(make, mu=1e-3), "cart")
    for moves, is_held in ((twist, False), (Twist(), True)):
        model.set_twist(moves)
        steps(world, 400)
        assert model.fixed_base is is_held


def test_three_points_are_enough_to_stand_on(world, make, tmp_path):
    """Feet that end in a tip each; two of them, or three in a row, are not."""
    tip = tmp_path / "tip.obj"
    tip.write_text("v 0 0 0\nv 0.02 0.02 0.1\nv -0.02 0.02 0.1\nv 0 -0.02 0.1\n"
                   "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    triangle = [(-0.2, -0.2), (0.3, -0.1), (0.0, 0.25)]
    for places in (triangle, triangle[:2], [(-0.2, 0.0), (0.1, 0.0), (0.3, 0.0)]):
        shapes = "".join(collision(f'<mesh filename="file://{tip}"/>', f"{x} {y} 0")
                         for x, y in places)
        found = ground_of(world, world.spawn(cart(make, shapes=shapes), "table"))
        assert (found is not None) is (places == triangle)
        if found is not None:
            at = found.corners[:, :2] + found.ground[7:9]
            assert sorted(map(tuple, at.round(4).tolist())) == sorted(triangle)
        world.delete("table")


@pytest.mark.parametrize(("share", "holds"), [(1.01, True), (0.99, False)])
@pytest.mark.parametrize("order", [("cart", "box"), ("box", "cart")])
def test_a_base_is_held_a_hundred_times_as_heavy_as_what_is_loose(world, make, share, holds, order):
    """10 kg beside a hundredth: what comes, and what is there already."""
    spawn = {"cart": lambda: world.spawn(cart(make), "cart"),
             "box": lambda: loose_box(make, world, "box", 0.1 / share, (3.0, 0.0, 0.0495))}
    for name in order:
        spawn[name]()
        world.step()
        assert name != "cart" or order[0] == "box" or world.model(name).fixed_base
    assert world.model("cart").fixed_base is holds


def test_a_base_stands_on_the_box_that_is_under_it_though_there_is_a_plane_too(world, make):
    plane = '<collision><geometry><plane normal="0 0 1"/></geometry></collision>'
    world.spawn(parse_urdf(make.robot(
        f'<link name="world">{plane}{make.box("0.3 0.2 0.4", "0 0 0.2")}</link>')), "block",
        Pose((3.0, 0.0, 0.0)))
    model = world.spawn(cart(make), "cart", Pose((3.0, 0.0, 0.4 - 5e-6)))
    found = ground_of(world, model)
    at = np.abs(found.corners[:, :2] + found.ground[7:9])
    assert at.max(axis=0) == pytest.approx([0.15, 0.1], abs=1e-3)
