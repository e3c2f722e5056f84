"""Friction coefficients of links, set so that the smaller one of two counts."""

import itertools

import numpy as np
import pybullet
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, World
from aras_sim_bridge.world.friction import CHECK_EVERY, ContactFriction

DT = 0.001


def solved(own, pairs):
    friction = ContactFriction(-1)
    friction._coefficients = own
    return friction._solve_coefficients(pairs)


@pytest.mark.parametrize("seed", range(4))
def test_without_rings_every_product_is_the_smaller_of_two(seed):
    rng = np.random.default_rng(seed)
    parts = [(int(k), int(rng.integers(-1, 3))) for k in range(9)]
    own = {part: rng.uniform(0.1, 3.0) for part in parts}
    own[parts[4]] = 0.0
    pairs = [(parts[k], parts[rng.integers(k)]) for k in range(1, 8)]
    found = solved(own, frozenset(pairs))
    assert set(found) <= {part for pair in pairs for part in pair}
    found = own | found  # what touches but the smooth one keeps its own
    for a, b in pairs:
        assert found[a] * found[b] == pytest.approx(min(own[a], own[b]))


def test_in_a_ring_that_contradicts_itself_the_squares_of_what_lacks_are_least():
    own = {(k, -1): mu for k, mu in enumerate((0.3, 0.5, 0.9, 2.0))}
    pairs = list(itertools.combinations(own, 2))
    found = solved(own, frozenset(pairs))

    def lacks(x):
        return sum((x[a] + x[b] - np.log(min(own[a], own[b])))**2 for a, b in pairs)

    logs = {part: np.log(value) for part, value in found.items()}
    least = lacks(logs)
    assert least > 0.1
    for part in logs:
        for change in (-1e-3, 1e-3):
            assert lacks({**logs, part: logs[part] + change}) > least


def slab(make, mu, root="slab", bolted=False):
    tag = "" if mu is None else f'<gazebo reference="{root}"><mu1>{mu}</mu1></gazebo>'
    shape = make.box("1 1 0.2")
    link = (f'<link name="{root}">{shape}</link>' if bolted
            else make.link(root, 2.0, inertia=(0.2, 0.2, 0.3, 0, 0, 0), shapes=shape))
    return parse_urdf(make.robot(link, tag))


def given(world, model):
    return pybullet.getDynamicsInfo(model.body_id, -1, physicsClientId=world.client)[1]


@pytest.mark.parametrize(("fixed", "loose", "watched", "first"), [
    (1.0, [1.0], False, (1.0, 1.0)), (1.0, [0.5], False, (1.0, 0.5)),
    (0.4, [1.0], False, (0.4, 1.0)), (0.4, [0.5], True, (0.4, 0.5)),
    (3.0, [0.5], False, (1.0, 0.5)), (3.0, [1.5], True, (1.0, 1.5)),
    (None, [None, 0.3], False, (1.0, 1.0)), (None, [0.2, 0.3], True, (1.0, 0.2)),
])
def test_contacts_are_watched_where_a_product_may_be_another_than_the_smaller(
        make, fixed, loose, watched, first):
    """What never moves counts as at most 1 until it is known what touches it."""
    with World() as world:
        models = [world.spawn(slab(make, fixed, bolted=True), "fixed")]
        models += [world.spawn(slab(make, mu), f"loose{k}", Pose((0, 3 * k, 1)))
                   for k, mu in enumerate(loose)]
        assert world.friction.is_active is watched
        assert [given(world, model) for model in models[:2]] == pytest.approx(first)


def test_contacts_are_looked_at_every_fifth_step_and_at_once_when_models_came(make, monkeypatch):
    with World() as world:
        world.spawn(slab(make, 0.8, bolted=True), "floor")
        friction = world.friction
        model = world.spawn(slab(make, 0.6), "slab", Pose((0.0, 0.0, 0.2)))
        for _ in range(12):
            world.step()
        assert given(world, model) * given(world, world.model("floor")) == pytest.approx(0.6)
        asked = []
        real = pybullet.getContactPoints
        monkeypatch.setattr(pybullet, "getContactPoints",
                            lambda **named: (asked.append(1), real(**named))[1])
        friction.set_models(world.models.values())
        seen = []
        for k in range(12):
            asked.clear()
            friction.before_step()
            seen += [k] * bool(asked)
        assert seen == [0, CHECK_EVERY, 2 * CHECK_EVERY] == [0, 5, 10]
