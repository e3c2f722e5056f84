"""Friction against the way that a loose body slides.

Bullet's cone of friction bounds its size, but weighs its two directions by what the body's inertia
lets each corner move: a box of 0.6 x 0.1 m that slides aslant to its edges is slowed down by a
fifth too little and bends by 20 degrees. So what friction of this size along the way would be, less
what it was in the last step, is given to the body in the next one: within 1 % then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from aras_sim_bridge.world.bullet import contacts_of, pybullet
from aras_sim_bridge.world.impacts import Impacts
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.poses import Vector3, add, cross, scaled, subtract

_SLOW = 5e-3  # m/s; slower bodies are left to Bullet, which brings them to rest
_SLOW_TURN = 5e-2  # rad/s
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

    def pushed(self) -> None:
        """A body was pushed or put elsewhere: look at all in the next step."""
        self._pause = 0
        self._impacts.pushed()

    def models_changed(self, models: Iterable[Model]) -> None:
        """Models came, went, were loaded anew or are held."""
        models = list(models)
        self.loose = [model for model in models if not (model.fixed_base or model.joint_names)]
        self._pause = 0
        self._impacts.models_changed(models)
        self._fixed = frozenset(model.body.body_id for model in models if model.fixed_base)

    def before_step(self, dt: float) -> None:
        """Correct in the coming step of `dt` s what was wrong with friction in the last one, and
        see what the bodies strike in it."""
        self._impacts.begin()
        if self._pause:
            self._pause -= 1
            return
        done: set[int] = set()
        for model in self.loose:
            linear, angular = pybullet.getBaseVelocity(model.body.body_id, self._client)
            if math.hypot(*linear) > _SLOW or math.hypot(*angular) > _SLOW_TURN:
                self._correct(model, linear, angular, dt, done)
                self._impacts.watch(model.body_id, linear, angular, dt)
                done.add(model.body_id)
        self._pause = 0 if done else _PAUSE

    def _correct(self, model: Model, linear: Vector3, angular: Vector3, dt: float,
              done: set[int]) -> None:
        """Those contacts of a loose body that are not with one of those `done`."""
        body = model.body_id
        contacts = [one for one in contacts_of(body, self._client) if one[1] not in done]
        if not contacts:
            return
        centre = pybullet.getBasePositionAndOrientation(body, self._client)[0]
        least = _STEPS * dt * sum(math.hypot(c[3][7], c[3][11]) for c in contacts) / model.mass
        for _, other, link, numbers in contacts:
            point, normal = numbers[:3], numbers[4:7]
            slip = add(linear, cross(angular, subtract(point, centre)))
            slip = subtract(slip, self._speed(other, link, point))
            away = sum(a * b for a, b in zip(slip, normal, strict=True))
            slip = subtract(slip, scaled(normal, away))
            speed, size = math.hypot(*slip), math.hypot(numbers[7], numbers[11])
            if speed <= least or size == 0.0:
                continue
            felt = add(scaled(numbers[8:11], numbers[7]), scaled(numbers[12:], numbers[11]))
            lack = subtract(scaled(slip, -size / speed), felt)
            self._push(body, -1, lack, point)
            if link != -1 or other not in self._fixed:
                self._push(other, link, scaled(lack, -1.0), point)

    def _push(self, body: int, link: int, force: Vector3, point: Vector3) -> None:
        pybullet.applyExternalForce(body, link, force, point, pybullet.WORLD_FRAME,
                                    physicsClientId=self._client)

    def _speed(self, body: int, link: int, point: Vector3) -> Vector3:
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
