"""Slow separation of bodies that overlap after a spawn or a jump, as in Gazebo.

Bullet removes 8 % of the penetration depth in each step of 1 ms, so a robot that is spawned 5 cm
inside the ground leaves it at 4 m/s. If the ground pushes a stretched arm along its links, no joint
can yield, and the impulses grow without bound. Gazebo limits the separation speed (`<max_vel>`),
and its contacts are slightly compliant. This module gives Bullet's contacts both properties while
bodies overlap.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping

from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.labels import list_links_by_label, make_label
from aras_sim_bridge.world.model import Model

_log = logging.getLogger(__name__)

# Largest speed at which overlapping bodies separate, m/s: Gazebo's default of <max_vel>.
_SEPARATION_SPEED = 0.01
# Fraction of the penetration depth of a contact that Bullet removes in each step by default.
_DEFAULT_ERP = 0.08
# If a model jumps again within this number of steps, a program is assumed to drive it. The
# separation speed is then not limited.
_DRIVEN_STEPS = 10
# Number of steps between two checks of the penetration depths. With steps of 1 ms, the depths
# change by at most 0.1 mm in this time while the separation speed is limited.
_CHECK_EVERY = 10
# Compliance of the contacts while the separation speed is limited, 1/kg. It was measured on a
# Kinova Jaco that is spawned 18 cm inside the ground. Without compliance the Jaco spins at 2000
# rad/s, with a compliance of 1e-4 or more at 350 rad/s.
_COMPLIANCE = 1e-3
# Smallest penetration depth for which a warning is logged, m.
_REPORTED_DEPTH = 5e-3


class PenetrationRecovery:
    """Limits the separation speed of overlapping bodies after a spawn or jump.

    The limit applies until all penetration depths are small.

    Attributes:
        is_active: whether `before_step` and `after_step` must be called in each step.
    """

    def __init__(self, client: int, models: Mapping[str, Model]) -> None:
        self._client, self._models = client, models
        self.is_active = False
        # True from a jump of a model until Bullet has made the next step
        self._has_unknown_depth = False
        self._steps_since_move = 0
        self._largest_depth = 0.0  # largest penetration depth of all contacts, m
        self._has_bounded_speed = False
        # present values of Bullet's parameters contactERP and globalCFM
        self._parameters = (_DEFAULT_ERP, 0.0)
        self._reported_links: set[tuple[str, str]] = set()

    def start_watching(self) -> None:
        """Start to monitor penetration depths after models were spawned, loaded or reset."""
        self._has_unknown_depth = self.is_active = True
        self._steps_since_move = 0

    def continue_watching(self) -> None:
        """Continue to monitor penetration depths after a model or its joints jumped.

        If jumps follow each other within _DRIVEN_STEPS, a program drives the model. The separation
        speed is then not limited, so that the model may push other bodies at full speed.
        """
        self._has_unknown_depth = (
            self._has_unknown_depth or not self.is_active or self._steps_since_move >= _DRIVEN_STEPS
        )
        self.is_active, self._steps_since_move = True, 0

    def clear(self) -> None:
        """Forget the penetration depths and the logged overlaps; called after Bullet was reset."""
        self._reported_links.clear()
        self._largest_depth, self._parameters = 0.0, (_DEFAULT_ERP, 0.0)

    def before_step(self, dt: float) -> None:
        """Limit the separation speed of overlapping bodies in the next step of `dt` s."""
        # After a jump of a model, the penetration depth is unknown until Bullet has made a step;
        # assume the worst.
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
        """Measure the largest penetration depth, every _CHECK_EVERY steps and after a jump.

        Decide from it whether `is_active` stays True.
        """
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
        # Stay active for one step after the last step with a limited separation speed. In this
        # additional step, before_step restores Bullet's default parameters.
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
                "%s and %s overlap by %.0f mm%s and move apart at %g mm/s, as in Gazebo; place one "
                "of them elsewhere, or give its joints other positions (spawn_model -J)",
                labels[one],
                labels[other],
                1e3 * depth,
                f" (further pairs of their links that overlap: {more})" if more else "",
                1e3 * _SEPARATION_SPEED,
            )
        self._reported_links = named
