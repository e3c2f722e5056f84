"""The world as a whole: spawning, resets, determinism."""

import math

import pybullet
import pytest

from aras_sim_bridge import errors
from aras_sim_bridge.description import Geometry, parse_urdf
from aras_sim_bridge.world import Pose, Twist, World
from aras_sim_bridge.world.labels import list_links_by_label

G = 9.8


def test_resets_of_the_simulation_and_of_the_world(world, make):
    model = world.spawn(parse_urdf(make.pendulum()), "m", joint_positions={"swing": 0.7})
    late = world.spawn(parse_urdf(make.robot(make.link("late"))), "late", Pose((5, 0, 1)))
    make.step(world, 100, model, swing=3.0)
    late.set_pose(Pose((0, 9, 9)))
    revision = world.revision
    world.reset_simulation()
    assert [list(values) for values in model.read_joints()] == [[0.7], [0.0], [0.0]]
    assert late.pose().xyz == (5, 0, 1)
    assert list(world.models) == ["m", "late"]
    assert world.revision == revision + 1
    arm = make.robot(make.link("base"), make.link("arm"),
                     make.joint("turn", "base", "arm", "continuous"))
    model = world.spawn(parse_urdf(arm), "arm", Pose((1, 2, 3)))
    model.set_twist(Twist((1, 0, 0), (0, 0, 1)))
    make.step(world, 50, model, turn=1.0)
    angle = model.read_joints()[0][0]
    world.reset_world()
    assert angle > 0 and [list(part) for part in model.read_joints()[:2]] == [[angle], [0.0]]
    assert model.pose().xyz == pytest.approx((1, 2, 3), abs=1e-12)
    assert model.twist() == Twist()


def test_root_rules(world, make):
    """A root without mass is bolted whatever is asked: Bullet nails it."""
    fixed = make.joint("ab", "a", "b", "fixed") + make.joint("bc", "b", "c", "fixed")
    below = make.robot('<link name="a"/><link name="b"/>', make.link("c"), fixed)
    static = "<gazebo><static>1</static></gazebo></robot>"
    models = {name: world.spawn(parse_urdf(text), name, fixed_base=asked) for name, text, asked in (
        ("free", make.robot(make.link("a")), None), ("below", below, None),
        ("heavy", make.robot(make.link("world")), False), ("bolted", make.pendulum(), None),
        ("nailed", make.pendulum(damping=0.1), False),
        ("massless", make.robot('<link name="a"/>'), None),
        ("asked", make.robot(make.link("a")), True),
        ("still", make.pendulum().replace("</robot>", static), None))}
    assert [name for name, one in models.items() if not one.fixed_base] == [
        "free", "below", "heavy"]
    assert models["still"].joint_names == ()
    make.step(world, 20)
    assert models["free"].pose().xyz[2] < 0
    assert models["below"].pose().xyz == pytest.approx(models["free"].pose().xyz)
    assert models["asked"].pose().xyz == (0, 0, 0)


def test_the_ground_plane_is_gazebo_s(world):
    """Grey, a hundred metres wide to the eye, and rougher than what stands on it."""
    model = world.spawn_ground_plane("floor")
    assert (model.name, model.fixed_base, model.description.static) == ("floor", True, True)
    (link,) = model.description.links.values()
    assert link.name == model.description.root and link.mu == 100.0
    for (part,) in (link.visuals, link.collisions):
        assert part.geometry == Geometry("plane", size=(100.0, 100.0, 0.0))
        assert part.pose == Pose()
    assert model.description.colours == {link.name: (0.7, 0.7, 0.7, 1.0)}


@pytest.mark.parametrize(("arguments", "text"), [
    ({"name": ""}, "not empty"), ({"name": "taken"}, "'taken' exists already"),
    ({"pose": Pose((math.nan, 0, 0))}, "position.*not finite"),
    ({"pose": Pose((0, 0, 0), (0, 0, math.inf, 1))}, "orientation.*not finite"),
    ({"pose": ((0, 0), (0, 0, 0, 1))}, "needs 3 numbers"),
    ({"joint_positions": {"J9": 0.0}}, "no moving joint 'J9'; its moving joints: swing"),
    ({"joint_positions": {"swing": math.nan}}, "'swing': position nan is not finite")])
def test_bad_spawns_are_refused_and_leave_the_world_alone(world, make, arguments, text):
    description = parse_urdf(make.pendulum())
    world.spawn(description, "taken")
    with pytest.raises(errors.WorldError, match=text):
        world.spawn(description, **{"name": "m", **arguments})
    assert list(world.models) == ["taken"]


@pytest.mark.parametrize(("name", "told", "message"), [
    ("loadURDF", pybullet.error("no"), r"Bullet cannot load model 'm' \(no\); .* mesh files"),
    ("getNumJoints", 0, r"model 'm': Bullet did not load the links \['bob'\]"),
])
def test_what_bullet_does_not_take_whole_is_refused(world, make, monkeypatch, name, told, message):
    def answer(*_, **__):
        if isinstance(told, Exception):
            raise told
        return told

    monkeypatch.setattr(pybullet, name, answer)
    with pytest.raises(errors.WorldError, match=message):
        world.spawn(parse_urdf(make.pendulum()), "m")
    assert not world.models and not pybullet.getNumBodies(physicsClientId=world.client)


@pytest.mark.parametrize(("name", "reason", "good", "bad"), [
    ("time_step", "time step", (0.1, 1e-6), (0.99e-6, 0.101, "0.001")),
    ("solver_iterations", "solver iterations", (1, 10000), (0, 10001, 1.5)),
    ("gravity", "gravity", ((0.0, 0.0, 0.0), (100.0, -100.0, 0.0)),
     ((100.1, 0.0, 0.0), (0.0, -100.1, 0.0), (0, 0, math.nan)))])
def test_steps_gravity_and_sweeps_are_taken_up_to_their_bounds(name, reason, good, bad):
    with World(**{name: good[0]}) as world:
        for value in good:
            world.set_physics(**{name: value})
            assert getattr(world, name) == value
            world.reset_simulation()
            asked = pybullet.getPhysicsEngineParameters(physicsClientId=world.client)
            found = {"time_step": asked["fixedTimeStep"],
                     "solver_iterations": asked["numSolverIterations"],
                     "gravity": tuple(asked[f"gravityAcceleration{axis}"] for axis in "XYZ")}
            assert found[name] == value
        for value in bad:
            with pytest.raises(errors.WorldError, match=reason):
                world.set_physics(**{name: value})
            with pytest.raises(errors.WorldError, match=reason):
                World(**{name: value})
        assert getattr(world, name) == good[-1]


def test_without_a_client_or_a_window_no_world_starts(window, monkeypatch):
    def no_window(mode):
        raise pybullet.error("no display")

    for answer, message in ((lambda mode: -1, "Bullet does not start"),
                            (no_window, r"cannot open its window \(no display\); .* gui:=false")):
        monkeypatch.setattr(pybullet, "connect", answer)
        with pytest.raises(errors.WorldError, match=message):
            World(gui=True)


def test_a_window_is_plain_and_shows_what_bullet_moves(make, window):
    """Without panels and shadows, and Bullet makes all steps; another world configures none."""
    with World(gui=True) as world:
        assert window == [(pybullet.COV_ENABLE_GUI, False), (pybullet.COV_ENABLE_SHADOWS, False)]
        model = world.spawn(parse_urdf(make.pendulum()), "m", joint_positions={"swing": 0.5})
        world.step()
        assert not model.joints.has_own_dynamics
        shown = pybullet.getJointState(model.body_id, 0, physicsClientId=world.client)
        assert shown[1] == pytest.approx(-G * 0.5 * math.sin(0.5) * 1e-3 / 0.26, rel=1e-6)
        client = world.client
    assert not pybullet.getConnectionInfo(client)["isConnected"]  # it serves no other world
    window.clear()
    with World() as world:
        world.spawn(parse_urdf(make.pendulum()), "m")
    assert window == []


def test_joints_that_mimic_begin_where_their_leaders_do(world, make):
    """Over two others, in an order in which leaders come last; one that is given stays."""
    def follows(leader, multiplier, offset):
        return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'

    text = make.robot(
        '<link name="world"/>', *map(make.link, "abcd"),
        make.joint("last", "world", "a", extra=follows("middle", 2, 0.1)),
        make.joint("middle", "world", "b", extra=follows("first", -0.5, 0.2)),
        make.joint("other", "world", "c", extra=follows("first", 3, 0.0)),
        make.joint("first", "world", "d"))
    for name, given, expected in (
        ("none", {}, (0.5, 0.2, 0.0, 0.0)), ("one", {"first": 0.6}, (-0.1, -0.1, 1.8, 0.6)),
        ("two", {"first": 0.6, "middle": 1.0}, (2.1, 1.0, 1.8, 0.6))):
        model = world.spawn(parse_urdf(text), name, joint_positions=given)
        assert model.read_joints()[0] == pytest.approx(expected)


def test_unknown_names_carry_what_there_is(world, make):
    model = world.spawn(parse_urdf(make.pendulum()), "swing")
    for kind, call, expected in (
        (errors.UnknownJointError, lambda: model.apply_effort("elbow", 1.0),
         {"model": "swing", "joint": "elbow", "available": ("swing",)}),
        (errors.UnknownLinkError, lambda: model.link_pose("hand"),
         {"link": "hand", "available": ("world", "bob")}),
        (errors.UnknownModelError, lambda: world.model("arm"),
         {"name": "arm", "available": ("swing",)})):
        with pytest.raises(kind) as caught:
            call()
        assert expected.items() <= vars(caught.value).items()
    # as Bullet numbers pixels: the body, and above it the link, 0 for the root
    assert list_links_by_label(world.models) == {
        model.body_id: "swing::world", model.body_id + (1 << 24): "swing::bob"}
