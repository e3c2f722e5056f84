"""Contact friction as Gazebo has it: of two that touch, the smaller coefficient counts.

Bullet multiplies the two. So each link is given a number whose products with those of the links
that it touches are the smaller coefficients: x_i + x_j = log min(mu_i, mu_j) over the contacts, in
least squares. That is exact unless contacts form rings that contradict each other, as four links
that all touch each other with three different coefficients do.
"""

from collections.abc import Iterable

import numpy as np

from aras_sim_bridge.world.body import DEFAULT_FRICTION
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.model import Model

CHECK_EVERY = 5  # steps; a new contact has the product until then, no contact costs a tenth of it

_LinkId = tuple[int, int]  # Bullet's numbers of body and link


class ContactFriction:
    """Keeps the friction of all contacts of a world."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._coefficients: dict[_LinkId, float] = {}
        self._applied: dict[_LinkId, float] = {}
        self._pairs: frozenset[tuple[_LinkId, _LinkId]] = frozenset()
        self._countdown = CHECK_EVERY
        self.is_active = False

    def set_models(self, models: Iterable[Model]) -> None:
        """Models came, went or were loaded anew: everything has the coefficient of its file."""
        self._coefficients, fixed = {}, set()
        for model in models:
            for name, index in model.link_indices.items():
                if model.description.links[name].collisions:
                    part = (model.body_id, index)
                    self._coefficients[part] = model.body.friction[index]
                    if model.fixed_base and index == -1:
                        fixed.add(part)
        # What never moves is mostly the ground, rougher than all that stands on it.
        self._applied = {part: min(mu, DEFAULT_FRICTION) if part in fixed else mu
                       for part, mu in self._coefficients.items()}
        for (body, link), value in self._applied.items():
            self._apply(body, link, value)
        self._pairs = frozenset()
        self._countdown = 1
        values = self._applied.values()
        # With at most one that is not 1, every product is the smaller of the two.
        self.is_active = any(v > 1.0 for v in values) or sum(v != 1.0 for v in values) > 1

    def before_step(self) -> None:
        """Look at what touches; to be called in every step while `is_active`."""
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
        """What to give each link that touches something, as the module says."""
        smooth = {part for pair in pairs for part in pair if self._coefficients[part] == 0.0}
        rough = [pair for pair in sorted(pairs) if not smooth.intersection(pair)]
        parts = sorted({part for pair in rough for part in pair})
        column = {part: i for i, part in enumerate(parts)}
        matrix = np.zeros((len(rough), len(parts)))
        wanted = np.zeros(len(rough))
        for row, (a, b) in enumerate(rough):
            matrix[row, [column[a], column[b]]] = 1.0
            wanted[row] = np.log(min(self._coefficients[a], self._coefficients[b]))
        found = np.exp(np.linalg.lstsq(matrix, wanted, rcond=None)[0])
        return dict.fromkeys(smooth, 0.0) | dict(zip(parts, found.tolist(), strict=True))

    def _apply(self, body: int, link: int, value: float) -> None:
        pybullet.changeDynamics(body, link, lateralFriction=value, physicsClientId=self._client)
