"""Force/torque sensors in joints.

The wrench in a joint is computed from the momentum of all links beyond the joint, that is, its
child link and the descendants of this link.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.description.inertia import inertia_tensor
from aras_sim_bridge.sensors.base import PeriodicSensor
from aras_sim_bridge.world.bullet import find_contacts
from aras_visual_servo_base.poses import Pose, Vector3

Force = tuple[np.ndarray, np.ndarray]  # force (N) and its point of application (m), in world axes


@dataclass(frozen=True)
class WrenchReading:
    """Force (N) and torque (N m) about the joint origin, in the sensor's measurement axes."""

    stamp_ns: int
    force: Vector3
    torque: Vector3


class WrenchSensor(PeriodicSensor[np.ndarray]):
    """Force/torque sensor of libgazebo_ros_ft_sensor.so.

    It measures the wrench that the child link exerts on the parent link through the joint, or, if
    the description says so, the opposite wrench. The carried links are the child link and all its
    descendants. At rest, the sensor measures their weight.

    During a step, the momentum of the carried links changes through gravity, contacts, applied
    wrenches and the joint. All except the wrench of the joint are known, so that this wrench
    follows. It includes the effort of the joint's drive.
    """

    def _prepare(self) -> None:
        joints = self.model.description.joints
        self._joint = joints[self.description.joint]
        self._carried_links = [self._joint.child]
        for link in self._carried_links:
            self._carried_links += [
                joint.child for joint in joints.values() if joint.parent == link
            ]
        self._applied_forces: list[tuple[str, Vector3, Vector3, Vector3]] = []

    def _observe_step(self, last: bool) -> None:
        if last:
            self._applied_forces = [
                force for force in self.model.applied_forces if force[0] in self._carried_links
            ]

    def _read_state(self) -> np.ndarray:
        """Return the linear and angular momentum (6,) of the carried links.

        The angular momentum is about the world origin.
        """
        total = np.zeros(6)
        for mass, centre, velocity, spin in self._list_masses():
            total[:3] += mass * velocity
            total[3:] += np.cross(centre, mass * velocity) + spin
        return total

    def _list_masses(self) -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
        """Yield mass (kg), centre of mass, its velocity, and spin of each carried link.

        The vectors are in world axes. The spin is the angular momentum about the centre of mass.
        """
        states = self.model.link_states()
        for name in self._carried_links:
            inertial = self.model.description.links[name].inertial
            if inertial is None:
                continue
            pose, twist = states[name]
            frame = (pose @ inertial.pose).matrix()
            centre, axes = frame[:3, 3], frame[:3, :3]
            omega = np.array(twist.angular)
            velocity = np.add(twist.linear, np.cross(omega, centre - pose.xyz))
            spin = axes @ inertia_tensor(inertial.inertia) @ axes.T @ omega
            yield inertial.mass, centre, velocity, spin

    def _list_forces(self) -> Iterator[Force]:
        """Yield all forces on the carried links except the force that the joint transmits."""
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
            return  # if the joints are simulated without Bullet, no contact is possible
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
        vectors = [tuple((axes.T @ part).tolist()) for part in (wrench[:3], wrench[3:])]
        return WrenchReading(time_ns, *self._add_noise(*vectors, time_ns))

    def _compute_frame(self) -> np.ndarray:
        """Return the measurement frame (4, 4) in the world, with its origin at the joint."""
        description = self.description
        frame = self.model.link_state(self._joint.child)[0].matrix()
        if description.wrench_frame == "sensor":
            axes = frame @ Pose.from_rpy(*description.pose).matrix()
        else:
            link = self._joint.parent if description.wrench_frame == "parent" else description.link
            axes = self.model.link_state(link)[0].matrix()
        frame[:3, :3] = axes[:3, :3]
        return frame
