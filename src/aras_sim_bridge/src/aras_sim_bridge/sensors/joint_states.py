"""Joint state sensor of libgazebo_ros_joint_state_publisher.so: positions and velocities."""

from __future__ import annotations

from dataclasses import dataclass

from aras_sim_bridge.sensors.base import PeriodicSensor


@dataclass(frozen=True)
class JointStateReading:
    """Positions (rad or m) and velocities (rad/s or m/s) of the joints in the plug-in's list."""

    stamp_ns: int
    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]


class JointStateSensor(PeriodicSensor[None]):
    """Sensor of exact joint positions and velocities; like the plug-in, it reports no efforts."""

    def _prepare(self) -> None:
        self._slots = [self.model.joint_names.index(name) for name in self.description.joints]

    def _measure(self, before: None, time_ns: int, seconds: float) -> JointStateReading:
        positions, velocities, _ = self.model.read_joints()
        return JointStateReading(time_ns, self.description.joints,
                            tuple(positions[slot] for slot in self._slots),
                            tuple(velocities[slot] for slot in self._slots))
