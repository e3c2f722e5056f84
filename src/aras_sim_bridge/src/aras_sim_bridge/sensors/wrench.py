"""Force/torque sensors in joints, by the balance of momentum of what hangs on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.description import SensorDescription
from aras_sim_bridge.description.inertia import inertia_tensor
from aras_sim_bridge.sensors.base import RateSensor
from aras_sim_bridge.world import Model, World
from aras_sim_bridge.world.bullet import find_contacts
from aras_visual_servo_base.poses import Pose, Vector3

Force = tuple[np.ndarray, np.ndarray]  # N at a point, m; world axes


@dataclass(frozen=True)
class WrenchReading:
    """Force (N) and torque (N m) about the joint's origin, in the axes that were asked for."""

    stamp_ns: int
    force: Vector3
    torque: Vector3


class WrenchSensor(RateSensor[np.ndarray]):
    """libgazebo_ros_ft_sensor.so: what the child does to the parent through the joint (unless the
    other way round is asked for), at rest the weight of all that hangs on it.

    Over one step, the momentum of all that hangs on the joint changes by the impulses of gravity,
    of what touches it, of wrenches that are applied to it, and of the joint; the last is the one
    that is looked for. The efforts of the joint's own drive are part of it.
    """

    def __init__(self, description: SensorDescription, model: Model, world: World, seed: int
                 ) -> None:
        super().__init__(description, model, world, seed)
        joints = model.description.joints
        self._joint = joints[description.joint]
        self._carried_links = [self._joint.child]
        for link in self._carried_links:
            self._carried_links += [
                joint.child for joint in joints.values() if joint.parent == link
            ]
        self._applied_forces: list[tuple[str, Vector3, Vector3, Vector3]] = []

    def _observe_step(self, last: bool) -> None:
        if last:
            self._applied_forces = [
                push for push in self.model.applied_forces if push[0] in self._carried_links
            ]

    def _read_state(self) -> np.ndarray:
        """Momentum and angular momentum (about the world's origin) of what hangs here, (6,)."""
        total = np.zeros(6)
        for mass, centre, velocity, spin in self._list_masses():
            total[:3] += mass * velocity
            total[3:] += np.cross(centre, mass * velocity) + spin
        return total

    def _list_masses(self) -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
        """Of each mass that hangs here: kg, centre, its velocity, angular momentum about it."""
        states = self.model.link_states()
        for name in self._carried_links:
            inertial = self.model.description.links[name].inertial
            if inertial is None:
                continue
            pose, twist = states[name]
            frame = (pose @ inertial.pose).matrix()
            centre, axes = frame[:3, 3], frame[:3, :3]
            turning = np.array(twist.angular)
            velocity = np.add(twist.linear, np.cross(turning, centre - pose.xyz))
            spin = axes @ inertia_tensor(inertial.inertia) @ axes.T @ turning
            yield inertial.mass, centre, velocity, spin

    def _list_forces(self) -> Iterator[Force]:
        """All that acts on what hangs here, the joint excepted."""
        links = self.model.description.links
        states = self.model.link_states()
        for name in self._carried_links:
            link = links[name]
            if link.inertial is not None and link.gravity:
                weight = link.inertial.mass * np.array(self._world.gravity)
                yield weight, np.array(states[name][0].apply(link.inertial.origin_xyz))
        for _, force, point, _ in self._applied_forces:
            yield np.array(force), np.array(point)
        if self.model.joints.has_own_dynamics:
            return  # nothing can touch it
        indices = {self.model.link_index(name) for name in self._carried_links}
        for link, _, _, numbers in find_contacts(self.model.body_id, self.model.client):
            if link in indices:
                force = sum(numbers[i] * np.array(numbers[i + 1:i + 4]) for i in (3, 7, 11))
                yield force, np.array(numbers[:3])

    def _measure(self, before: np.ndarray, time_ns: int, seconds: float) -> WrenchReading:
        wrench = (before - self._read_state()) / seconds
        for force, point in self._list_forces():
            wrench[:3] += force
            wrench[3:] += np.cross(point, force)
        for *_, torque in self._applied_forces:
            wrench[3:] += torque
        frame = self._compute_frame()
        wrench[3:] -= np.cross(frame[:3, 3], wrench[:3])
        if self.description.on_child:
            wrench = -wrench
        axes = frame[:3, :3]
        told = [tuple((axes.T @ part).tolist()) for part in (wrench[:3], wrench[3:])]
        return WrenchReading(time_ns, *self._add_noise(*told, time_ns))

    def _compute_frame(self) -> np.ndarray:
        """(4, 4), world: the joint's origin with the axes asked for."""
        given = self.description
        frame = self.model.link_state(self._joint.child)[0].matrix()
        if given.wrench_frame == "sensor":
            axes = frame @ Pose.from_rpy(*given.pose).matrix()
        else:
            link = self._joint.parent if given.wrench_frame == "parent" else given.link
            axes = self.model.link_state(link)[0].matrix()
        frame[:3, :3] = axes[:3, :3]
        return frame
