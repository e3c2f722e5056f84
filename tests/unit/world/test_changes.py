"""Masses, damping and stops changed at run time, without a jump of the state."""

import math
from dataclasses import replace

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.world import Pose, Twist, World
from aras_sim_bridge.world.description_changes import change_joint, change_link

G = 9.8


def test_another_mass_and_centre_change_the_load_and_nothing_else(make):
    with World() as world:
        bob = world.spawn(parse_urdf(make.pendulum()), "m", joint_positions={"swing": 0.5})
        for _ in range(50):
            world.step()
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


def test_a_flying_body_flies_on(make):
    """From where it has come to, not from where it was spawned."""
    with World() as world:
        body = world.spawn(parse_urdf(make.robot(make.link("a"))), "m", Pose((7, 8, 9)))
        flown = Pose.from_rpy((1, 2, 30), (0.1, 0.2, 0.3))
        body.set_pose(flown)
        body.set_twist(Twist((1, 0, 0), (0, 0, 2)))
        world.change_model("m", change_link(body.description, "a", 3.0, (0.1, 0, 0),
                                    (0.1, 0, 0, 0.1, 0, 0.1), False))
        assert body.pose().xyz == pytest.approx(flown.xyz)
        assert body.pose().quat == pytest.approx(flown.quat)
        assert body.twist().linear == pytest.approx((1, 0, 0))
        assert body.twist().angular == pytest.approx((0, 0, 2))
        for _ in range(100):
            world.step()
        assert body.pose().xyz[2] == pytest.approx(30, abs=1e-9)  # gravity is off


def test_damping_friction_and_stops(make):
    with World() as world:
        rotor = world.spawn(parse_urdf(make.rotor()), "m")
        world.change_model("m", change_joint(rotor.description, "spin", damping=2.0, friction=0.3))
        for _ in range(1000):
            rotor.apply_effort("spin", 1.0)
            world.step()
        assert rotor.read_joints()[1][0] == pytest.approx((1.0 - 0.3) / 2.0, rel=1e-5)
        rotor.set_position("spin", 0.0)
        world.change_model("m", change_joint(rotor.description, "spin", lower=-0.1, upper=0.2))
        for _ in range(1500):
            rotor.apply_effort("spin", 1.0)
            world.step()
        assert rotor.read_joints()[0][0] == pytest.approx(0.2, abs=1e-3)


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
    (lambda d: change_joint(d, "swing", upper=1.0), "no stops yet; give both"),
])
def test_impossible_changes_are_refused(make, change, reason):
    with pytest.raises(SimError, match=reason):
        change(parse_urdf(make.pendulum()))


def test_a_changed_description_is_the_same_but_for_what_was_asked(make):
    arm = make.robot(
        '<link name="world"/>', make.link("a", 1.0, "0 0 0.1"), make.link("b", 2.0),
        make.joint("turn", "world", "a", lower=-1.0, upper=2.0, damping=0.5, friction=0.25),
        make.joint("spin", "a", "b", "continuous", effort=7.0),
        make.joint("bare", "b", "c", "continuous").replace(
            '<limit lower="-10.0" upper="10.0" effort="1000.0" velocity="100"/>', ""),
        make.link("c", 3.0))
    before = parse_urdf(arm)
    for joint, given, kind, stops in (
        ("turn", {"damping": 3}, "revolute", (-1.0, 2.0)),
        ("turn", {"friction": 0}, "revolute", (-1.0, 2.0)),
        ("turn", {"lower": -0.5}, "revolute", (-0.5, 2.0)),
        ("turn", {"upper": -1}, "revolute", (-1.0, -1.0)),
        ("spin", {"lower": -0.5, "upper": 0.25}, "revolute", (-0.5, 0.25)),
        ("bare", {"lower": 0.0, "upper": 0.0, "damping": 0.0}, "revolute", (0.0, 0.0)),
        ("spin", {"damping": 0.5}, "continuous", (-math.inf, math.inf)),
    ):
        after, old = change_joint(before, joint, **given), before.joints[joint]
        new = after.joints[joint]
        assert (new.kind, new.stops) == (kind, stops)
        for name in ("damping", "friction"):
            assert getattr(new, name) == given.get(name, getattr(old, name))
        if old.limits is not None:
            assert (new.limits.effort, new.limits.velocity) == (
                old.limits.effort, old.limits.velocity)
        elif "lower" in given:
            assert (new.limits.effort, new.limits.velocity) == (math.inf, math.inf)
        assert replace(new, kind=old.kind, limits=old.limits, damping=old.damping,
                       friction=old.friction) == old
        assert list(after.joints) == list(before.joints)
        assert replace(after, joints=before.joints) == before
        assert all(after.joints[n] is before.joints[n] for n in before.joints if n != joint)
    after = change_link(before, "b", 4, (1, 2, 3), (6, 0.1, 0.2, 5, 0.3, 4), False)
    new = after.links["b"]
    assert (new.inertial.mass, new.inertial.origin_xyz) == (4.0, (1.0, 2.0, 3.0))
    assert new.inertial.origin_rpy == (0.0, 0.0, 0.0)
    assert (new.inertial.inertia, new.gravity) == ((6.0, 0.1, 0.2, 5.0, 0.3, 4.0), False)
    assert replace(after, links=before.links) == before
    assert replace(new, inertial=before.links["b"].inertial, gravity=True) == before.links["b"]
    assert all(after.links[n] is before.links[n] for n in before.links if n != "b")
    with pytest.raises(SimError, match="joint 'nose' is not a moving joint; moving joints: turn, "
                                       "spin"):
        change_joint(before, "nose", damping=1.0)
