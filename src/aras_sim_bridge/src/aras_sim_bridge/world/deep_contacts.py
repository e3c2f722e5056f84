"""Slow separation of bodies that overlap after a spawn or a jump, as in Gazebo.

Bullet removes 8 % of the penetration depth per step. A robot that is spawned 5 cm inside the
ground leaves it at 4 m/s. If the ground pushes a stretched arm along its links, no joint can yield,
and the impulses grow without bound. Gazebo limits the separation speed (`<max_vel>`), and its
contacts are slightly compliant.
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
_DEFAULT_ERP = 0.08  # share of the depth that Bullet removes in a step by default
_DRIVEN_STEPS = 10  # a body that jumps again within this time is driven by a program
_CHECK_EVERY = 10  # steps between two checks, in which depths change by 0.1 mm
# 1/kg, compliance of the contacts while the speed is limited. A Kinova Jaco spawned at joint
# positions of 0, 18 cm inside the ground, spins at 2000 rad/s with 0 and at 350 rad/s from 1e-4 on.
_COMPLIANCE = 1e-3
_REPORTED_DEPTH = 5e-3  # m: shallower overlaps are not reported


class DeepContacts:
    """Limits the separation speed of contacts from a spawn or jump until all are shallow.

    Attributes:
        is_active: whether `before_step` and `after_step` have to be called.
    """

    def __init__(self, client: int, models: Mapping[str, Model]) -> None:
        self._client, self._models = client, models
        self.is_active = False
        self._has_unknown_depth = False  # the depths after a jump are known after the next step
        self._steps_since_move = 0  # steps since the last jump, counted while active
        self._largest_depth = 0.0  # m
        self._has_bounded_speed = False  # whether the parameters differ from Bullet's defaults
        self._parameters = (_DEFAULT_ERP, 0.0)  # Bullet's present ERP and CFM of contacts
        self._reported_links: set[tuple[str, str]] = set()

    def start_watching(self) -> None:
        """Start monitoring after models were spawned, loaded or reset."""
        self._has_unknown_depth = self.is_active = True
        self._steps_since_move = 0

    def continue_watching(self) -> None:
        """Extend the monitoring after a model or its joints jumped to another position.

        A model that jumps in every step is driven by a program and may push other bodies at full
        speed.
        """
        self._has_unknown_depth = (
            self._has_unknown_depth or not self.is_active or self._steps_since_move >= _DRIVEN_STEPS
        )
        self.is_active, self._steps_since_move = True, 0

    def clear(self) -> None:
        """Forget all depths and reports, after Bullet was reset."""
        self._reported_links.clear()
        self._largest_depth, self._parameters = 0.0, (_DEFAULT_ERP, 0.0)

    def before_step(self, dt: float) -> None:
        """Limit the separation speed of overlapping bodies in the next step of `dt` s."""
        # After a jump, the depth is unknown until Bullet has made the step.
        depth = math.inf if self._has_unknown_depth else self._largest_depth
        self._has_bounded_speed = depth * _DEFAULT_ERP > _SEPARATION_SPEED * dt
        parameters = (
            (_SEPARATION_SPEED * dt / depth, _COMPLIANCE * dt)
            if self._has_bounded_speed
            else (_DEFAULT_ERP, 0.0)
        )
        if parameters != self._parameters:
            self._parameters = parameters
            pybullet.setPhysicsEngineParameter(contactERP=parameters[0], globalCFM=parameters[1],
                                               physicsClientId=self._client)

    def after_step(self, dt: float) -> None:
        """Update the largest penetration depth every few steps."""
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
        # One step with Bullet's default parameters is still checked.
        self.is_active = (
            self._has_bounded_speed
            or self._largest_depth * _DEFAULT_ERP > _SEPARATION_SPEED * dt
            or self._steps_since_move <= _DRIVEN_STEPS
        )

    def _warn_overlaps(
        self, contacts: list[tuple[float, tuple[int, int], tuple[int, int]]]
    ) -> None:
        """Log one warning for each pair of models with overlapping links."""
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
