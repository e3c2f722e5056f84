"""Loose bodies that would run into something within a step are put where they strike it.

Bullet sees what is nearer than a fiftieth of a body's size, boxes not even that, and stops at its
surface what comes that near. What crosses that distance within one step is found inside the other
body instead, and pushed out of it: at 5.9 m/s a ball of 20 mm left at 0.34 m/s. And Bullet's
restitution is right only where two bodies begin a step as they touch.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.poses import (
    Vector3,
    add,
    cross,
    multiply,
    normalise,
    scale,
    subtract,
)

_PENETRATION = 1e-5  # m, by which Bullet lets what touches sink in
_SLOWEST = 0.05  # m/s; slower bodies strike nothing: they roll, slide and come to rest
_STEP_MARGIN = 1.25  # steps: gravity adds to the speed of the slowest
_SEARCH_MARGIN, _CLEAR_STEPS = 10, 6  # steps looked ahead; not looked at where nothing is so near
_TILT, _SIDES = 5e-3, 9  # rad: a third of what Bullet forgets corners at; to how many sides

_LinkId = tuple[int, int]  # Bullet's numbers of body and link


def _dot(a: Vector3, b: Vector3) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


class Impacts:
    """Watches the loose bodies of a world."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._links: dict[int, list[int]] = {}  # that may touch, by loose body
        self._steps_without_check: dict[int, int] = {}  # steps in which nothing is near
        self._planes: set[int] = set()
        self._jointed: set[int] = set()
        self._bounce: dict[_LinkId, tuple[float, float]] = {}
        self._bouncing: list[_LinkId] = []

    def set_models(self, models: Collection[Model]) -> None:
        """Models came, went or were loaded anew."""
        self._links, self._planes, self._bounce, self._bouncing = {}, set(), {}, []
        self._jointed = {model.body_id for model in models if model.joint_names}
        for model in models:
            body = model.body_id
            shapes = {model.link_index(name): link.collisions
                      for name, link in model.description.links.items() if link.collisions}
            for name, index in model.link_indices.items():
                bounce = model.description.links[name].bounce
                if bounce is not None:
                    self._bounce[body, index] = bounce
            if any(one.geometry.kind == "plane" for ones in shapes.values() for one in ones):
                self._planes.add(body)
            if not (model.fixed_base or body in self._jointed):
                self._links[body] = list(shapes)
        self.check_all()

    def check_all(self) -> None:
        """A body was pushed or put elsewhere: look at all in the next step."""
        self._steps_without_check = dict.fromkeys(self._links, 0)

    def restore_restitution(self) -> None:
        """Before each step: what bounced in the last one is as before."""
        for body, link in self._bouncing:
            pybullet.changeDynamics(body, link, restitution=0.0, physicsClientId=self._client)
        self._bouncing = []

    def place_at_impact(self, body: int, linear: Vector3, angular: Vector3, dt: float) -> None:
        """Put a loose body that moves so where it strikes something in a step of `dt` s."""
        if self._steps_without_check[body] > 0 or not self._links[body]:
            self._steps_without_check[body] -= 1
            return
        low, high = self._find_box(body)
        speed = math.hypot(*linear) + 0.5 * math.hypot(*angular) * math.dist(low, high)
        if speed < _SLOWEST:
            return
        travel = _SEARCH_MARGIN * speed * dt
        near = pybullet.getOverlappingObjects([v - travel for v in low],
                                              [v + travel for v in high], self._client) or ()
        first, self._steps_without_check[body] = None, _CLEAR_STEPS
        for other in sorted({one for one, _ in near} - {body}):
            for point in pybullet.getClosestPoints(body, other, travel,
                                                   physicsClientId=self._client):
                self._steps_without_check[body] = 0
                found = self._find_impact(body, linear, angular, point, dt)
                if found is not None and (first is None or found[0] < first[0]):
                    first = found
        if first is None:
            return
        time, link, part, elastic, normal, drift = first
        self._advance(body, time, drift)
        if part[0] in self._links:
            self._advance(part[0], time)
        if elastic > 0.0:
            self._set_restitution((body, link), elastic)
            self._set_restitution(part, 1.0)
        if part[0] in self._planes:
            self._find_corners(body, normal)

    def _find_box(self, body: int) -> tuple[Vector3, Vector3]:
        lows, highs = zip(*(pybullet.getAABB(body, link, self._client)
                            for link in self._links[body]), strict=True)
        return tuple(map(min, *lows, lows[0])), tuple(map(max, *highs, highs[0]))

    def _find_impact(self, body: int, linear: Vector3, angular: Vector3, point: tuple, dt: float
                ) -> tuple[float, int, _LinkId, float, Vector3, Vector3] | None:
        """When a point strikes (s from now), its link, what it strikes, the restitution, the normal
        and how fast that moves which is not put elsewhere itself; None where it does not within the
        step."""
        other = point[2]
        speed, drift = (
            self._compute_closing_speed(body, linear, angular, point[5], point[7]),
            (0.0, 0.0, 0.0),
        )
        if other in self._links:
            twist = pybullet.getBaseVelocity(other, self._client)
            speed -= self._compute_closing_speed(other, *twist, point[6], point[7])
        elif other in self._jointed:
            drift = self._compute_point_velocity((other, point[4]), point[6])
            speed += _dot(drift, point[7])
        if speed < _SLOWEST or point[8] < -_PENETRATION:
            return None
        bounces = [self._bounce[part] for part in ((body, point[3]), (other, point[4]))
                   if part in self._bounce]
        elastic = min((e for e, _ in bounces), default=0.0)
        if speed < min((least for _, least in bounces), default=0.0):
            elastic = 0.0
        time = (point[8] + _PENETRATION) / speed
        if time >= _STEP_MARGIN * dt:
            return None
        return time, point[3], (other, point[4]), elastic, point[7], drift

    def _compute_closing_speed(self, body: int, linear: Vector3, angular: Vector3, point: Vector3,
                 normal: Vector3) -> float:
        """Speed of a body's point against a normal, m/s."""
        centre = pybullet.getBasePositionAndOrientation(body, self._client)[0]
        return -_dot(add(linear, cross(angular, subtract(point, centre))), normal)

    def _compute_point_velocity(self, part: _LinkId, point: Vector3) -> Vector3:
        """Of a point of a link of a body with joints, m/s."""
        body, link = part
        if link < 0:
            centre = pybullet.getBasePositionAndOrientation(body, self._client)[0]
            linear, angular = pybullet.getBaseVelocity(body, self._client)
        else:
            state = pybullet.getLinkState(body, link, computeLinkVelocity=True,
                                          physicsClientId=self._client)
            centre, linear, angular = state[0], state[6], state[7]
        return add(linear, cross(angular, subtract(point, centre)))

    def _advance(self, body: int, time: float, drift: Vector3 = (0.0, 0.0, 0.0)) -> None:
        """Let a body fly on for a while, s, as seen from what moves at `drift`."""
        centre, quat = pybullet.getBasePositionAndOrientation(body, self._client)
        linear, angular = pybullet.getBaseVelocity(body, self._client)
        turned = normalise(multiply((*scale(angular, 0.5 * time), 1.0), quat))
        there = add(centre, scale(subtract(linear, drift), time))
        pybullet.resetBasePositionAndOrientation(body, there, turned, physicsClientId=self._client)
        pybullet.resetBaseVelocity(body, linear, angular, physicsClientId=self._client)

    def _find_corners(self, body: int, normal: Vector3) -> None:
        """Have Bullet find all corners that strike a plane together.

        It finds one corner a step there, the deepest, so that what falls flat would turn over that;
        and keeps those that it found. So it is shown the body tilted a little to all sides.
        """
        centre, quat = pybullet.getBasePositionAndOrientation(body, self._client)
        twist = pybullet.getBaseVelocity(body, self._client)
        one = cross(normal, (1.0, 0.0, 0.0) if abs(normal[0]) < 0.7 else (0.0, 1.0, 0.0))
        two = cross(normal, one)
        for k in range(_SIDES):
            side = 2.0 * math.pi * k / _SIDES
            axis = add(scale(one, math.cos(side)), scale(two, math.sin(side)))
            tilted = normalise(multiply((*scale(axis, 0.5 * _TILT), 1.0), quat))
            pybullet.resetBasePositionAndOrientation(body, centre, tilted,
                                                     physicsClientId=self._client)
            pybullet.performCollisionDetection(self._client)
        pybullet.resetBasePositionAndOrientation(body, centre, quat, physicsClientId=self._client)
        pybullet.resetBaseVelocity(body, *twist, physicsClientId=self._client)

    def _set_restitution(self, part: _LinkId, restitution: float) -> None:
        pybullet.changeDynamics(*part, restitution=restitution, physicsClientId=self._client)
        self._bouncing.append(part)
