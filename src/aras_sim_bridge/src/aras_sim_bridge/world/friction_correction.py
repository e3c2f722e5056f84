"""Correction of Bullet's friction on free bodies, so that it opposes the sliding direction.

The friction force that Bullet computes at a contact has the right magnitude, but not exactly the
right direction. A box of 0.6 x 0.1 m that slides at an angle to its edges is decelerated by a fifth
too little and turns by 20 degrees. Therefore the difference between the right force and Bullet's
force in the last step is applied in the next step. The remaining error is 1 %.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from aras_sim_bridge.world.bullet import compute_point_velocity, find_contacts, pybullet
from aras_sim_bridge.world.impacts import Impacts
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.poses import Vector3, add, cross, scale, subtract

# The friction on a free body is not corrected if its speed is below _SLOWEST_SLIDING (m/s) and its
# angular velocity is below _SLOWEST_TURNING (rad/s). Bullet brings such a body to rest.
_SLOWEST_SLIDING = 5e-3
_SLOWEST_TURNING = 5e-2
# While no free body moves, number of steps between two checks whether one has started to move.
_PAUSE = 5
# A contact point is regarded as sliding if friction cannot stop it within this number of steps.
_STEPS = 4


class FrictionCorrection:
    """Corrects the friction of a world's free bodies: models that have no joints and are not fixed.

    Attributes:
        loose: the free bodies.
    """

    def __init__(self, client: int) -> None:
        self._client = client
        self._impacts = Impacts(client)
        self.loose: list[Model] = []
        self._fixed: frozenset[int] = frozenset()
        self._pause = 0  # number of steps until the next check of the free bodies

    def check_all(self) -> None:
        """Check all free bodies for sliding and impacts in the next step.

        This is called after a free body was pushed or moved.
        """
        self._pause = 0
        self._impacts.check_all()

    def set_models(self, models: Iterable[Model]) -> None:
        """List the free bodies; called after models were spawned, deleted, reloaded or fixed."""
        models = list(models)
        self.loose = [model for model in models if not (model.fixed_base or model.joint_names)]
        self._pause = 0
        self._impacts.set_models(models)
        self._fixed = frozenset(model.body.body_id for model in models if model.fixed_base)

    def before_step(self, dt: float) -> None:
        """Correct the friction of the last step, and detect impacts in the next step.

        `dt` is the time step, s.
        """
        self._impacts.restore_restitution()
        if self._pause:
            self._pause -= 1
            return
        corrected: set[int] = set()
        for model in self.loose:
            linear, angular = pybullet.getBaseVelocity(model.body.body_id, self._client)
            if math.hypot(*linear) > _SLOWEST_SLIDING or math.hypot(*angular) > _SLOWEST_TURNING:
                self._correct_friction(model, linear, angular, dt, corrected)
                self._impacts.place_at_impact(model.body_id, linear, angular, dt)
                corrected.add(model.body_id)
        self._pause = 0 if corrected else _PAUSE

    def _correct_friction(self, model: Model, linear: Vector3, angular: Vector3, dt: float,
              corrected_bodies: set[int]) -> None:
        """Correct the friction at the contacts of a free body.

        Contacts with `corrected_bodies` are skipped, because they are already corrected.
        """
        body = model.body_id
        contacts = [
            one for one in find_contacts(body, self._client) if one[1] not in corrected_bodies
        ]
        if not contacts:
            return
        centre = pybullet.getBasePositionAndOrientation(body, self._client)[0]
        least = _STEPS * dt * sum(math.hypot(c[3][7], c[3][11]) for c in contacts) / model.mass
        for _, other, link, numbers in contacts:
            point, normal = numbers[:3], numbers[4:7]
            slip = add(linear, cross(angular, subtract(point, centre)))
            if link >= 0 or other not in self._fixed:
                slip = subtract(slip, compute_point_velocity(other, link, point, self._client))
            normal_speed = sum(a * b for a, b in zip(slip, normal, strict=True))
            slip = subtract(slip, scale(normal, normal_speed))
            speed, magnitude = math.hypot(*slip), math.hypot(numbers[7], numbers[11])
            if speed <= least or magnitude == 0.0:
                continue
            applied = add(scale(numbers[8:11], numbers[7]), scale(numbers[12:], numbers[11]))
            missing = subtract(scale(slip, -magnitude / speed), applied)
            self._apply_force(body, -1, missing, point)
            if link != -1 or other not in self._fixed:
                self._apply_force(other, link, scale(missing, -1.0), point)

    def _apply_force(self, body: int, link: int, force: Vector3, point: Vector3) -> None:
        pybullet.applyExternalForce(body, link, force, point, pybullet.WORLD_FRAME,
                                    physicsClientId=self._client)
