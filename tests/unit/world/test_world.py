"""The world as a whole: spawning, resets, determinism."""

import math

import pybullet
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import (
    UnknownJointError,
    UnknownLinkError,
    UnknownModelError,
    WorldError,
)
from aras_sim_bridge.world import Pose, Twist, World
from aras_sim_bridge.world.labels import list_links_by_label

G = 9.8


def test_reset_simulation_restores_spawns_and_their_configurations(make):
    with World() as world:
        model = world.spawn(parse_urdf(make.pendulum()), "m", joint_positions={"swing": 0.7})
        late = world.spawn(parse_urdf(make.robot(make.link("late"))), "late", Pose((5, 0, 1)))
        for _ in range(100):
            model.apply_effort("swing", 3.0)
            world.step()
        late.set_pose(Pose((0, 9, 9)))
        revision = world.revision
        world.reset_simulation()
        assert [list(values) for values in model.read_joints()] == [[0.7], [0.0], [0.0]]
        assert late.pose().xyz == (5, 0, 1)
        assert list(world.models) == ["m", "late"]
        assert world.revision == revision + 1


def test_reset_world_keeps_joint_angles_and_stops_everything(make):
    with World() as world:
        arm = make.robot(make.link("base"), make.link("arm"),
                         make.joint("turn", "base", "arm", "continuous"))
        model = world.spawn(parse_urdf(arm), "m", Pose((1, 2, 3)))
        model.set_twist(Twist((1, 0, 0), (0, 0, 1)))
        for _ in range(50):
            model.apply_effort("turn", 1.0)
            world.step()
        angle = model.read_joints()[0][0]
        assert angle > 0
        world.reset_world()
        assert list(model.read_joints()[0]) == [angle]
        assert list(model.read_joints()[1]) == [0.0]
        assert model.pose().xyz == pytest.approx((1, 2, 3), abs=1e-12)
        assert model.twist() == Twist()


def test_root_rules(make):
    with World() as world:
        free = world.spawn(parse_urdf(make.robot(make.link("a"))), "free")
        bolted = world.spawn(parse_urdf(make.pendulum()), "bolted")
        massless = world.spawn(parse_urdf(make.robot('<link name="a"/>')), "massless")
        below = world.spawn(parse_urdf(make.robot(
            '<link name="a"/><link name="b"/>', make.link("c"),
            make.joint("ab", "a", "b", "fixed"), make.joint("bc", "b", "c", "fixed"))), "below")
        asked = world.spawn(parse_urdf(make.robot(make.link("a"))), "asked", fixed_base=True)
        still = world.spawn(parse_urdf(
            make.pendulum().replace("</robot>", "<gazebo><static>1</static></gazebo></robot>")
        ), "still")
        assert (free.fixed_base, bolted.fixed_base, massless.fixed_base, asked.fixed_base,
                still.fixed_base, below.fixed_base) == (False, True, True, True, True, False)
        assert still.joint_names == ()
        for _ in range(20):
            world.step()
        assert free.pose().xyz[2] < 0
        assert below.pose().xyz == pytest.approx(free.pose().xyz)
        assert asked.pose().xyz == (0, 0, 0)


def test_a_root_without_mass_is_bolted_whatever_is_asked(make):
    """Bullet nails it; as a free one it ended its first step with an IndexError if damped."""
    with World() as world:
        model = world.spawn(parse_urdf(make.pendulum(damping=0.1)), "m", Pose((1, 2, 3)),
                            {"swing": 0.5}, fixed_base=False)
        heavy = world.spawn(parse_urdf(make.robot(make.link("world"))), "heavy", fixed_base=False)
        assert (model.fixed_base, heavy.fixed_base) == (True, False)
        world.step()
        expected = -(G * 0.5 * math.sin(0.5)) * 1e-3 / (0.26 + 1e-3 * 0.1)
        assert model.read_joints()[1][0] == pytest.approx(expected)


def test_the_ground_plane_is_gazebo_s():
    """Grey, a hundred metres wide to the eye, and rougher than what stands on it."""
    with World() as world:
        model = world.spawn_ground_plane("floor")
        assert (model.name, model.fixed_base, model.description.static) == ("floor", True, True)
        (link,) = model.description.links.values()
        assert link.name == model.description.root and link.mu == 100.0
        for (part,) in (link.visuals, link.collisions):
            assert (part.geometry.kind, part.geometry.size) == ("plane", (100.0, 100.0, 0.0))
            assert part.pose == Pose() and part.geometry.normal == (0.0, 0.0, 1.0)
        assert model.description.colours == {link.name: (0.7, 0.7, 0.7, 1.0)}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"name": ""}, "not empty"),
        ({"name": "taken"}, "'taken' exists already"),
        ({"pose": Pose((math.nan, 0, 0))}, "position.*not finite"),
        ({"pose": Pose((0, 0, 0), (0, 0, math.inf, 1))}, "orientation.*not finite"),
        ({"pose": ((0, 0), (0, 0, 0, 1))}, "needs 3 numbers"),
        ({"joint_positions": {"J9": 0.0}}, "no moving joint 'J9'; its moving joints: swing"),
        ({"joint_positions": {"swing": math.nan}}, "'swing': position nan is not finite"),
    ],
)
def test_bad_spawns_are_refused_and_leave_the_world_alone(make, arguments, text):
    with World() as world:
        description = parse_urdf(make.pendulum())
        world.spawn(description, "taken")
        with pytest.raises(WorldError, match=text):
            world.spawn(description, **{"name": "m", **arguments})
        assert list(world.models) == ["taken"]


@pytest.mark.parametrize(("name", "told", "message"), [
    ("loadURDF", pybullet.error("no"), r"Bullet cannot load model 'm' \(no\); .* mesh files"),
    ("getNumJoints", 0, r"model 'm': Bullet did not load the links \['bob'\]"),
])
def test_what_bullet_does_not_take_whole_is_refused(make, monkeypatch, name, told, message):
    def answer(*_, **__):
        if isinstance(told, Exception):
            raise told
        return told

    with World() as world:
        monkeypatch.setattr(pybullet, name, answer)
        with pytest.raises(WorldError, match=message):
            world.spawn(parse_urdf(make.pendulum()), "m")
        assert not world.models and not pybullet.getNumBodies(physicsClientId=world.client)


def test_steps_gravity_and_sweeps_are_taken_up_to_their_bounds():
    with World() as world:
        assert (world.time_step, world.gravity, world.solver_iterations) == (
            0.001, (0.0, 0.0, -9.8), 50)
        for name, values in (("time_step", (1e-6, 0.1)), ("solver_iterations", (1, 10000)),
                             ("gravity", ((100.0, -100.0, 0.0), (0.0, 0.0, 0.0)))):
            for value in values:
                world.set_physics(**{name: value})
                assert getattr(world, name) == value
        for name, reason, values in (
            ("time_step", "time step", (0.99e-6, 0.101, "0.001")),
            ("gravity", "gravity", ((100.1, 0.0, 0.0), (0.0, -100.1, 0.0), (0, 0, math.nan))),
            ("solver_iterations", "solver iterations", (0, 10001, 1.5)),
        ):
            for value in values:
                with pytest.raises(WorldError, match=reason):
                    world.set_physics(**{name: value})
                with pytest.raises(WorldError, match=reason):
                    World(**{name: value})
        assert (world.time_step, world.gravity, world.solver_iterations) == (
            0.1, (0.0, 0.0, 0.0), 10000)


def test_without_a_client_or_a_window_no_world_starts(window, monkeypatch):
    def no_window(mode):
        raise pybullet.error("no display")

    for answer, message in (
        (lambda mode: -1, "Bullet does not start"),
        (no_window, r"cannot open its window \(no display\); .* gui:=false"),
    ):
        monkeypatch.setattr(pybullet, "connect", answer)
        with pytest.raises(WorldError, match=message):
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


def test_bullet_has_the_numbers_of_the_world():
    with World(0.002, (0.5, 1.0, -5.0), solver_iterations=7) as world:
        for step, gravity, sweeps in ((0.002, (0.5, 1.0, -5.0), 7), (0.004, (0.0, 2.0, 0.0), 9)):
            asked = pybullet.getPhysicsEngineParameters(physicsClientId=world.client)
            assert (asked["fixedTimeStep"], asked["numSolverIterations"]) == (step, sweeps)
            assert [asked[f"gravityAcceleration{axis}"] for axis in "XYZ"] == list(gravity)
            world.set_physics(0.004, (0.0, 2.0, 0.0), 9)
            world.reset_simulation()


def test_joints_that_mimic_begin_where_their_leaders_do(make):
    """Over two others, in an order in which leaders come last; one that is given stays."""
    def follows(leader, multiplier, offset):
        return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'

    text = make.robot(
        '<link name="world"/>', *map(make.link, "abcd"),
        make.joint("last", "world", "a", extra=follows("middle", 2, 0.1)),
        make.joint("middle", "world", "b", extra=follows("first", -0.5, 0.2)),
        make.joint("other", "world", "c", extra=follows("first", 3, 0.0)),
        make.joint("first", "world", "d"))
    with World() as world:
        for name, given, expected in (
            ("none", {}, (0.5, 0.2, 0.0, 0.0)), ("one", {"first": 0.6}, (-0.1, -0.1, 1.8, 0.6)),
            ("two", {"first": 0.6, "middle": 1.0}, (2.1, 1.0, 1.8, 0.6)),
        ):
            model = world.spawn(parse_urdf(text), name, joint_positions=given)
            assert model.read_joints()[0] == pytest.approx(expected)


def test_unknown_names_carry_what_there_is(make):
    """For programs that want more than the line."""
    with World() as world:
        model = world.spawn(parse_urdf(make.pendulum()), "swing")
        numbers = list_links_by_label(world.models)
        with pytest.raises(UnknownJointError) as joint:
            model.apply_effort("elbow", 1.0)
        with pytest.raises(UnknownLinkError) as link:
            model.link_pose("hand")
        with pytest.raises(UnknownModelError) as other:
            world.model("arm")
    assert (joint.value.model, joint.value.joint, joint.value.available) == (
        "swing", "elbow", ("swing",))
    assert (link.value.link, link.value.available) == ("hand", ("world", "bob"))
    # as Bullet numbers pixels: the body, and above it the link, 0 for the root
    assert numbers == {model.body_id: "swing::world", model.body_id + (1 << 24): "swing::bob"}
    assert (other.value.name, other.value.available) == ("arm", ("swing",))
    assert str(joint.value) == "model 'swing' has no moving joint 'elbow'; its moving joints: swing"
