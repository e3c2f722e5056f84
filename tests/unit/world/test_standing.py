"""Resting free bases: at rest like fixed ones, and free when the ground cannot hold them."""

import itertools
import math

import numpy as np
import pybullet
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World, ground_support, resting_base
from aras_sim_bridge.world.description_changes import change_joint

G = 9.8


def cart(make, mass=10.0, load=2.0, height=0.5, mu=0.5, axis="1 0 0",
         travel=20.0, shapes=None):
    """A block of 0.6 m with a slide on top of it; `height`: of the slide above the ground."""
    x, y, z = 0.6, 0.6, 0.2
    inertia = [mass * (a * a + b * b) / 12 for a, b in ((y, z), (x, z), (x, y))]
    return parse_urdf(make.robot(
        make.link("base", mass, "0 0 0.1", (*inertia, 0, 0, 0),
                  shapes or make.box("0.6 0.6 0.2", "0 0 0.1")),
        make.link("slide", load, "0 0 0", (0.01,) * 3 + (0, 0, 0)),
        make.joint("rail", "base", "slide", "prismatic", f"0 0 {height}", axis, -travel, travel),
        f'<gazebo reference="base"><mu1>{mu}</mu1></gazebo>'))


@pytest.fixture
def world():
    """World with only the ground."""
    with World() as it:
        it.spawn_ground_plane()
        yield it


@pytest.fixture
def shown(window):
    """World with only the ground, in Bullet's window: Bullet makes all steps."""
    with World(gui=True) as it:
        it.spawn_ground_plane()
        yield it


def steps(world, count, model=None, rail=0.0):
    """Advance with a constant effort in the rail."""
    for _ in range(count):
        if model is not None:
            model.apply_effort("rail", rail)
        world.step()


@pytest.fixture
def held(world, make):
    """Cart at rest whose base is held."""
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


def cube_mesh(folder, half=0.5) -> str:
    """A <mesh> of a cube about the origin, by its corners and faces."""
    corners = list(itertools.product((-half, half), repeat=3))
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    path = folder / f"cube{half}.obj"
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners)
                    + "".join(f"f {face}\n" for face in faces))
    return f'<mesh filename="file://{path}"/>'


def collision(geometry: str, origin: str) -> str:
    return f'<collision><origin xyz="{origin}"/><geometry>{geometry}</geometry></collision>'


def test_a_base_on_feet_that_are_links_is_held(world, make):
    """Bullet leaves a millimetre around the hulls of links: it stands on that."""
    feet = [
        (f"foot{k}", x, y)
        for k, (x, y) in enumerate(itertools.product((-0.3, 0.3), repeat=2))
    ]
    shape = collision('<cylinder radius="0.03" length="0.2"/>', "0 0 0.1")
    model = world.spawn(parse_urdf(make.robot(
        make.link("base", 20.0, "0 0 0.3", (1,) * 3 + (0,) * 3, make.box("0.6 0.6 0.2", "0 0 0.3")),
        *(make.link(name, 1.0, "0 0 0.1", (0.01,) * 3 + (0, 0, 0), shape) for name, _, _ in feet),
        *(make.joint(f"at_{name}", "base", name, "fixed", f"{x} {y} 0") for name, x, y in feet),
        make.link("slide", 2.0, "0 0 0", (0.01,) * 3 + (0, 0, 0)),
        make.joint("rail", "base", "slide", "prismatic", "0 0 0.5", "1 0 0", -2.0, 2.0))), "table")
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
    shapes = {
        "mesh": collision(cube_mesh(tmp_path, 0.3), "0 0 0.3"),
        "cylinder": collision('<cylinder radius="0.3" length="0.2"/>', "0 0 0.1"),
    }[what]
    model = world.spawn(cart(make, shapes=shapes), "cart")
    steps(world, 200)
    assert model.fixed_base
    assert model.pose().xyz == pytest.approx((0.0, 0.0, 0.0), abs=2e-5)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("shape", "tilt"), [("sphere", 0.3), ("capsule", 0.0),
                                             ("capsule", math.pi / 2)])
def test_a_base_that_could_roll_is_left_to_bullet(world, make, shape, tilt):
    shape = {"sphere": '<sphere radius="0.1"/>',
             "capsule": '<capsule radius="0.1" length="0.3"/>'}[shape]
    still = (0.3, 0.3, 0.6, 0, 0, 0)
    model = world.spawn(parse_urdf(make.robot(
        make.link("base", 10.0, "0 0 0", still, collision(shape, "0 0 0")),
        make.link("slide", 2.0, "0 0 0", (0.01,) * 3 + (0, 0, 0)),
        make.joint("rail", "base", "slide", "prismatic", "0 0 0", "1 0 0", -2.0, 2.0))), "ball",
        Pose.from_rpy((0.0, 0.0, 0.3), (tilt, 0.0, 0.0)))
    steps(world, 1500)
    assert not model.fixed_base and np.isfinite(model.pose().xyz).all()


def test_meshes_lie_on_one_another_without_a_gap(world, make, tmp_path):
    shape = collision(cube_mesh(tmp_path, 0.05), "0 0 0")
    cube = make.robot(make.link("cube", 1.0, "0 0 0", (0.0017,) * 3 + (0, 0, 0), shape))
    cubes = [world.spawn(parse_urdf(cube), f"cube {k}", Pose((0.0, 0.0, 0.05 + 0.1 * k)))
             for k in range(3)]
    steps(world, 1000)
    heights = [it.pose().xyz[2] for it in cubes]
    assert heights == pytest.approx([0.05, 0.15, 0.25], abs=5e-5)


def test_what_joints_did_goes_on_when_the_base_is_held(world, make):
    model = world.spawn(cart(make), "cart")
    speeds, efforts = [], []
    for _ in range(300):
        model.apply_effort("rail", 2.0)
        world.step()
        speeds.append(model.read_joints()[1][0])
        efforts.append(model.read_joints()[2][0])
    assert model.fixed_base
    assert np.diff(speeds)[100:] == pytest.approx(1e-3, rel=1e-3)  # 2 N on 2 kg
    assert efforts == [2.0] * 300
    model.set_fixed_base(False)
    assert model.read_joints()[2] == [2.0]


@pytest.mark.parametrize("where", ["world", "shown"])
def test_a_push_of_the_arm_beyond_friction_moves_the_base(request, make, where):
    """12 kg with 0.5 hold 58.8 N; of 100 N the base takes what is left."""
    world = request.getfixturevalue(where)
    model = world.spawn(cart(make, height=0.1), "cart")
    steps(world, 200)
    steps(world, 50, model, 50.0)
    assert model.joints.has_own_dynamics is (where == "world")
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
    tilt = abs(model.twist().angular[1])
    assert tilt == 0.0 if height == 0.5 else tilt > 0.05


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


DISTURBED = {
    "pushed": lambda world, model: model.apply_force("base", (1.0, 0.0, 0.0), model.pose().xyz),
    "turned": lambda world, model: model.apply_force("base", (0, 0, 0), (0, 0, 0), (0, 0, 1.0)),
    "moved": lambda world, model: model.set_pose(Pose((1.0, 0.0, 0.5))),
    "thrown": lambda world, model: model.set_twist(Twist((0.5, 0.0, 0.0))),
    "other gravity": lambda world, model: world.set_physics(gravity=(0.0, 0.0, 1.0)),
    "no ground": lambda world, model: world.delete("ground_plane"),
    "ground moved": lambda world, model: world.model("ground_plane").set_pose(Pose((0, 0, -1.0))),
    "changed": lambda world, model: world.change_model(
        "cart", change_joint(model.description, "rail", damping=1.0)),
}


@pytest.mark.parametrize("what", DISTURBED)
def test_whatever_happens_to_a_held_base_finds_it_free(world, held, what):
    before = held.pose()
    DISTURBED[what](world, held)
    assert not held.fixed_base
    steps(world, 30)
    moved = math.dist(before.xyz, held.pose().xyz)
    assert (moved > 2e-4) is (what in ("moved", "thrown", "other gravity", "no ground",
                                        "ground moved"))


def test_a_push_at_the_slide_is_the_arm_s(world, held):
    for _ in range(100):
        held.apply_force("slide", (0.0, 30.0, 0.0), held.link_pose("slide").xyz)
        world.step()
    assert held.fixed_base
    for _ in range(5):
        held.apply_force("slide", (0.0, 90.0, 0.0), held.link_pose("slide").xyz)
        world.step()
    assert not held.fixed_base


def test_a_push_at_the_slide_ends_with_its_step_where_bullet_steps_too(shown, make):
    world = shown
    model = world.spawn(cart(make, 200.0), "cart")
    steps(world, 300)
    assert model.fixed_base and not model.joints.has_own_dynamics
    speeds = []
    for n in range(20):
        if n == 0:
            model.apply_force("slide", (20.0, 0.0, 0.0), model.link_pose("slide").xyz)
        world.step()
        speeds.append(model.read_joints()[1][0])
    assert speeds[0] == pytest.approx(0.01, rel=0.05)  # 20 N on 2 kg for 1 ms
    assert max(speeds) <= speeds[0] + 1e-9


def test_a_reset_starts_free_and_comes_to_the_same_again(world, held):
    first = (held.pose(), held.read_joints()[0])
    world.reset_simulation()
    assert not held.fixed_base
    steps(world, 200)
    assert held.fixed_base
    second = (held.pose(), held.read_joints()[0])
    world.reset_simulation()
    steps(world, 200)
    assert (held.pose(), held.read_joints()[0]) == second
    assert second[0].xyz == pytest.approx(first[0].xyz, abs=1e-9)


def test_a_reset_of_poses_alone_finds_it_standing_at_the_next_step(world, held):
    at = held.spawn_pose
    held.set_pose(Pose((1.0, 0.0, 0.0)))
    world.step()
    assert not held.fixed_base
    world.reset_world()
    steps(world, 3)
    assert held.fixed_base and held.pose() == at


@pytest.mark.parametrize("which", ["the ground of one", "one of two", "a push of one",
                                   "a box that is heavy for one"])
def test_both_of_two_bases_are_let_go_where_one_has_to_be(world, make, which):
    block = make.robot(f'<link name="world">{make.box("2 2 0.2", "0 0 -0.1")}</link>')
    world.spawn(parse_urdf(block), "block", Pose((0.0, 5.0, 1.0)))
    models = [world.spawn(cart(make, mass), name, at)
              for mass, name, at in ((10.0, "a", Pose()), (1000.0, "b", Pose((0.0, 5.0, 1.0))))]
    steps(world, 300)
    assert [one.fixed_base for one in models] == [True, True]
    if which == "one of two":
        models[0].set_pose(Pose((0.0, 0.0, 0.5)))
    elif which.startswith("a box"):
        loose_box(make, world, "box", 1.0, (3.0, 0.0, 3.0))
    elif which == "a push of one":
        models[0].apply_effort("rail", 1000.0)
        world.step()
    else:
        world.delete("block")
    assert [one.fixed_base for one in models] == [False, False]


def test_who_was_held_once_and_is_free_now_frees_nobody_else(world, make, held):
    small = world.spawn(cart(make, mass=0.02, load=0.01), "small", Pose((3.0, 0.0, 0.0)))
    steps(world, 300)
    assert held.fixed_base and small.fixed_base
    small.set_pose(Pose((3.0, 0.0, 4.0)))
    assert not held.fixed_base and not small.fixed_base
    steps(world, 200)
    assert held.fixed_base and not small.fixed_base  # it falls
    small.apply_force("base", (0.0, 0.0, 0.1), small.pose().xyz)
    small.set_twist(Twist((0.1, 0.0, 0.0)))
    assert held.fixed_base


def test_another_model_leaves_it_held_unless_it_is_heavy_and_loose(world, make, held):
    shelf = make.robot('<link name="world">' + make.box("0.1 0.1 0.1", "0 0 8") + "</link>")
    target = world.spawn(parse_urdf(shelf), "shelf", Pose((0.0, 5.0, 0.0)))
    for k in range(50):  # as a target that moves
        target.set_pose(Pose((0.01 * k, 5.0, 0.0)))
        world.step()
        assert held.fixed_base
    world.delete("shelf")
    assert held.fixed_base
    loose_box(make, world, "heavy", 5.0, (3.0, 0.0, 0.05))
    assert not held.fixed_base


@pytest.mark.parametrize("what", ["a cart on a table", "a cart on a lift", "a cart on wheels",
                                  "a cart in a groove"])
def test_what_stands_otherwise_is_left_to_bullet(world, make, what):
    top = make.link("top", 50.0, "0 0 0.1", (5, 5, 5, 0, 0, 0), make.box("2 2 0.2", "0 0 0.1"))
    if what == "a cart on a table":
        world.spawn(parse_urdf(make.robot(top)), "table")
        model = world.spawn(cart(make), "cart", Pose((0, 0, 0.2)))
    elif what == "a cart on a lift":
        world.spawn(parse_urdf(make.robot(make.link("world"), top, make.joint(
            "up", "world", "top", "prismatic", axis="0 0 1", lower=0.0, upper=1.0))), "lift")
        model = world.spawn(cart(make), "cart", Pose((0, 0, 0.2)))
    elif what == "a cart in a groove":
        sides = "".join(f'<collision><origin xyz="{x} 0 0.2" rpy="0 {turn} 0"/><geometry>'
                        '<box size="1 2 0.2"/></geometry></collision>'
                        for x, turn in ((-0.5, 0.3), (0.5, -0.3)))
        world.spawn(parse_urdf(make.robot(f'<link name="world">{sides}</link>')), "groove")
        model = world.spawn(cart(make, mu=0.9), "cart", Pose((0, 0, 0.25)))
    else:
        wheel = make.link("{0}", 1.0, "0 0 0", (0.01,) * 3 + (0, 0, 0), make.box("0.2 0.1 0.2"))
        model = world.spawn(parse_urdf(make.robot(
            make.link("base", 5.0), *(wheel.format(n) for n in "ab"),
            make.joint("ja", "base", "a", "continuous", "0 0.5 0", damping=1e6),
            make.joint("jb", "base", "b", "continuous", "0 -0.5 0", damping=1e6))), "carriage",
            Pose((0, 0, 0.1)))
    steps(world, 400)
    assert not model.fixed_base


def loose_box(make, world, name, mass, at, side=0.1, mu=0.5, speed=(0.0, 0.0, 0.0)):
    """A box that nothing holds, at the middle of it, with a speed."""
    inertia = (mass * side**2 / 6,) * 3 + (0, 0, 0)
    box = world.spawn(parse_urdf(make.robot(
        make.link("box", mass, "0 0 0", inertia, make.box(f"{side} {side} {side}")),
        f'<gazebo reference="box"><mu1>{mu}</mu1></gazebo>')), name, Pose(at))
    box.set_twist(Twist(speed))
    return box


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
    assert one.contact_wrench[3:5] == pytest.approx(0.5 * 9.8 * np.array((0.8, 0.6)), rel=0.1)
    assert one.contact_wrench[5] == pytest.approx(-9.8, rel=0.1)


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


def _most_that_can_be_borne(normal, mass, centre, point, corners, friction, gravity, load):
    """The largest multiple of a load that forces at the corners balance, each within its cone of
    24 sides: a linear programme."""
    aside = np.cross(normal, (0.3, 0.5, 0.8))
    aside /= np.linalg.norm(aside)
    rim = [math.cos(a) * aside + math.sin(a) * np.cross(normal, aside)
           for a in np.linspace(0, 2 * math.pi, 25)[:-1]]
    columns = []
    for corner in corners[:, :3] + point:
        for direction in rim:
            force = normal + friction * direction
            columns.append(np.concatenate([np.cross(corner, force), force]))
    weight = mass * gravity
    found = linprog([0.0] * len(columns) + [-1.0], A_eq=np.array([*columns, -load]).T,
                    b_eq=-np.concatenate([np.cross(centre, weight), weight]))
    if found.status == 3:  # it presses down
        return math.inf
    return -found.fun if found.status == 0 else 0.0


def bears(ground, corners, gravity, touch=(0.0,) * 6, frames=None):
    """Whether the ground holds a base whose only joint is at rest."""
    return ground_support.is_supported(
        np.array([[0, -1, 0, 0]]), np.zeros((1, 46)) if frames is None else frames,
        np.zeros((3, 1)), np.zeros(1), gravity, ground, corners, np.array(touch), np.zeros(6), 1e-3)


def test_a_base_is_held_up_to_what_the_ground_can_bear_and_no_further():
    """The judgement against a linear programme of forces at the corners, along random loads."""
    rng = np.random.default_rng(5)
    shares = []
    for _ in range(40):
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        gravity = -G * (normal + 0.15 * rng.normal(size=3))
        point, mass, friction = rng.normal(size=3), 10.0, 0.6
        aside = np.cross(normal, rng.normal(size=3))
        aside /= np.linalg.norm(aside)
        flat = rng.uniform(-1, 1, (5, 2)) + [(-1, -1), (1, -1), (1, 1), (-1, 1), (0, 0)]
        on_ground = flat @ np.stack([aside, np.cross(normal, aside)])
        corners = polygon(on_ground - on_ground.mean(axis=0), normal)
        centre = point + 0.4 * normal + 0.1 * rng.normal(size=3)
        load = rng.normal(size=6)
        load[:3] += np.cross(centre, load[3:])
        ground = np.array([mass, *centre, *normal, *point, friction])
        frames = np.zeros((1, 46))  # of one joint, at rest, whose body asks for the load

        low, high = 0.0, 1000.0  # how much of the load is just borne, by bisection
        for _ in range(14):
            # Half of it by what touches the model.
            frames[0, 40:46] = (low + high) / 4 * load
            touch = -(low + high) / 4 * load
            borne = bears(ground, corners, gravity, touch, frames)
            low, high = ((low + high) / 2, high) if borne else (low, (low + high) / 2)
        most = _most_that_can_be_borne(normal, mass, centre, point, corners, friction, gravity,
                                       load)
        assert low <= most
        if 0.0 < most < 1000.0:
            shares.append(low / most)
    assert np.median(shares) > 0.25


def test_a_push_along_the_ground_is_borne_up_to_nine_tenths_of_its_friction():
    """And a weight up to nine tenths of the way to a side; on ground of any slant, along axes and
    diagonals of the root too, where all is known exactly."""
    rng = np.random.default_rng(8)
    grid = [one for one in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(one)]
    for normal in (*grid, *rng.normal(size=(14, 3))):
        normal /= np.linalg.norm(normal)
        aside = np.cross(normal, rng.normal(size=3))
        aside /= np.linalg.norm(aside)
        across = np.cross(normal, aside)
        square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ np.stack([aside, across])
        size, mass = (1.0, 10.0) if rng.integers(2) else (0.05, 0.04)
        square, point, friction = size * square, rng.normal(size=3), 0.6
        corners = polygon(square, normal)
        turn = rng.uniform(0, 2 * math.pi)
        push = math.cos(turn) * aside + math.sin(turn) * across
        load = np.concatenate([np.cross(point, push), push])
        ground = np.array([mass, *point + 0.4 * normal, *normal, *point, friction])
        for share, borne in ((0.899, True), (0.901, False)):
            touch = -share * friction * mass * G * load
            assert borne == bears(ground, corners, -G * normal, touch)
            for side in (aside, -across):  # and its weight up to nine tenths of the way to a side
                ground[1:4] = point + share * size * side + 0.4 * normal
                assert borne == bears(ground, corners, -G * normal)
            # And a torque about the normal as far as the nearest corner can bear it, wherever the
            # weight leans to.
            lean = size * (0.5 * aside - 0.3 * across)
            ground[1:4] = point + lean + 0.4 * normal
            away = np.linalg.norm(square - lean, axis=1)
            most = friction * mass * G * away.min() ** 2 / away.max()
            touch = np.concatenate([share * most * normal, np.zeros(3)])
            # The same for a push along the ground beside the middle of its pressure.
            beside = size * (-0.4 * aside + 0.7 * across)
            lever = abs(np.cross(beside - lean, push) @ normal)
            force = share * friction * mass * G * push / (
                1.0 + lever * away.max() / away.min() ** 2)
            for touches in (touch, np.concatenate([np.cross(point + beside, force), force])):
                assert borne == bears(ground, corners, -G * normal, touches)
            ground[1:4] = point + 0.4 * normal


def ground_of(world, model):
    """What a model that was put somewhere stands on."""
    for _ in range(5):
        pybullet.performCollisionDetection(physicsClientId=world.client)
    return resting_base.RestingBase.from_contacts(
        model, {m.body_id: m for m in world.models.values()})


@pytest.mark.parametrize("ground", ["plane", "box"])
def test_what_a_base_stands_on_is_known_by_its_corners(world, make, ground):
    """Five feet without any symmetry, two of them within the others' hull, on a slope of friction
    0.4; what hangs higher, if by 0.2 mm, is none of them, the smallest friction counts."""
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
    model.set_twist(twist)
    steps(world, 400)
    assert not model.fixed_base
    model.set_twist(Twist())
    steps(world, 400)
    assert model.fixed_base


def test_three_points_are_enough_to_stand_on(world, make, tmp_path):
    """Feet that end in a tip each; two of them, or three in a row, are not."""
    tip = tmp_path / "tip.obj"
    tip.write_text("v 0 0 0\nv 0.02 0.02 0.1\nv -0.02 0.02 0.1\nv 0 -0.02 0.1\n"
                   "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    triangle = [(-0.2, -0.2), (0.3, -0.1), (0.0, 0.25)]
    for places, stands in ((triangle, True), (triangle[:2], False),
                           ([(-0.2, 0.0), (0.1, 0.0), (0.3, 0.0)], False)):
        shapes = "".join(collision(f'<mesh filename="file://{tip}"/>', f"{x} {y} 0")
                         for x, y in places)
        model = world.spawn(cart(make, shapes=shapes), "table")
        found = ground_of(world, model)
        assert (found is not None) is stands
        if stands:
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
    """Not on those of its corners that hang over."""
    plane = '<collision><geometry><plane normal="0 0 1"/></geometry></collision>'
    world.spawn(parse_urdf(make.robot(
        f'<link name="world">{plane}{make.box("0.3 0.2 0.4", "0 0 0.2")}</link>')), "block",
        Pose((3.0, 0.0, 0.0)))
    model = world.spawn(cart(make), "cart", Pose((3.0, 0.0, 0.4 - 5e-6)))
    found = ground_of(world, model)
    at = np.abs(found.corners[:, :2] + found.ground[7:9])
    assert at.max(axis=0) == pytest.approx([0.15, 0.1], abs=1e-3)
