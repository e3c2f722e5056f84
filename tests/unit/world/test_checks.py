"""Models that cannot be simulated are refused by name, and the world does not change."""

import math
from dataclasses import replace
from types import MappingProxyType

import pytest

from aras_sim_bridge.description import Geometry, Visual, parse_urdf
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world import Pose
from aras_sim_bridge.world.model_checks import check_simulable


def chain(make, links, kind="fixed"):
    return parse_urdf(make.robot(
        *(make.link(f"l{k}") for k in range(links)),
        *(make.joint(f"j{k}", f"l{k - 1}", f"l{k}", kind, xyz="0.1 0 0")
          for k in range(1, links))))


def box(make, **changes):
    description = parse_urdf(make.robot(make.link("box", shapes=make.box("1 1 1"))))
    link = replace(description.links["box"], **changes)
    return replace(description, links=MappingProxyType({"box": link}))


@pytest.mark.parametrize(("kind", "fixed_base"), [("fixed", False), ("revolute", True)])
def test_the_longest_chain_that_bullet_takes_is_simulated(world, make, kind, fixed_base):
    with pytest.raises(WorldError, match="model 'm' has 129 links.*128"):
        world.spawn(chain(make, 129), "m")
    model = world.spawn(chain(make, 128, kind), "m", Pose((0, 0, 3)), fixed_base=fixed_base)
    world.step()
    assert model.link_pose("l127").xyz[0] == pytest.approx(12.7, abs=1e-3)


# Just beyond a bound where there is one.
BAD = [
    ({"mass": 1e10}, r"a mass of 1e\+10 kg"), ({"mass": math.nan}, "a mass of nan kg"),
    ({"mass": 0.9e-9}, "mass"), ({"mass": 1.1e9, "inertia": (1e9, 0, 0, 1e9, 0, 1e9)}, "mass"),
    ({"origin_xyz": (0.8e9, 0.0, -0.8e9)}, "the offset of the centre of mass"),
    ({"inertia": (1, 0, 0, 1, 0, math.nan)}, "finite"),
    ({"inertia": (1.0, 0, 0, 1.0, 0, -1.1e-9)}, "positive"),
    ({"inertia": (1, 2, 0, 1, 0, 1)}, "positive"), ({"inertia": (0.0,) * 6}, "positive"),
    ({"inertia": (1.1e18, 0, 0, 1.1e18, 0, 1.1e18)}, "gyration"),
    ({"inertia": (0.9e-18, 0, 0, 0.9e-18, 0, 0.9e-18)}, "gyration"),
    (("collisions", "box", {"size": (1, 1, 1e300)}), r"box size of a collision is 1e\+300 m"),
    (("collisions", "box", {"size": (1e-10, 1, 1)}), "1e-10 m, must be at least"),
    (("visuals", "sphere", {"radius": 1e30}), r"the sphere size of a visual is 1e\+30 m"),
    (("visuals", "cylinder", {"radius": 1.0, "length": math.inf}), "cylinder size .* is inf m"),
    (("visuals", "cylinder", {"radius": 0.9e-9, "length": 1.0}), "cylinder"),
    (("visuals", "capsule", {"radius": 1.0, "length": 1.1e9}), "capsule"),
    (("collisions", "mesh", {"scale": (1.0, 1.0, -0.9e-9)}), "mesh")]


def changed(make, change):
    if isinstance(change, dict):
        return box(make, inertial=replace(box(make).links["box"].inertial, **change))
    kind, shape, sizes = change
    (part,) = getattr(box(make).links["box"], kind)
    return box(make, **{kind: (replace(part, geometry=Geometry(shape, **sizes)),)})


@pytest.mark.parametrize(("change", "message"), BAD)
def test_what_no_body_has_is_refused_by_name(world, make, change, message):
    with pytest.raises(WorldError, match=f"model 'm', link 'box'.*{message}"):
        world.spawn(changed(make, change), "m")
    assert not world.models


def test_refused_changes_quaternions_and_static_models(world, make):
    model = world.spawn(box(make), "m")
    with pytest.raises(WorldError, match="a mass of nan kg"):
        world.change_model("m", changed(make, {"mass": math.nan}))
    make.step(world, 10)
    assert model.pose().xyz[2] == pytest.approx(-9.8e-6 * 55)
    for name, quat, made in (("one", (0.0, 0.0, 3.0, 4.0), (0, 0, 0.6, 0.8)),
                             ("none", (0.0,) * 4, (0, 0, 0, 1))):
        model = world.spawn(box(make), name, Pose((0, 0, 0), quat))
        assert model.pose().quat == pytest.approx(made)
    world.spawn(replace(changed(make, {"mass": 1e-20}), static=True), "static")
    world.step()


@pytest.mark.parametrize(("at", "message"), [
    (Pose((0.0, 1e300, 0.0)), r"position .* is beyond 1e\+09 m"),
    (Pose((0.0, -1.1e9, 0.0)), r"position .* is beyond 1e\+09 m"),
    (Pose((0, 0, 0), (1e300, 0, 0, 1e300)), "orientation .* is not a unit quaternion"),
    (Pose((0, 0, 0), (1e-9, 0, 0, 0)), "orientation .* is not a unit quaternion"),
    (Pose((0, 0, 0), (1e7, 0, 0, 0)), "orientation .* is not a unit quaternion")])
def test_a_place_beyond_all_sense_is_refused(world, make, at, message):
    with pytest.raises(WorldError, match=f"model 'm': {message}"):
        world.spawn(box(make), "m", at)
    assert not world.models


def test_distant_parts_are_refused(world, make):
    xml = make.robot(make.link("a"), make.link("b"), make.joint("j", "a", "b", xyz="0 -3e9 0"))
    far = Visual("v", (0, 1.1e9, 0), (0, 0, 0), Geometry("sphere", radius=1.0))
    for build, message in (
        (parse_urdf(xml), r"joint 'j': <origin> is 3e\+09 m from the parent link"),
        (box(make, visuals=(far,)), "model 'm', link 'box'.*visual"),
    ):
        with pytest.raises(WorldError, match=message):
            world.spawn(build, "m")


def test_a_joint_that_moves_no_mass_is_fixed_unless_there_is_some_below_it(world, make, caplog):
    links = ('<link name="world"/>', '<link name="a"/>', '<link name="c"/>')
    joints = (make.joint("first", "world", "a"), make.joint("third", "a", "c"))
    model = world.spawn(parse_urdf(make.robot(*links, *joints)), "m")
    assert model.joint_names == () and model.link_names == ("world", "a", "c")
    assert "joint 'first' does not move, because it moves no mass; add an <inertial> to link 'a'" \
        in caplog.text
    model = world.spawn(parse_urdf(make.robot(*links, make.link("b"), *joints, make.joint(
        "second", "a", "b", axis="1 0 0"))), "n")
    assert model.joint_names == ("first", "second")


def test_a_joint_that_mimics_one_without_mass_moves_freely(world, make, caplog):
    follower = make.joint("second", "world", "b").replace(
        "</joint>", '<mimic joint="first"/></joint>')
    model = world.spawn(parse_urdf(make.robot(
        '<link name="world"/>', '<link name="a"/>', make.link("b"),
        make.joint("first", "world", "a"), follower)), "m")
    assert model.joint_names == ("second",)
    assert "joint 'second' moves freely, because joint 'first', which it mimics" in caplog.text
    model.set_joint_positions({"second": 0.5})


@pytest.mark.parametrize("change", [
    {"mass": 1e9, "inertia": (1e9, 0, 0, 1e9, 0, 1e9)},
    {"mass": 1e-9, "inertia": (1e-9, 0, 0, 1e-9, 0, 1e-9)},
    {"inertia": (1.0, 0, 0, 1.0, 0, -0.9e-9)}, {"inertia": (1e18, 0, 0, 1e18, 0, 1e18)},
    {"inertia": (1.0, 0, 0, 0.0, 0, 0.0)}, {"origin_xyz": (0.0, 0.0, -1e9)},
    ("collisions", "box", {"size": (1e9, 1e-9, 1.0)}),
    ("visuals", "mesh", {"scale": (-1e9, 1e-9, 1.0)}),
    ("visuals", "capsule", {"radius": 0.5, "length": 0.0}),
    ("collisions", "plane", {"size": (1.0, 1.0, 0.0)})])
def test_what_is_just_within_the_bounds_is_simulated(make, change):
    check_simulable(changed(make, change), "m")
