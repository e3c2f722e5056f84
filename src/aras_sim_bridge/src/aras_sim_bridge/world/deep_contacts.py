"""Bodies that were put into one another leave slowly, as in Gazebo.

Bullet removes 8 % of the depth in each step: a robot that is spawned 5 cm within the ground is shot
out of it at 4 m/s, and one whose stretched arm the ground pushes along its links, which no
joint gives way to, gets impulses without bound and diverges. Gazebo bounds the speed at which
contacts part what overlaps (`<max_vel>`), and its contacts give way a little.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping

from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.labels import label, links_by_label
from aras_sim_bridge.world.model import Model

_log = logging.getLogger(__name__)

_SPEED = 0.01  # m/s, Gazebo's default of <max_vel>
_SHARE = 0.08  # of the depth that Bullet removes in a step by default
_DRIVEN = 10  # steps: what is put elsewhere again within them is driven
_EVERY = 10  # steps between two looks, in which depths change by 0.1 mm
# 1/kg, by which contacts give way meanwhile: with 0 the Kinova Jaco that is spawned at joint
# positions of 0, 18 cm within the ground, spins at 2000 rad/s, from 1e-4 on at 350 rad/s.
_YIELDING = 1e-3
_NAMED = 5e-3  # m: shallower overlaps are not worth a line


class DeepContacts:
    """Watches the contacts of a world from when something was put elsewhere until all are shallow.

    Attributes:
        watched: whether `before_step` and `after_step` have to be called.
    """

    def __init__(self, client: int, models: Mapping[str, Model]) -> None:
        self._client, self._models = client, models
        self.watched = False
        self._fresh = False  # whether how deep bodies are in each other is not known
        self._since = 0  # steps since something was put elsewhere, of those watched
        self._deepest = 0.0  # m
        self._bounded = False  # whether the parameters are not Bullet's usual ones
        self._given = (_SHARE, 0.0)  # what Bullet has: its ERP and CFM of contacts
        self._named: set[tuple[str, str]] = set()

    def came(self) -> None:
        """Models came, or all were put back."""
        self._fresh = self.watched = True
        self._since = 0

    def put(self) -> None:
        """A model was put elsewhere as a whole, or its joints were.

        What is put elsewhere in step after step is driven, and pushes what is in its way.
        """
        self._fresh = self._fresh or not self.watched or self._since >= _DRIVEN
        self.watched, self._since = True, 0

    def clear(self) -> None:
        """Bullet was emptied."""
        self._named.clear()
        self._deepest, self._given = 0.0, (_SHARE, 0.0)

    def before_step(self, dt: float) -> None:
        """Bound the speed at which the coming step of `dt` s parts what overlaps."""
        # How deep what was put elsewhere is in others, only the step finds.
        depth = math.inf if self._fresh else self._deepest
        self._bounded = depth * _SHARE > _SPEED * dt
        wanted = ((_SPEED * dt / depth, _YIELDING * dt) if self._bounded else (_SHARE, 0.0))
        if wanted != self._given:
            self._given = wanted
            pybullet.setPhysicsEngineParameter(contactERP=wanted[0], globalCFM=wanted[1],
                                               physicsClientId=self._client)

    def after_step(self, dt: float) -> None:
        """Look how deep bodies are in each other, now and then."""
        self._since += 1
        if not self._fresh and self._since % _EVERY:
            return
        contacts = [(-one[8], (one[1], one[3]), (one[2], one[4]))
                    for one in pybullet.getContactPoints(physicsClientId=self._client)
                    if one[1] != one[2]]
        self._deepest = max((one[0] for one in contacts), default=0.0)
        if self._fresh:
            self._name(contacts)
        self._fresh = False
        # A step that has Bullet's usual parameters is the last one that is watched.
        self.watched = (self._bounded or self._deepest * _SHARE > _SPEED * dt
                        or self._since <= _DRIVEN)

    def _name(self, contacts: list[tuple[float, tuple[int, int], tuple[int, int]]]) -> None:
        """Warn of each two models of which links are within each other, once."""
        found: dict[tuple[int, int], list[tuple[float, int, int]]] = {}
        for depth, one, other in contacts:
            if depth >= _NAMED:
                found.setdefault((one[0], other[0]), []).append(
                    (depth, label(*one), label(*other)))
        labels = links_by_label(self._models) if found else {}
        named = set()
        for pairs in found.values():
            depth, one, other = max(pairs)
            named.add((labels[one], labels[other]))
            if (labels[one], labels[other]) in self._named:
                continue
            more = len({pair[1:] for pair in pairs}) - 1
            _log.warning("%s is %.0f mm within %s%s: they part at %g mm/s, as in Gazebo; put it "
                         "elsewhere, or give its joints other positions (spawn_model -J)",
                         labels[one], 1e3 * depth, labels[other],
                         f", and {more} more of their links are" if more else "", 1e3 * _SPEED)
        self._named = named
