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
from aras_sim_bridge.world.labels import list_links_by_label, make_label
from aras_sim_bridge.world.model import Model

_log = logging.getLogger(__name__)

_SEPARATION_SPEED = 0.01  # m/s, Gazebo's default of <max_vel>
_DEFAULT_ERP = 0.08  # of the depth that Bullet removes in a step by default
_DRIVEN_STEPS = 10  # steps: what is put elsewhere again within them is driven
_CHECK_EVERY = 10  # steps between two looks, in which depths change by 0.1 mm
# 1/kg, by which contacts give way meanwhile: with 0 the Kinova Jaco that is spawned at joint
# positions of 0, 18 cm within the ground, spins at 2000 rad/s, from 1e-4 on at 350 rad/s.
_COMPLIANCE = 1e-3
_REPORTED_DEPTH = 5e-3  # m: shallower overlaps are not worth a line


class DeepContacts:
    """Watches the contacts of a world from when something was put elsewhere until all are shallow.

    Attributes:
        watched: whether `before_step` and `after_step` have to be called.
    """

    def __init__(self, client: int, models: Mapping[str, Model]) -> None:
        self._client, self._models = client, models
        self.is_active = False
        self._has_unknown_depth = False  # whether how deep bodies are in each other is not known
        self._steps_since_move = 0  # steps since something was put elsewhere, of those watched
        self._largest_depth = 0.0  # m
        self._has_bounded_speed = False  # whether the parameters are not Bullet's usual ones
        self._parameters = (_DEFAULT_ERP, 0.0)  # what Bullet has: its ERP and CFM of contacts
        self._reported_links: set[tuple[str, str]] = set()

    def start_watching(self) -> None:
        """Models came, or all were put back."""
        self._has_unknown_depth = self.is_active = True
        self._steps_since_move = 0

    def continue_watching(self) -> None:
        """A model was put elsewhere as a whole, or its joints were.

        What is put elsewhere in step after step is driven, and pushes what is in its way.
        """
        self._has_unknown_depth = (
            self._has_unknown_depth or not self.is_active or self._steps_since_move >= _DRIVEN_STEPS
        )
        self.is_active, self._steps_since_move = True, 0

    def clear(self) -> None:
        """Bullet was emptied."""
        self._reported_links.clear()
        self._largest_depth, self._parameters = 0.0, (_DEFAULT_ERP, 0.0)

    def before_step(self, dt: float) -> None:
        """Bound the speed at which the coming step of `dt` s parts what overlaps."""
        # How deep what was put elsewhere is in others, only the step finds.
        depth = math.inf if self._has_unknown_depth else self._largest_depth
        self._has_bounded_speed = depth * _DEFAULT_ERP > _SEPARATION_SPEED * dt
        wanted = (
            (_SEPARATION_SPEED * dt / depth, _COMPLIANCE * dt)
            if self._has_bounded_speed
            else (_DEFAULT_ERP, 0.0)
        )
        if wanted != self._parameters:
            self._parameters = wanted
            pybullet.setPhysicsEngineParameter(contactERP=wanted[0], globalCFM=wanted[1],
                                               physicsClientId=self._client)

    def after_step(self, dt: float) -> None:
        """Look how deep bodies are in each other, now and then."""
        self._steps_since_move += 1
        if not self._has_unknown_depth and self._steps_since_move % _CHECK_EVERY:
            return
        contacts = [(-one[8], (one[1], one[3]), (one[2], one[4]))
                    for one in pybullet.getContactPoints(physicsClientId=self._client)
                    if one[1] != one[2]]
        self._largest_depth = max((one[0] for one in contacts), default=0.0)
        if self._has_unknown_depth:
            self._warn_overlaps(contacts)
        self._has_unknown_depth = False
        # A step that has Bullet's usual parameters is the last one that is watched.
        self.is_active = (
            self._has_bounded_speed
            or self._largest_depth * _DEFAULT_ERP > _SEPARATION_SPEED * dt
            or self._steps_since_move <= _DRIVEN_STEPS
        )

    def _warn_overlaps(
        self, contacts: list[tuple[float, tuple[int, int], tuple[int, int]]]
    ) -> None:
        """Warn of each two models of which links are within each other, once."""
        found: dict[tuple[int, int], list[tuple[float, int, int]]] = {}
        for depth, one, other in contacts:
            if depth >= _REPORTED_DEPTH:
                found.setdefault((one[0], other[0]), []).append(
                    (depth, make_label(*one), make_label(*other)))
        labels = list_links_by_label(self._models) if found else {}
        named = set()
        for pairs in found.values():
            depth, one, other = max(pairs)
            named.add((labels[one], labels[other]))
            if (labels[one], labels[other]) in self._reported_links:
                continue
            more = len({pair[1:] for pair in pairs}) - 1
            _log.warning(
                "%s is %.0f mm within %s%s: they part at %g mm/s, as in Gazebo; put it "
                "elsewhere, or give its joints other positions (spawn_model -J)",
                labels[one],
                1e3 * depth,
                labels[other],
                f", and {more} more of their links are" if more else "",
                1e3 * _SEPARATION_SPEED,
            )
        self._reported_links = named
