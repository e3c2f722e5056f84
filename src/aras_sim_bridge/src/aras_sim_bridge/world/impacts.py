"""Impacts of fast free bodies: a body that would hit another within a step is moved to the contact.

Bullet predicts a contact only if the distance between the two bodies is below a fiftieth of the
body's size; for boxes, it predicts none. A body that crosses this distance in one step ends up
inside the other body, which pushes it out at a wrong speed: a ball of 20 mm that arrived at 5.9 m/s
left at 0.34 m/s. Moreover, Bullet's restitution is only correct if the two bodies touch at the
start of a step.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from aras_sim_bridge.world.bullet import compute_point_velocity, pybullet
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

# Penetration depth that Bullet allows at a contact, m.
_PENETRATION = 1e-5
# Smallest approach speed of an impact, m/s. Slower bodies roll, slide or come to rest, which Bullet
# computes correctly.
_SLOWEST = 0.05
# Number of steps ahead for which impacts are predicted. It exceeds 1, because gravity may
# accelerate a slow body during the step.
_STEP_MARGIN = 1.25
# A free body is checked against other bodies within the distance that it travels in this number of
# steps.
_SEARCH_MARGIN = 10
# After a search around a body has found no other body, it is not repeated for this number of steps.
_CLEAR_STEPS = 6
# Angle by which _find_corners tilts a body, rad: a third of the angle at which Bullet discards the
# contact points of corners.
_TILT = 5e-3
# Number of directions in which _find_corners tilts a body.
_SIDES = 9

_LinkId = tuple[int, int]  # Bullet's body id and link index


def _dot(a: Vector3, b: Vector3) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


class Impacts:
    """Detects the impacts of the free bodies of a world."""

    def __init__(self, client: int) -> None:
        self._client = client
        # links with collision shapes, by the body id of each free body
        self._links: dict[int, list[int]] = {}
        # For each free body, by its body id: number of steps in which no other body can be near.
        self._steps_without_check: dict[int, int] = {}
        self._planes: set[int] = set()
        self._jointed: set[int] = set()
        self._bounce: dict[_LinkId, tuple[float, float]] = {}
        self._bouncing: list[_LinkId] = []

    def set_models(self, models: Collection[Model]) -> None:
        """Read the shapes of all models; called after spawns, deletions and reloads."""
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
        """Check all free bodies for impacts in the next step.

        This is called after a free body was pushed or moved.
        """
        self._steps_without_check = dict.fromkeys(self._links, 0)

    def restore_restitution(self) -> None:
        """Reset the restitution of the bodies that bounced in the last step."""
        for body, link in self._bouncing:
            pybullet.changeDynamics(body, link, restitution=0.0, physicsClientId=self._client)
        self._bouncing = []

    def place_at_impact(self, body: int, linear: Vector3, angular: Vector3, dt: float) -> None:
        """Move a free body to its next point of impact if it hits another body within `dt` s.

        `linear` and `angular` are the body's velocity, m/s and rad/s.
        """
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
                found = self._find_impact(body, point, dt)
                if found is not None and (first is None or found[0] < first[0]):
                    first = found
        if first is None:
            return
        time, link, part, restitution, normal, drift = first
        self._advance(body, time, drift)
        if part[0] in self._links:
            self._advance(part[0], time)
        if restitution > 0.0:
            self._set_restitution((body, link), restitution)
            self._set_restitution(part, 1.0)
        if part[0] in self._planes:
            self._find_corners(body, normal)

    def _find_box(self, body: int) -> tuple[Vector3, Vector3]:
        lows, highs = zip(*(pybullet.getAABB(body, link, self._client)
                            for link in self._links[body]), strict=True)
        return tuple(map(min, *lows, lows[0])), tuple(map(max, *highs, highs[0]))

    def _find_impact(
        self, body: int, point: tuple, dt: float
    ) -> tuple[float, int, _LinkId, float, Vector3, Vector3] | None:
        """Predict the impact of a body at one of Bullet's closest points.

        Args:
            body: Bullet's body id.
            point: entry of pybullet.getClosestPoints for the body and another body.
            dt: time step, s.

        Returns:
            Time to the impact (s), link of the body that hits, body and link that are hit,
            coefficient of restitution, contact normal, and velocity (m/s) of the contact point on
            the body that is hit. This velocity is given only if that body has joints, otherwise it
            is 0. None if no impact is predicted.
        """
        other = point[2]
        # Speeds are in the direction of -normal, along which the body approaches the other one.
        speed = -_dot(compute_point_velocity(body, -1, point[5], self._client), point[7])
        drift = (0.0, 0.0, 0.0)
        if other in self._links:
            speed += _dot(compute_point_velocity(other, -1, point[6], self._client), point[7])
        elif other in self._jointed:
            drift = compute_point_velocity(other, point[4], point[6], self._client)
            speed += _dot(drift, point[7])
        if speed < _SLOWEST or point[8] < -_PENETRATION:
            return None
        bounces = [self._bounce[part] for part in ((body, point[3]), (other, point[4]))
                   if part in self._bounce]
        restitution = min((e for e, _ in bounces), default=0.0)
        if speed < min((least for _, least in bounces), default=0.0):
            restitution = 0.0
        time = (point[8] + _PENETRATION) / speed
        if time >= _STEP_MARGIN * dt:
            return None
        return time, point[3], (other, point[4]), restitution, point[7], drift

    def _advance(self, body: int, time: float, drift: Vector3 = (0.0, 0.0, 0.0)) -> None:
        """Move a body for `time` s with its velocity minus `drift` (m/s)."""
        centre, quat = pybullet.getBasePositionAndOrientation(body, self._client)
        linear, angular = pybullet.getBaseVelocity(body, self._client)
        orientation = normalise(multiply((*scale(angular, 0.5 * time), 1.0), quat))
        position = add(centre, scale(subtract(linear, drift), time))
        pybullet.resetBasePositionAndOrientation(
            body, position, orientation, physicsClientId=self._client
        )
        pybullet.resetBaseVelocity(body, linear, angular, physicsClientId=self._client)

    def _find_corners(self, body: int, normal: Vector3) -> None:
        """Make Bullet find all corners that hit a plane at the same time.

        In each step, Bullet only finds the deepest corner, so that a body that lands flat would
        start to turn about it. However, Bullet keeps the corners that it has found. Therefore the
        body is tilted slightly in several directions, and the contacts are computed for each of
        them.
        """
        centre, quat = pybullet.getBasePositionAndOrientation(body, self._client)
        twist = pybullet.getBaseVelocity(body, self._client)
        first_axis = cross(normal, (1.0, 0.0, 0.0) if abs(normal[0]) < 0.7 else (0.0, 1.0, 0.0))
        second_axis = cross(normal, first_axis)
        for k in range(_SIDES):
            side = 2.0 * math.pi * k / _SIDES
            axis = add(scale(first_axis, math.cos(side)), scale(second_axis, math.sin(side)))
            tilted = normalise(multiply((*scale(axis, 0.5 * _TILT), 1.0), quat))
            pybullet.resetBasePositionAndOrientation(body, centre, tilted,
                                                     physicsClientId=self._client)
            pybullet.performCollisionDetection(self._client)
        pybullet.resetBasePositionAndOrientation(body, centre, quat, physicsClientId=self._client)
        pybullet.resetBaseVelocity(body, *twist, physicsClientId=self._client)

    def _set_restitution(self, part: _LinkId, restitution: float) -> None:
        pybullet.changeDynamics(*part, restitution=restitution, physicsClientId=self._client)
        self._bouncing.append(part)
