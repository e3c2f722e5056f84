"""Contact friction as in Gazebo: the smaller of the two coefficients of a contact applies.

Bullet multiplies the two coefficients. Therefore each link gets a value exp(x_i) such that the
products equal the smaller coefficients: x_i + x_j = log min(mu_i, mu_j) for all contacts, in the
least-squares sense. The solution is exact unless contacts form rings with contradictory equations,
such as four links that all touch each other with three different coefficients.
"""

from collections.abc import Iterable

import numpy as np

from aras_sim_bridge.world.body import DEFAULT_FRICTION
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.model import Model

CHECK_EVERY = 5  # steps between checks of the contacts; new ones have the product until the next

_LinkId = tuple[int, int]  # Bullet's body id and link index


class ContactFriction:
    """Maintains the friction coefficients of all contacts of a world."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._coefficients: dict[_LinkId, float] = {}
        self._applied: dict[_LinkId, float] = {}
        self._pairs: frozenset[tuple[_LinkId, _LinkId]] = frozenset()
        self._countdown = CHECK_EVERY
        self.is_active = False

    def set_models(self, models: Iterable[Model]) -> None:
        """Read the coefficients of all models, after some were spawned, deleted or reloaded."""
        self._coefficients, fixed = {}, set()
        for model in models:
            for name, index in model.link_indices.items():
                if model.description.links[name].collisions:
                    part = (model.body_id, index)
                    self._coefficients[part] = model.body.friction[index]
                    if model.fixed_base and index == -1:
                        fixed.add(part)
        # A fixed body is mostly the ground, which is rougher than the bodies on it.
        self._applied = {part: min(mu, DEFAULT_FRICTION) if part in fixed else mu
                       for part, mu in self._coefficients.items()}
        for (body, link), value in self._applied.items():
            self._apply(body, link, value)
        self._pairs = frozenset()
        self._countdown = 1
        values = self._applied.values()
        # If at most one coefficient differs from 1, every product equals the smaller one.
        self.is_active = any(v > 1.0 for v in values) or sum(v != 1.0 for v in values) > 1

    def before_step(self) -> None:
        """Update the coefficients if the contacts changed; call it each step while `is_active`."""
        self._countdown -= 1
        if self._countdown:
            return
        self._countdown = CHECK_EVERY
        points = pybullet.getContactPoints(physicsClientId=self._client)
        pairs = frozenset(((p[1], p[3]), (p[2], p[4])) for p in points)
        if pairs != self._pairs:
            self._pairs = pairs
            for part, value in self._solve_coefficients(pairs).items():
                if self._applied[part] != value:
                    self._applied[part] = value
                    self._apply(*part, value)

    def _solve_coefficients(self, pairs: Iterable[tuple[_LinkId, _LinkId]]) -> dict[_LinkId, float]:
        """Return one coefficient per touching link; products equal the smaller original ones."""
        smooth = {part for pair in pairs for part in pair if self._coefficients[part] == 0.0}
        rough = [pair for pair in sorted(pairs) if not smooth.intersection(pair)]
        parts = sorted({part for pair in rough for part in pair})
        column = {part: i for i, part in enumerate(parts)}
        matrix = np.zeros((len(rough), len(parts)))
        log_limits = np.zeros(len(rough))
        for row, (a, b) in enumerate(rough):
            matrix[row, [column[a], column[b]]] = 1.0
            log_limits[row] = np.log(min(self._coefficients[a], self._coefficients[b]))
        found = np.exp(np.linalg.lstsq(matrix, log_limits, rcond=None)[0])
        return dict.fromkeys(smooth, 0.0) | dict(zip(parts, found.tolist(), strict=True))

    def _apply(self, body: int, link: int, value: float) -> None:
        pybullet.changeDynamics(body, link, lateralFriction=value, physicsClientId=self._client)
