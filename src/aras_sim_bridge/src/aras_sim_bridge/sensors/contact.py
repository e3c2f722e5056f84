"""Contact sensors: contact points and forces on selected collisions of a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.description.sensor_tags import is_same_collision
from aras_sim_bridge.sensors.base import PeriodicSensor
from aras_sim_bridge.world import Model
from aras_sim_bridge.world.bullet import find_contacts
from aras_visual_servo_base.poses import Vector3


@dataclass(frozen=True)
class ContactPoint:
    """Contact point of two collisions, in world coordinates.

    Attributes:
        position: position of the contact, m.
        normal: unit vector that points into the first collision.
        depth: penetration depth, m.
        force: force on the link of the first collision, N.
        torque: torque on this link about its centre of mass, N m.
    """

    position: Vector3
    normal: Vector3
    depth: float
    force: Vector3
    torque: Vector3


@dataclass(frozen=True)
class ContactReading:
    """All contacts of a sensor at one time.

    `contacts` maps a pair of collision names (`model::link::collision`) to the contact points of
    this pair. The first name is that of the sensor's collision.
    """

    stamp_ns: int
    contacts: dict[tuple[str, str], list[ContactPoint]]


class ContactSensor(PeriodicSensor[None]):
    """Contact sensor of libgazebo_ros_bumper.so; the forces are those of the last physics step.

    Bullet reports contacts for each link, not for each collision. Therefore all contacts of a link
    have the name of its first collision, and a sensor on any collision of the link reports all
    contacts of the link.
    """

    def _prepare(self) -> None:
        self._links = [
            name for name, link in self.model.description.links.items()
            if any(is_same_collision(own_name, collision.name) for collision in link.collisions
                   for own_name in self.description.collisions)
        ]

    def _measure(self, before: None, time_ns: int, seconds: float) -> ContactReading:
        model, others = self.model, {other.body_id: other for other in self._world.models.values()}
        own = {model.link_index(name): name for name in self._links}
        found: dict[tuple[str, str], list[ContactPoint]] = {}
        for link, body, other_link, numbers in find_contacts(model.body_id, model.client):
            depth = numbers[15]
            if link not in own or (depth < 0.0 and numbers[3] == 0.0):
                continue  # the links are close to each other, but do not touch
            other = others[body]
            names = {index: name for name, index in other.link_indices.items()}
            pair = (
                _find_collision_name(model, own[link]),
                _find_collision_name(other, names[other_link]),
            )
            found.setdefault(pair, []).append(self._make_contact_point(own[link], numbers))
        return ContactReading(time_ns, found)

    def _make_contact_point(self, link: str, numbers: tuple[float, ...]) -> ContactPoint:
        position = np.array(numbers[:3])
        forces = [numbers[i] * np.array(numbers[i + 1:i + 4]) for i in (3, 7, 11)]
        force = sum(forces)
        # Direction of the normal force on `link`: numbers[4:7], or its opposite if the force
        # numbers[3] is negative.
        normal = np.copysign(1.0, numbers[3]) * np.array(numbers[4:7])
        inertial = self.model.description.links[link].inertial
        pose = self.model.link_pose(link)
        centre = pose.xyz if inertial is None else pose.apply(inertial.origin_xyz)
        torque = np.cross(position - centre, force)
        return ContactPoint(tuple(position.tolist()), tuple(normal.tolist()), numbers[15],
                     tuple(force.tolist()), tuple(torque.tolist()))


def _find_collision_name(model: Model, link: str) -> str:
    """Return Gazebo's scoped name (model::link::collision) of the first collision of a link."""
    collisions = model.description.links[link].collisions
    return f"{model.get_scoped_name(link)}::{collisions[0].name if collisions else ''}"
