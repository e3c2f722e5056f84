"""SDF models whose links are not a tree: free bodies, closed chains, reversed joints."""

import math

import numpy as np
import pytest

from aras_sim_bridge.description import parse_sdf, read_sdf, world_file
from aras_sim_bridge.errors import UnknownModelError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_sim_bridge.world import World
from aras_sim_bridge.world.closed_chains import compute_position
from aras_visual_servo_base.poses import Pose, Twist

BOX = "<collision name='c'><geometry><box><size>.1 .1 .1</size></box></geometry></collision>"


def link(name, pose="0 0 0 0 0 0", inside=""):
    return f"<link name='{name}'><pose>{pose}</pose>{inside}</link>"


def joint(name, parent, child, kind="revolute", inside="<axis><xyz>0 1 0</xyz></axis>"):
    return (f"<joint name='{name}' type='{kind}'><parent>{parent}</parent><child>{child}</child>"
            f"{inside}</joint>")


def model(inside, version="1.6", name="m"):
    return parse_sdf(f"<sdf version='{version}'><model name='{name}'>{inside}</model></sdf>")


FOUR_BAR = (
    link("base") + link("left", "0 0 1 0 0 0") + link("right", "1 0 1 0 0 0")
    + link("top", "0 0 2 0 0 0") + joint("j0", "world", "base", "fixed", "")
    + joint("j1", "base", "left") + joint("j2", "base", "right") + joint("j3", "left", "top"))
CLOSING = joint("j4", "right", "top",
                inside="<pose>1 0 0 0 0 0</pose><axis><xyz>0 1 0</xyz></axis>")


def test_links_without_joints_are_free_bodies_of_one_model():
    made = model(link("a", "0 0 2 0 0 0", BOX) + link("b", "1 0 3 0 0 0.5", BOX)
                 + link("c", "1 0 4 0 0 0", BOX) + joint("j", "b", "c"))
    assert [part.root for part in made.parts] == ["b"]
    assert list(made.parts[0].joints) == ["j"] and not made.warnings
    with World(gravity=(0.0, 0.0, -1.0)) as world:
        whole = world.spawn(made, "m", Pose((0, 0, 10)), {"j": 0.25})
        assert list(world.models) == ["m", "m::b"] and list(world.main_models) == ["m"]
        part = world.models["m::b"]
        np.testing.assert_allclose(part.link_pose("b").matrix(),
                                   Pose.from_rpy((1, 0, 13), (0, 0, 0.5)).matrix(), atol=1e-9)
        assert part.read_joints()[0] == pytest.approx((0.25,))
        for _ in range(100):
            world.step()
        fallen = 0.5 * 0.1 * 0.101  # semi-implicit Euler
        assert 10 - whole.pose().xyz[2] == pytest.approx(fallen, abs=1e-9)
        assert 13 - part.pose().xyz[2] == pytest.approx(fallen, rel=0.05)
        whole.set_pose(Pose.from_rpy((5, 0, 0), (0, 0, math.pi / 2)))
        assert part.pose().xyz[:2] == pytest.approx((5, 1), abs=1e-6)
        whole.set_twist(Twist((0, 0, 0), (0, 0, 2.0)))
        assert part.twist().linear[:2] == pytest.approx((-2.0, 0.0), abs=1e-6)
        world.reset_world()
        assert part.pose().xyz == pytest.approx((1, 0, 13), abs=1e-9)
        with pytest.raises(UnknownModelError):
            world.delete("m::b")
        world.delete("m")
        assert not world.models


def test_free_bodies_of_one_model_pass_through_each_other_and_rest_on_the_ground():
    made = model(link("a", "0 0 0.05 0 0 0", BOX) + link("b", "0 0 0.3 0 0 0", BOX)
                 + link("eye", "0 0 1 0 0 0", "<sensor name='s' type='camera'><camera/></sensor>"))
    with_ground = Simulation(SimulationConfig())
    with_ground.spawn(made, "m")
    assert [(one.model.name, one.link) for one in with_ground.cameras] == [("m::eye", "eye")]
    for _ in range(800):
        with_ground.step()
    # The first link's frame is the model's, which stands on the ground.
    for name, linked, height in (("m", "a", 0.0), ("m::b", "b", 0.05)):
        assert with_ground.world.models[name].link_pose(linked).xyz[2] == pytest.approx(
            height, abs=2e-3)
    with_ground.delete("m")
    assert not with_ground.cameras
    with_ground.close()


def test_links_of_static_models_and_of_cut_loops():
    made = model("<static>1</static>" + FOUR_BAR + CLOSING + link("loose"))
    assert not made.loops and not made.parts and made.static
    assert {"base", "top", "loose"} < set(made.links)
    chosen = joint("j3", "left", "top", inside="<axis><xyz>0 1 0</xyz></axis><physics><simbody>"
                   "<must_be_loop_joint>1</must_be_loop_joint></simbody></physics>")
    made = model(FOUR_BAR.replace(joint("j3", "left", "top"), chosen) + CLOSING)
    assert [one.joint.name for one in made.loops] == ["j3"] and "j4" in made.joints


def swing(seconds, start):
    """theta'' = g sin(theta) / 3: two bars that turn, each of 1 kg m², and 1 kg that they carry."""
    theta, rate, dt = start, 0.0, 1e-5
    for _ in range(round(seconds / dt)):
        rate += dt * 9.8 * math.sin(theta) / 3.0
        theta += dt * rate
    return theta


def test_a_closed_chain_moves_as_a_pendulum_of_its_whole_mass():
    """A parallelogram from 3 rad for 2 s."""
    made = model(FOUR_BAR + CLOSING)
    (loop,) = made.loops
    assert loop.joint.name == "j4" and not made.warnings
    with World() as world:
        arm = world.spawn(made, "m", joint_positions={"j1": 3.0, "j2": 3.0, "j3": -3.0})
        for _ in range(2000):
            world.step()
        ends = [arm.link_pose(end) for end in (loop.joint.parent, loop.joint.child)]
        gap = math.dist((ends[0] @ loop.in_parent).xyz, (ends[1] @ loop.in_child).xyz)
        angles = dict(zip(arm.joint_names, arm.read_joints()[0], strict=True))
        angles["j4"] = compute_position(loop, *ends)
        world.reset_simulation()
        world.step()
    assert gap < 1e-6
    for name, sign in (("j1", -1), ("j2", -1), ("j3", 1), ("j4", 1)):
        off = math.remainder(angles[name] + sign * swing(2.0, 3.0), 2 * math.pi)
        assert off == pytest.approx(0.0, abs=5e-4)


@pytest.mark.parametrize("kind", ["prismatic", "fixed", "revolute"])
def test_what_a_joint_that_closes_a_chain_has_in_vain_is_named(kind):
    inside = ("<axis><xyz>0 1 0</xyz><limit><lower>-1</lower></limit><dynamics><damping>1</damping>"
              "<friction>2</friction><spring_stiffness>3</spring_stiffness></dynamics></axis>")
    made = model(FOUR_BAR + joint("j4", "right", "top", kind, inside))
    said = " ".join(made.warnings)
    for word in ("limits", "damping", "friction", "spring"):
        assert (word in said) is (kind != "fixed")
    with World() as world:
        world.spawn(made, "m")
        for _ in range(10):
            world.step()


def test_joints_that_form_a_ring_or_stand_upside_down_are_one_tree():
    """No link without a parent; and two roots that meet in one link."""
    ring = model(link("a") + link("b", "0 0 1 0 0 0") + joint("j", "a", "b") + joint("k", "b", "a"))
    assert (ring.root, list(ring.joints), [one.joint.name for one in ring.loops]) == (
        "a", ["j"], ["k"])
    turned = model(link("a") + link("b", "1 0 0 0.3 0 0") + link("c", "0 0 1 0 0.2 0")
                   + joint("j", "a", "c") + joint("k", "b", "c"))
    assert (turned.root, turned.parts, turned.loops) == ("a", (), ())
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        moved = world.spawn(turned, "m", joint_positions={"k": 0.4})
        a, b, c = (moved.link_pose(name) for name in "abc")
        # c has turned in b by 0.4 rad about its y axis; a carries c, so it is b that has moved.
        at_rest = Pose.from_rpy((1, 0, 0), (0.3, 0, 0)).inverse() @ Pose.from_rpy(
            (0, 0, 1), (0, 0.2, 0))
        turn = Pose.from_rpy((0, 0, 0), (0, 0.4, 0))
        np.testing.assert_allclose((b.inverse() @ c).matrix(), (at_rest @ turn).matrix(), atol=1e-6)
        np.testing.assert_allclose(a.matrix(), np.eye(4), atol=1e-9)


TURRET = (link("base") + link("turret", "0 0 1 1.5707963267948966 0 0.3")
          + joint("fix", "world", "base", "fixed", ""))
AXIS = "<pose>0 0 0 0.4 0 0</pose><axis><xyz{}>{}</xyz>{}</axis>"


@pytest.mark.parametrize(("version", "axis"), [
    ("1.4", AXIS.format("", "0 0 1", "")), ("1.3", AXIS.format("", "0 0 2", "")),
    ("1.5", AXIS.format("", "0 0 1", "<use_parent_model_frame>1</use_parent_model_frame>")),
    ("1.6", AXIS.format("", "0 0 1", "<use_parent_model_frame>yes</use_parent_model_frame>")),
    ("1.7", AXIS.format(" expressed_in='__model__'", "0 0 1", "")),
    ("1.7", AXIS.format(" expressed_in='base'", "0 0 1", "")),
    ("1.6", AXIS.format("", f"0 {math.cos(0.4)} {-math.sin(0.4)}", "")),
    ("1.4", AXIS.format("", f"0 {math.cos(0.4)} {-math.sin(0.4)}",
                        "<use_parent_model_frame>0</use_parent_model_frame>"))])
@pytest.mark.parametrize("outer", ["", "1 2 3 0.5 0 0.7"])
def test_an_axis_is_in_the_frame_that_its_version_says(version, axis, outer):
    """All of these are the model's z axis, in a model in another one too."""
    inside = TURRET + joint("yaw", "base", "turret", inside=axis)
    prefix, turn = "", Pose()
    if outer:
        inside = f"<model name='in'><pose>{outer}</pose>{inside}</model>"
        prefix, turn = "in::", Pose.from_rpy((0, 0, 0), (0.5, 0, 0.7))
    made = model(inside, version)
    with World() as world:
        arm = world.spawn(made, "m")
        before = arm.link_pose(f"{prefix}turret")
        arm.set_joint_positions({f"{prefix}yaw": 1.0})
        after = arm.link_pose(f"{prefix}turret")
    turned = np.array(after.matrix()[:3, :3] @ before.matrix()[:3, :3].T)
    expected = (turn @ Pose.from_rpy((0, 0, 0), (0, 0, 1.0)) @ turn.inverse()).matrix()[:3, :3]
    np.testing.assert_allclose(turned, expected, atol=1e-6)


BAD = {  # a model that cannot be served, and what is said of it
    "gone include": ("<include><uri>model://not_there</uri></include>", "not_there"),
    "no links": ("", "<link> is missing"),
    "ball joint": (link("a") + link("b") + joint("j", "a", "b", "ball"), "type 'ball'"),
    "pose": (link("a", "1 2"), "needs 6 numbers"),
    "quaternion": ("<link name='a'><pose rotation_format='quat_xyzw'>0 0 0 0 0 0 w</pose></link>",
                   "needs 6 numbers"),
    "huge": (link("a", "0 0 0 0 0 0", BOX.replace(".1", "1e12")), "must be at most 1e+09 m"),
    "number": (link("a", inside="<inertial><mass>heavy</mass></inertial>"), "'heavy' is not a"),
    "twins": (link("a") + link("a"), "two links are named 'a'"),
}


def test_a_world_with_bad_models_starts_with_the_others(read):
    good = [f"<model name='m{k}'><pose>{k} 0 1 0 0 0</pose>{link('a', inside=BOX)}</model>"
            for k in range(2)]
    wrong = [f"<model name='{key}'>{inside}</model>" for key, (inside, _) in BAD.items()]
    found = read(good[0], *wrong, "<light name='lamp' type='candle'/>", good[1])
    simulation = Simulation(SimulationConfig(ground_plane=False))
    said = list(found.warnings)
    world_file.populate(simulation.spawn, found, said.append)
    assert list(simulation.world.models) == ["m0", "m1"]
    reasons = {key: reason for key, (_, reason) in BAD.items()} | {"lamp": "'candle' is unknown"}
    for key, reason in reasons.items():
        (line,) = (text for text in said if f"'{key}' is ignored" in text)
        assert reason in (line if key != "gone include" else "".join(said))
    simulation.close()


@pytest.mark.parametrize(("text", "sentence"), [
    ("<static>yes</static>", "model 'm': static is 'yes', which is read as true; write true or "
                             "false"),
    ("<static>maybe</static>", "static 'maybe' is ignored, because it is neither true nor false"),
    ("<pose>1 2 3</pose>", "pose '1 2 3' has three numbers, which are read as a position")])
def test_what_gazebo_s_parser_forgives_is_repaired_and_named(text, sentence):
    made = model(text + link("a"))
    assert any(sentence in warning for warning in made.warnings) and len(made.warnings) == 1
    assert made.static is ("yes" in text)
    assert made.initial_pose[0] == ((1, 2, 3) if "pose" in text else (0, 0, 0))


def test_poses_in_other_units_and_in_states():
    made = model("<pose degrees='true'>1 2 3 0 0 90</pose>" + link("a", "0 0 0 0 0 0")
                 + "<link name='b'><pose rotation_format='quat_xyzw'>1 0 0 0 0 2 2</pose></link>")
    assert made.initial_pose[1] == pytest.approx((0, 0, math.pi / 2))
    assert made.parts[0].initial_pose[1] == pytest.approx((0, 0, math.pi / 2))
    content = read_sdf(
        "<sdf version='1.6'><world name='w'><model name='m'>"
        + link("a") + link("b", "1 0 0 0 0 0")
        + "</model><state><model name='m'><pose>0 0 5 0 0 0</pose>"
        + link("a", "0 0 5 0 0 0") + link("b", "3 0 1 0 0 0") + "</model></state></world></sdf>")
    (made,) = content.models
    assert made.initial_pose[0] == (0, 0, 5) and not content.warnings
    assert made.parts[0].initial_pose[0] == pytest.approx((3, 0, -4))


def test_a_free_model_with_a_closed_chain_stands_by_bullet_s_steps():
    """A base that is held stands by the dynamics of its tree alone, which know of no chain."""
    foot = ("<inertial><mass>50</mass></inertial><collision name='c'><pose>0.5 0 0.1 0 0 0</pose>"
            "<geometry><box><size>2 1 .2</size></box></geometry></collision>")
    made = model(FOUR_BAR.replace(joint("j0", "world", "base", "fixed", ""), "").replace(
        link("base"), link("base", "0 0 0 0 0 0", foot)) + CLOSING)
    simulation = Simulation(SimulationConfig())
    arm = simulation.spawn(made, "m", joint_positions={"j1": 0.3, "j2": 0.3, "j3": -0.3})
    for _ in range(300):
        simulation.step()
    (loop,) = made.loops
    ends = [arm.link_pose(end) @ at for end, at in (
        (loop.joint.parent, loop.in_parent), (loop.joint.child, loop.in_child))]
    assert not arm.fixed_base and arm.pose().xyz[2] == pytest.approx(0.0, abs=2e-3)
    assert math.dist(ends[0].xyz, ends[1].xyz) < 1e-5
    assert arm.read_joints()[0][0] == pytest.approx(swing(0.3, 0.3), abs=2e-3)
    simulation.close()
