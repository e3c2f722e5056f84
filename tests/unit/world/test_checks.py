"""Models that cannot be simulated are refused by name, and the world does not change."""

import math
from dataclasses import replace
from types import MappingProxyType

import pytest

from aras_sim_bridge.description import Geometry, Visual, parse_urdf
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world import Pose, World
from aras_sim_bridge.world.model_checks import check_simulable


@pytest.fixture
def world():
    """A world with a box that falls."""
    with World() as it:
        yield it


def chain(make, links, kind="fixed"):
    """Return a chain of `links` links."""
    return parse_urdf(make.robot(
        *(make.link(f"l{k}") for k in range(links)),
        *(make.joint(f"j{k}", f"l{k - 1}", f"l{k}", kind, xyz="0.1 0 0")
          for k in range(1, links))))


def box(make, **changes):
    """A box; changes of its link."""
    description = parse_urdf(make.robot(make.link("box", shapes=make.box("1 1 1"))))
    link = replace(description.links["box"], **changes)
    return replace(description, links=MappingProxyType({"box": link}))


def shaped(make, kind, geometry):
    """A box whose visual or collision is another shape."""
    link = box(make).links["box"]
    (part,) = getattr(link, kind)
    return box(make, **{kind: (replace(part, geometry=geometry),)})


def weighed(make, **changes):
    """A box with another inertial."""
    return box(make, inertial=replace(box(make).links["box"].inertial, **changes))


@pytest.mark.parametrize(("kind", "fixed_base"), [("fixed", False), ("revolute", True)])
def test_the_longest_chain_that_bullet_takes_is_simulated(world, make, kind, fixed_base):
    model = world.spawn(chain(make, 128, kind), "m", Pose((0, 0, 3)), fixed_base=fixed_base)
    world.step()
    assert model.link_pose("l127").xyz[0] == pytest.approx(12.7, abs=1e-3)


@pytest.mark.parametrize("links", [129, 5000])
def test_a_longer_one_is_refused(world, make, links):
    with pytest.raises(WorldError, match=rf"model 'm' has {links} links.*128"):
        world.spawn(chain(make, links), "m")
    assert not world.models


BAD = {
    "a heavy link": (lambda make: weighed(make, mass=1e10), r"a mass of 1e\+10 kg"),
    "no mass": (lambda make: weighed(make, mass=math.nan), "a mass of nan kg"),
    "a far centre": (lambda make: weighed(make, origin_xyz=(0.0, 2e9, 0.0)), "the offset of the "
                                                                             "centre of mass"),
    "a tensor of NaN": (lambda make: weighed(make, inertia=(1, 0, 0, 1, 0, math.nan)), "finite"),
    "a negative tensor": (lambda make: weighed(make, inertia=(1, 0, 0, 1, 0, -0.1)), "positive"),
    "a negative one askew": (lambda make: weighed(make, inertia=(1, 2, 0, 1, 0, 1)), "positive"),
    "a zero tensor": (lambda make: weighed(make, inertia=(0.0,) * 6), "positive"),
    "a huge tensor": (lambda make: weighed(make, inertia=(1e20, 0, 0, 1e20, 0, 1e20)), "gyration"),
    "a huge box": (lambda make: shaped(make, "collisions", Geometry("box", size=(1, 1, 1e300))),
                   r"the box size of a collision is 1e\+300 m"),
    "a tiny box": (lambda make: shaped(make, "collisions", Geometry("box", size=(1e-10, 1, 1))),
                   "1e-10 m, must be at least"),
    "a huge sphere": (lambda make: shaped(make, "visuals", Geometry("sphere", radius=1e30)),
                      r"the sphere size of a visual is 1e\+30 m"),
    "a long cylinder": (
        lambda make: shaped(make, "visuals", Geometry("cylinder", radius=1.0, length=math.inf)),
        "the cylinder size of a visual is inf m"),
    "a scaled mesh": (
        lambda make: shaped(make, "visuals", Geometry("mesh", scale=(1.0, -1e10, 1.0))), "mesh"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_no_body_has_is_refused_by_name(world, make, name):
    build, message = BAD[name]
    with pytest.raises(WorldError, match=f"model 'm', link 'box'.*{message}"):
        world.spawn(build(make), "m")
    assert not world.models
    world.spawn(box(make), "m")
    with pytest.raises(WorldError, match=message):
        world.change_model("m", build(make))
    for _ in range(10):
        world.step()
    assert world.model("m").pose().xyz[2] == pytest.approx(-9.8e-6 * 55)


def test_a_joint_a_world_away_is_refused(world, make):
    xml = make.robot(make.link("a"), make.link("b"), make.joint("j", "a", "b", xyz="0 -3e9 0"))
    with pytest.raises(WorldError, match=r"joint 'j': <origin> is 3e\+09 m from the parent link"):
        world.spawn(parse_urdf(xml), "m")


@pytest.mark.parametrize("far", [1e300, -1.1e9])
def test_a_place_beyond_all_sense_is_refused(world, make, far):
    with pytest.raises(WorldError, match="model 'm': position .* is beyond 1e\\+09 m"):
        world.spawn(parse_urdf(make.robot(make.link("a"))), "m", Pose((0.0, far, 0.0)))
    assert "m" not in world.models


@pytest.mark.parametrize("quat", [(1e300, 0, 0, 1e300), (1e-9, 0, 0, 0), (1e7, 0, 0, 0)])
def test_an_orientation_that_is_none_is_refused(world, make, quat):
    with pytest.raises(WorldError, match="model 'm': orientation .* is not a unit quaternion"):
        world.spawn(box(make), "m", Pose((0, 0, 0), quat))
    assert not world.models


def test_an_orientation_of_another_length_is_made_a_unit_one(world, make):
    model = world.spawn(box(make), "m", Pose((0, 0, 0), (0.0, 0.0, 3.0, 4.0)))
    assert model.pose().quat == pytest.approx((0, 0, 0.6, 0.8))
    none = world.spawn(box(make), "none", Pose((0, 0, 0), (0.0, 0.0, 0.0, 0.0)))
    assert none.pose().quat == (0, 0, 0, 1)


def test_a_joint_that_moves_no_mass_is_refused_unless_there_is_some_below_it(world, make):
    links = ('<link name="world"/>', '<link name="a"/>')
    first = make.joint("first", "world", "a")
    with pytest.raises(WorldError, match="joint 'first' moves link 'a', which has no mass"):
        world.spawn(parse_urdf(make.robot(*links, first)), "m")
    world.spawn(parse_urdf(make.robot(*links, make.link("b"), first,
                                      make.joint("second", "a", "b", axis="1 0 0"))), "m")


def test_a_static_model_needs_no_dynamics(world, make):
    far = replace(weighed(make, mass=1e-20), static=True)
    world.spawn(far, "m")
    world.step()


@pytest.mark.parametrize("build", [
    lambda make: weighed(make, mass=1e9, inertia=(1e9, 0, 0, 1e9, 0, 1e9)),
    lambda make: weighed(make, mass=1e-9, inertia=(1e-9, 0, 0, 1e-9, 0, 1e-9)),
    lambda make: weighed(make, inertia=(1.0, 0, 0, 1.0, 0, -0.9e-9)),
    lambda make: weighed(make, inertia=(1e18, 0, 0, 1e18, 0, 1e18)),
    lambda make: weighed(make, inertia=(1.0, 0, 0, 0.0, 0, 0.0)),
    lambda make: weighed(make, origin_xyz=(0.0, 0.0, -1e9)),
    lambda make: shaped(make, "collisions", Geometry("box", size=(1e9, 1e-9, 1.0))),
    lambda make: shaped(make, "visuals", Geometry("mesh", scale=(-1e9, 1e-9, 1.0))),
    lambda make: shaped(make, "visuals", Geometry("capsule", radius=0.5, length=0.0)),
    lambda make: shaped(make, "collisions", Geometry("plane", size=(1.0, 1.0, 0.0))),
])
def test_what_is_just_within_the_bounds_is_simulated(make, build):
    check_simulable(build(make), "m")


@pytest.mark.parametrize("build", [
    lambda make: weighed(make, inertia=(1.0, 0, 0, 1.0, 0, -1.1e-9)),
    lambda make: weighed(make, inertia=(1.1e18, 0, 0, 1.1e18, 0, 1.1e18)),
    lambda make: weighed(make, mass=0.9e-9),
    lambda make: weighed(make, mass=1.1e9, inertia=(1e9, 0, 0, 1e9, 0, 1e9)),
    lambda make: weighed(make, inertia=(0.9e-18, 0, 0, 0.9e-18, 0, 0.9e-18)),
    lambda make: weighed(make, origin_xyz=(0.8e9, 0.0, -0.8e9)),
    lambda make: shaped(make, "visuals", Geometry("cylinder", radius=0.9e-9, length=1.0)),
    lambda make: shaped(make, "visuals", Geometry("capsule", radius=1.0, length=1.1e9)),
    lambda make: shaped(make, "collisions", Geometry("mesh", scale=(1.0, 1.0, -0.9e-9))),
    lambda make: replace(chain(make, 2), links={**chain(make, 2).links, "l1": replace(
        chain(make, 2).links["l1"], visuals=(Visual("v", (0, 1.1e9, 0), (0, 0, 0),
                                                    Geometry("sphere", radius=1.0)),))}),
])
def test_what_is_just_beyond_the_bounds_is_not(make, build):
    with pytest.raises(WorldError, match="model 'm', link"):
        check_simulable(build(make), "m")
