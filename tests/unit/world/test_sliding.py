"""Friction coefficients of loose bodies per contact, compared with matrix equations."""

import numpy as np
import pybullet
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World, sliding
from aras_sim_bridge.world.sliding import SlidingFriction

DT = 0.001
AT, OTHER = (0.3, -0.2, 1.0), (1.0, 2.0, 3.0)
SPEED, SPIN = (0.8, -0.5, 0.3), (0.7, 2.0, -1.5)


@pytest.fixture
def world():
    with World(gravity=(0.0, 0.0, 0.0)) as it:
        yield it


def contact(rng, other, link, size=1.0):
    """As contacts_of tells one: a point, the normal's force and two of friction, the depth."""
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    one = np.cross(normal, rng.normal(size=3))
    one /= np.linalg.norm(one)
    two = np.cross(normal, one)
    first, second = size * rng.uniform(0.5, 2.0, 2) * (1.0, -1.0)
    point = np.array(AT) + rng.normal(size=3) * 0.3
    return 0, other, link, (*point, 7.0, *normal, first, *one, second, *two, 0.25)


def spawned(world, make):
    """A loose body that moves; a loose one, one with a joint and a bolted one that it touches."""
    body = world.spawn(parse_urdf(make.robot(make.link("a", 2.0, "0.1 0.05 -0.02"))), "a",
                       Pose.from_rpy(AT, (0.3, 0.2, 0.1)))
    loose = world.spawn(parse_urdf(make.robot(make.link("b", 1.0, "0 0.1 0"))), "b", Pose(OTHER))
    loose.set_twist(Twist((0.1, 0.2, -0.4), (1.0, -0.5, 0.25)))
    jointed = world.spawn(parse_urdf(make.robot(
        make.link("hull", 3.0), make.link("arm", 1.0, "0.2 0 0"),
        make.joint("turn", "hull", "arm", "continuous", "0 0 0.5", "0 0.6 0.8"))), "c",
        Pose((5.0, 0.0, 0.0)))
    jointed.joints.restore([(0.4, 3.0)])
    bolted = world.spawn(parse_urdf(make.robot('<link name="world"/>', make.link("car", 1.0),
                                               make.joint("rail", "world", "car", "prismatic"))),
                         "d", Pose((0.0, 5.0, 0.0)), {"rail": 0.2})
    bolted.joints.set_own_dynamics(False)
    bolted.joints.restore([(0.2, 0.9)])
    return body, loose, jointed, bolted


def velocity(model, link, point):
    """Return the velocity of a point of a link, from the twist of the link's frame."""
    pose, twist = model.link_state(link)
    return np.array(twist.linear) + np.cross(twist.angular, np.subtract(point, pose.xyz))


def test_friction_of_the_same_size_acts_along_the_way_instead(make, world, monkeypatch):
    body, loose, jointed, bolted = spawned(world, make)
    body.set_twist(Twist(SPEED, SPIN))
    rng = np.random.default_rng(6)
    links = {(loose.body_id, -1): (loose, "b"), (jointed.body_id, -1): (jointed, "hull"),
             (jointed.body_id, 0): (jointed, "arm"), (bolted.body_id, -1): (bolted, "world"),
             (bolted.body_id, 0): (bolted, "car")}
    contacts = [contact(rng, *part) for part in links for _ in range(3)]
    friction = SlidingFriction(world.client)
    friction.set_models(world.models.values())
    assert friction.loose == [body, loose]
    given = []
    monkeypatch.setattr(sliding, "find_contacts", lambda of, client: contacts)
    monkeypatch.setattr(friction, "_apply_force", lambda *push: given.append(push))
    linear, angular = pybullet.getBaseVelocity(body.body_id, world.client)
    friction._correct_friction(body, linear, angular, DT, set())
    expected = []
    for _, other, link, numbers in contacts:
        point, normal = np.array(numbers[:3]), np.array(numbers[4:7])
        slip = velocity(body, "a", point) - velocity(*links[other, link], point)
        slip -= normal * (normal @ slip)
        felt = numbers[7] * np.array(numbers[8:11]) + numbers[11] * np.array(numbers[12:15])
        lack = -np.hypot(numbers[7], numbers[11]) * slip / np.linalg.norm(slip) - felt
        expected.append((body.body_id, -1, lack, point))
        if (other, link) != (bolted.body_id, -1):
            expected.append((other, link, -lack, point))
    assert [one[:2] for one in given] == [one[:2] for one in expected]
    for one, other in zip(given, expected, strict=True):
        np.testing.assert_allclose(one[2:], other[2:], atol=1e-12)
    # Not with those that have been seen to; nor where friction could stop the body in four steps.
    for done, size, count in (({loose.body_id}, 1.0, 21), (set(), 300.0, 0), (set(), 0.0, 0)):
        contacts = [contact(rng, *part, size) for part in links for _ in range(3)]
        given.clear()
        friction._correct_friction(body, linear, angular, DT, done)
        assert len(given) == count
    contacts = [contact(rng, bolted.body_id, -1)]
    slip = np.linalg.norm(np.cross(contacts[0][3][4:7], velocity(body, "a", contacts[0][3][:3])))
    one = contacts[0][3]
    most = 2.0 * slip / (4 * DT)  # N: friction that holds the body up in four steps
    for share, corrected in ((0.99, True), (1.01, False)):
        by = share * most / np.hypot(one[7], one[11])
        contacts = [(0, bolted.body_id, -1,
                     (*one[:7], by * one[7], *one[8:11], by * one[11], *one[12:]))]
        given.clear()
        friction._correct_friction(body, linear, angular, DT, set())
        assert bool(given) is corrected


def test_what_moves_slowly_is_left_alone_and_looked_at_now_and_then(make, world, monkeypatch):
    body = world.spawn(parse_urdf(make.robot(make.link("a", 2.0))), "a")
    friction, corrected, watched = SlidingFriction(world.client), [], []
    friction.set_models([body])
    monkeypatch.setattr(friction, "_correct_friction", lambda model, *_: corrected.append(model))
    monkeypatch.setattr(friction._impacts, "place_at_impact", lambda body, *_: watched.append(body))

    def looks(count):
        """Return the steps in which contacts were inspected."""
        found = []
        for k in range(count):
            corrected.clear()
            friction.before_step(DT)
            if corrected:
                found.append(k)
        return found

    for twist in (Twist((0.0, 4.9e-3, 0.0), (0.0, 0.0, 0.049)),
                  Twist((0.0, 3e-3, 3e-3), (0.03, 0.03, 0.0))):
        body.set_twist(twist)
        friction.check_all()
        assert looks(3) == []
    for twist in (Twist((0.0, 5.1e-3, 0.0)), Twist((0.0, 0.0, 0.0), (0.0, 0.0, -0.051)),
                  Twist((0.0, 4e-3, 4e-3)), Twist((0.0, 0.0, 0.0), (0.04, 0.04, 0.0))):
        body.set_twist(Twist())
        friction.check_all()
        assert looks(1) == []
        body.set_twist(twist)
        assert looks(8) == [5, 6, 7]  # five steps are not looked at
        body.set_twist(Twist())
        assert looks(1) == []
        for tell in (friction.check_all, lambda: friction.set_models([body])):
            body.set_twist(twist)
            tell()
            assert looks(3) == [0, 1, 2]
            body.set_twist(Twist())
            assert looks(1) == []
    assert set(watched) == {body.body_id}
