"""Masses, damping and stops changed at run time, without a jump of the state."""

import math
from dataclasses import replace

import pytest

from aras_sim_bridge.description import JointLimits, parse_urdf
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.world.description_changes import change_joint, change_link

G = 9.8


def test_another_mass_and_centre_change_the_load_and_nothing_else(world, make):
    bob = world.spawn(parse_urdf(make.pendulum()), "m", joint_positions={"swing": 0.5})
    make.step(world, 50)
    before = [list(v) for v in bob.read_joints()[:2]]
    world.change_model("m", change_link(bob.description, "bob", 2.0, (0.0, 0.0, -0.25),
                                (0.02, 0, 0, 0.02, 0, 0.02), True))
    assert [list(v) for v in bob.read_joints()[:2]] == before
    assert bob.description.links["bob"].inertial.mass == 2.0
    load = 2.0 * G * 0.25 * math.sin(before[0][0])
    assert bob.bias_efforts() == pytest.approx([load])
    world.step()
    inertia = 0.02 + 2.0 * 0.25**2
    assert bob.read_joints()[1][0] == pytest.approx(before[1][0] - load / inertia * 1e-3)
    world.reset_simulation()
    assert bob.bias_efforts() == pytest.approx([2.0 * G * 0.25 * math.sin(0.5)])


@pytest.mark.parametrize(("change", "reason"), [
    (lambda d: change_link(d, "nose", 1.0, (0, 0, 0), (1, 0, 0, 1, 0, 1), True), "'nose'"),
    (lambda d: change_link(d, "bob", 0.0, (0, 0, 0), (1, 0, 0, 1, 0, 1), True), "positive"),
    (lambda d: change_link(d, "bob", math.nan, (0, 0, 0), (1, 0, 0, 1, 0, 1), True), "not finite"),
    (lambda d: change_link(d, "bob", 1.0, (0, 0, math.inf), (1, 0, 0, 1, 0, 1), True), "com"),
    (lambda d: change_link(d, "bob", 1.0, (0, 0, 0), (1, 0, 0, -1, 0, 1), True), "negative"),
    (lambda d: change_joint(d, "nose", damping=1.0), "'nose'"),
    (lambda d: change_joint(d, "swing", damping=-1.0), "damping -1.0 must not be negative"),
    (lambda d: change_joint(d, "swing", friction=math.nan), "not finite"),
    (lambda d: change_joint(d, "swing", lower=1.0, upper=-1.0), "above the upper"),
    (lambda d: change_joint(d, "swing", lower=1.0), "no stops yet; give both"),
    (lambda d: change_joint(d, "swing", upper=1.0), "no stops yet; give both")])
def test_impossible_changes_are_refused(make, change, reason):
    with pytest.raises(SimError, match=reason):
        change(parse_urdf(make.pendulum()))


def test_a_changed_description_is_the_same_but_for_what_was_asked(make):
    before = parse_urdf(make.robot(
        '<link name="world"/>', make.link("a", 1.0, "0 0 0.1"), make.link("b", 2.0),
        make.joint("turn", "world", "a", lower=-1.0, upper=2.0, damping=0.5, friction=0.25),
        make.joint("spin", "a", "b", "continuous", effort=7.0),
        make.joint("bare", "b", "c", "continuous").replace(
            '<limit lower="-10.0" upper="10.0" effort="1000.0" velocity="100"/>', ""),
        make.link("c", 3.0)))
    for joint, given, kind, limits in (
        ("turn", {"damping": 3}, "revolute", (-1.0, 2.0, 1000.0, 100.0)),
        ("turn", {"friction": 0}, "revolute", (-1.0, 2.0, 1000.0, 100.0)),
        ("turn", {"lower": -0.5}, "revolute", (-0.5, 2.0, 1000.0, 100.0)),
        ("turn", {"upper": -1}, "revolute", (-1.0, -1.0, 1000.0, 100.0)),
        ("spin", {"lower": -0.5, "upper": 0.25}, "revolute", (-0.5, 0.25, 7.0, 100.0)),
        ("bare", {"lower": 0.0, "upper": 0.0, "damping": 0.0}, "revolute",
         (0.0, 0.0, math.inf, math.inf)),
        ("spin", {"damping": 0.5}, "continuous", None)):
        after, old = change_joint(before, joint, **given), before.joints[joint]
        expected = replace(old, kind=kind, limits=JointLimits(*limits) if limits else old.limits,
                           **{key: value for key, value in given.items() if key in (
                               "damping", "friction")})
        assert after == replace(before, joints={**before.joints, joint: expected})
        assert list(after.joints) == list(before.joints)
    after = change_link(before, "b", 4, (1, 2, 3), (6, 0.1, 0.2, 5, 0.3, 4), False)
    new = after.links["b"]
    assert (new.inertial.mass, new.inertial.origin_xyz) == (4.0, (1.0, 2.0, 3.0))
    assert new.inertial.origin_rpy == (0.0, 0.0, 0.0)
    assert (new.inertial.inertia, new.gravity) == ((6.0, 0.1, 0.2, 5.0, 0.3, 4.0), False)
    assert replace(new, inertial=before.links["b"].inertial, gravity=True) == before.links["b"]
    assert replace(after, links={**after.links, "b": before.links["b"]}) == before
    with pytest.raises(SimError, match="joint 'nose' is not a moving joint; moving joints: turn, "
                                       "spin"):
        change_joint(before, "nose", damping=1.0)
