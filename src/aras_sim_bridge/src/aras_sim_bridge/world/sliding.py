"""Friction against the way that a loose body slides.

Bullet's cone of friction bounds its size, but weighs its two directions by what the body's inertia
lets each corner move: a box of 0.6 x 0.1 m that slides aslant to its edges is slowed down by a
fifth too little and bends by 20 degrees. So what friction of this size along the way would be, less
what it was in the last step, is given to the body in the next one: within 1 % then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from aras_sim_bridge.world.bullet import find_contacts, pybullet
from aras_sim_bridge.world.impacts import Impacts
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.poses import Vector3, add, cross, scale, subtract

_SLOWEST_SLIDING = 5e-3  # m/s; slower bodies are left to Bullet, which brings them to rest
_SLOWEST_TURNING = 5e-2  # rad/s
_PAUSE = 5  # steps between two looks where nothing moved
_STEPS = 4  # a point slides when friction needs so many steps at least to hold it up


class SlidingFriction:
    """Keeps the friction of the loose bodies of a world: free models without joints."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._impacts = Impacts(client)
        self.loose: list[Model] = []
        self._fixed: frozenset[int] = frozenset()
        self._pause = 0  # steps

    def check_all(self) -> None:
        """A body was pushed or put elsewhere: look at all in the next step."""
        self._pause = 0
        self._impacts.check_all()

    def set_models(self, models: Iterable[Model]) -> None:
        """Models came, went, were loaded anew or are held."""
        models = list(models)
        self.loose = [model for model in models if not (model.fixed_base or model.joint_names)]
        self._pause = 0
        self._impacts.set_models(models)
        self._fixed = frozenset(model.body.body_id for model in models if model.fixed_base)

    def before_step(self, dt: float) -> None:
        """Correct in the coming step of `dt` s what was wrong with friction in the last one, and
        see what the bodies strike in it."""
        self._impacts.restore_restitution()
        if self._pause:
            self._pause -= 1
            return
        done: set[int] = set()
        for model in self.loose:
            linear, angular = pybullet.getBaseVelocity(model.body.body_id, self._client)
            if math.hypot(*linear) > _SLOWEST_SLIDING or math.hypot(*angular) > _SLOWEST_TURNING:
                self._correct_friction(model, linear, angular, dt, done)
                self._impacts.place_at_impact(model.body_id, linear, angular, dt)
                done.add(model.body_id)
        self._pause = 0 if done else _PAUSE

    def _correct_friction(self, model: Model, linear: Vector3, angular: Vector3, dt: float,
              corrected_bodies: set[int]) -> None:
        """Those contacts of a loose body that are not with one of those `corrected_bodies`."""
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
            slip = subtract(slip, self._compute_point_velocity(other, link, point))
            away = sum(a * b for a, b in zip(slip, normal, strict=True))
            slip = subtract(slip, scale(normal, away))
            speed, size = math.hypot(*slip), math.hypot(numbers[7], numbers[11])
            if speed <= least or size == 0.0:
                continue
            felt = add(scale(numbers[8:11], numbers[7]), scale(numbers[12:], numbers[11]))
            lack = subtract(scale(slip, -size / speed), felt)
            self._apply_force(body, -1, lack, point)
            if link != -1 or other not in self._fixed:
                self._apply_force(other, link, scale(lack, -1.0), point)

    def _apply_force(self, body: int, link: int, force: Vector3, point: Vector3) -> None:
        pybullet.applyExternalForce(body, link, force, point, pybullet.WORLD_FRAME,
                                    physicsClientId=self._client)

    def _compute_point_velocity(self, body: int, link: int, point: Vector3) -> Vector3:
        """Velocity of the point of a body's link that is there, m/s."""
        if link >= 0:
            state = pybullet.getLinkState(body, link, True, True, self._client)
            centre, linear, angular = state[0], state[6], state[7]
        elif body in self._fixed:
            return (0.0, 0.0, 0.0)
        else:
            centre = pybullet.getBasePositionAndOrientation(body, self._client)[0]
            linear, angular = pybullet.getBaseVelocity(body, self._client)
        return add(linear, cross(angular, subtract(point, centre)))
