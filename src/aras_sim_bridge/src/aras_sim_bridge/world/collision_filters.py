"""Collision filters, so that Bullet does not test pairs of links that can never touch.

Bullet tests all pairs of links whose bounding boxes overlap. Many of these pairs can never touch:
the boxes of adjacent links overlap, and the box of a ground plane overlaps everything. For an arm
above the ground, such tests take a tenth of the time of a step.
"""

import math
from collections.abc import Collection, Iterable
from typing import NamedTuple

from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.poses import (
    Quaternion,
    Vector3,
    add,
    multiply,
    rotate,
    scale,
)

# Margin of the boxes around a model's reach, m. It covers Bullet's collision margins and joint
# stops that yield slightly.
MARGIN = 0.1
# Bullet's default and static collision filter groups, and the mask of all groups
_DEFAULT_GROUP, _STATIC_GROUP, _ALL = 1, 2, -1
# collision filter groups, each for the links of one model
_OWN_GROUPS = tuple(1 << bit for bit in range(6, 30))


class BoundingBox(NamedTuple):
    """An axis-aligned box in the world: its lowest and highest corner, m."""

    low: Vector3
    high: Vector3

    def grow(self, margin: float) -> "BoundingBox":
        """Return the box enlarged by `margin` on every side."""
        (a, b, c), (d, e, f) = self
        return BoundingBox(
            (a - margin, b - margin, c - margin), (d + margin, e + margin, f + margin)
        )

    def gap(self, other: "BoundingBox") -> float:
        """Return the largest of the distances between two boxes along x, y and z, m.

        A distance is negative if the boxes overlap along this axis.
        """
        return max([max(c - b, a - d) for a, b, c, d in zip(*self, *other, strict=True)])


class HalfSpace(NamedTuple):
    """Half-space below a plane, given by a point of the plane and its normal."""

    point: Vector3
    normal: Vector3

    def gap(self, box: BoundingBox) -> float:
        """Return the height (m) of a box's lowest corner above the plane; negative if below."""
        corner = (low if n > 0.0 else high
                  for low, high, n in zip(*box, self.normal, strict=True))
        return sum(n * (c - p) for n, c, p in zip(self.normal, corner, self.point, strict=True))


def disable_distant_pairs(models: list[Model]) -> None:
    """Disable collisions between links of the same model, and between links that cannot meet.

    Call this after models were added, removed or moved, or after their joints changed.
    """
    fixed = [model for model in models if model.fixed_base]
    own = iter(_OWN_GROUPS)
    for model in models:
        if model.main_model is not model:
            _disable_own_contacts(model)
        # If there are more models than groups, the last models get no group. Bullet then tests
        # pairs of links of the same model without need.
        group = next(own, 0)
        reach = compute_reach(model) if model.fixed_base else None
        others = [other for other in fixed if other is not model]
        for link, index in model.link_indices.items():
            if index == -1 and model.fixed_base:
                continue
            meets = reach is None or (link in reach and any(
                solid.gap(reach[link].grow(MARGIN)) <= 0.0
                for other in others for solid in find_solids(other, (-1,))))
            left_out = group if meets else group | _STATIC_GROUP
            pybullet.setCollisionFilterGroupMask(model.body_id, index, group or _DEFAULT_GROUP,
                                                 _ALL & ~left_out, physicsClientId=model.client)


def _disable_own_contacts(part: Model) -> None:
    """Disable collisions of a separate part with the rest of its model, as in Gazebo.

    A separate part consists of links that no joint connects to the root of the model.
    """
    for other in part.main_model.bodies:
        for a in part.link_indices.values() if other is not part else ():
            for b in other.link_indices.values():
                pybullet.setCollisionFilterPair(part.body_id, other.body_id, a, b, 0,
                                                physicsClientId=part.client)


def find_solids(model: Model, links: Collection[int]) -> list[BoundingBox | HalfSpace]:
    """Return a box for the collision shapes of each link, or half-spaces for planes.

    `links` are Bullet's link indices.
    """
    found: list[BoundingBox | HalfSpace] = []
    body = model.body_id
    for name, index in model.link_indices.items():
        if index not in links:
            continue
        collisions = model.description.links[name].collisions
        planes = [collision for collision in collisions if collision.geometry.kind == "plane"]
        for plane in planes:
            pose = model.link_pose(name) @ plane.pose
            found.append(HalfSpace(pose.xyz, rotate(pose.quat, plane.geometry.normal)))
        if len(planes) < len(collisions):
            found.append(BoundingBox(*pybullet.getAABB(body, index, model.client)))
    return found


def compute_reach(model: Model) -> dict[str, BoundingBox]:
    """Return, for each link except the root, a box that the link's shapes never leave."""
    description = model.description
    boxes: dict[str, BoundingBox] = {}
    # Links still to be visited. An entry contains a link, the box of all positions of the link's
    # origin, and the link's orientation, which is None if a joint can rotate the link.
    root = model.pose()
    pending: list[tuple[str, BoundingBox, Quaternion | None]] = [
        (description.root, BoundingBox(root.xyz, root.xyz), root.quat)
    ]
    while pending:
        link, origins, quat = pending.pop()
        if link != description.root and description.links[link].collisions:
            boxes[link] = origins.grow(_compute_extent(model, link))
        for joint in description.list_child_joints(link):
            # displacement of the child link along the joint axis, m
            lower, upper = joint.stops if joint.kind == "prismatic" else (0.0, 0.0)
            if quat is None:
                reach = math.hypot(*joint.origin_xyz) + max(abs(lower), abs(upper))
                pending.append((joint.child, origins.grow(reach), None))
                continue
            offset = rotate(quat, joint.origin_xyz)
            below = multiply(quat, joint.pose.quat)
            ends = [add(offset, rotate(below, scale(joint.axis, q))) for q in (lower, upper)]
            moved = BoundingBox(*(tuple(v + pick(e) for v, e in zip(corner, zip(*ends, strict=True),
                                                                    strict=True))
                                  for corner, pick in zip(origins, (min, max), strict=True)))
            turns = joint.kind in ("revolute", "continuous")
            pending.append((joint.child, moved, None if turns else below))
    return boxes


def _compute_extent(model: Model, link: str) -> float:
    """Return an upper bound of the distance from a link's origin to any point of its shapes, m."""
    origin = model.link_pose(link).xyz
    low, high = pybullet.getAABB(model.body_id, model.link_index(link), model.client)
    return math.hypot(*(max(o - a, b - o) for o, a, b in zip(origin, low, high, strict=True)))


def can_meet(boxes: Iterable[BoundingBox], other: Model) -> bool:
    """Return whether an object in these boxes may ever touch any link of a fixed-base model."""
    found = [*find_solids(other, (-1,)), *compute_reach(other).values()]
    return any(solid.gap(box) <= 0.0 for box in boxes for solid in found)
