"""Contact friction as in Gazebo: each contact uses the smaller coefficient of its two links.

Bullet multiplies the coefficients mu_i and mu_j of the two links instead. Therefore each link i
gets a new coefficient exp(x_i), such that the product of the new coefficients of two touching links
is the smaller of their original coefficients. The equations x_i + x_j = log min(mu_i, mu_j) of all
contacts are solved by least squares. The solution is exact unless contacts form loops with
contradictory equations, such as four links that all touch each other and have three different
coefficients.
"""

from collections.abc import Iterable

import numpy as np

from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.bullet_body import DEFAULT_FRICTION
from aras_sim_bridge.world.model import Model

# Number of steps between two checks for new contacts. Until the next check, the friction
# coefficient of a new contact is the product of the coefficients of its links.
CHECK_EVERY = 5

_LinkId = tuple[int, int]  # Bullet's body id and link index


class ContactFriction:
    """Sets the friction coefficients in Bullet from the present contacts of a world."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._coefficients: dict[_LinkId, float] = {}
        self._applied: dict[_LinkId, float] = {}
        self._pairs: frozenset[tuple[_LinkId, _LinkId]] = frozenset()
        self._countdown = CHECK_EVERY
        self.is_active = False

    def set_models(self, models: Iterable[Model]) -> None:
        """Read the friction coefficients of all models.

        This is called after models were spawned, deleted or reloaded.
        """
        self._coefficients, fixed = {}, set()
        for model in models:
            for name, index in model.link_indices.items():
                if model.description.links[name].collisions:
                    part = (model.body_id, index)
                    self._coefficients[part] = model.body.friction[index]
                    if model.fixed_base and index == -1:
                        fixed.add(part)
        # Limit the friction coefficient of a fixed body, which is usually the ground, to 1. The
        # coefficient of a body on the ground is usually smaller. The product of both is then the
        # smaller coefficient, as it should be.
        self._applied = {part: min(mu, DEFAULT_FRICTION) if part in fixed else mu
                       for part, mu in self._coefficients.items()}
        for (body, link), value in self._applied.items():
            self._apply(body, link, value)
        self._pairs = frozenset()
        self._countdown = 1
        values = self._applied.values()
        # If no friction coefficient exceeds 1 and at most one differs from 1, the product of any
        # two is the smaller one, so nothing has to be updated.
        self.is_active = any(v > 1.0 for v in values) or sum(v != 1.0 for v in values) > 1

    def before_step(self) -> None:
        """Update the coefficients in Bullet if links have touched or separated.

        Call this in each step while `is_active`; it checks every CHECK_EVERY steps.
        """
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
        """Return the coefficient of each touching link that gives all contacts the right friction.

        The product of the coefficients of the two links of a pair shall be the smaller of their
        original coefficients. The logarithms of the coefficients are computed by least squares.
        """
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
