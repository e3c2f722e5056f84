"""Where a link is and how it moves: poses as `link_states` has them, and IMUs."""

from __future__ import annotations

from dataclasses import dataclass

from aras_sim_bridge.description import SensorDescription
from aras_sim_bridge.description.sensor_tags import WORLDS
from aras_sim_bridge.sensors.base import RateSensor
from aras_sim_bridge.world import Model, World
from aras_visual_servo_base.poses import (
    Pose,
    Quaternion,
    Twist,
    Vector3,
    add,
    conjugate,
    cross,
    multiply,
    normalise,
    rotate,
    scale,
    subtract,
)


@dataclass(frozen=True)
class PoseReading:
    """Pose and twist of a link's frame, in the axes of the sensor's frame."""

    stamp_ns: int
    pose: Pose
    twist: Twist


@dataclass(frozen=True)
class ImuReading:
    """orientation in the world, or from that at the start; angular_velocity (rad/s) and
    linear_acceleration (m/s²) in the sensor's axes."""

    stamp_ns: int
    orientation: Quaternion
    angular_velocity: Vector3
    linear_acceleration: Vector3


class PoseSensor(RateSensor[None]):
    """libgazebo_ros_p3d.so: in the world to the bit what `link_states` tells."""

    def _read_state(self) -> None:
        return None

    def _measure(self, before: None, time_ns: int, seconds: float) -> PoseReading:
        given = self.description
        pose, twist = self.model.link_state(given.link)
        if given.frame not in WORLDS:
            frame, moving = self.model.link_state(given.frame)
            lever = subtract(pose.xyz, frame.xyz)
            back = conjugate(frame.quat)
            # As a frame that turns sees it: what it carries along is no motion.
            carried = add(moving.linear, cross(moving.angular, lever))
            twist = Twist(rotate(back, subtract(twist.linear, carried)),
                          rotate(back, subtract(twist.angular, moving.angular)))
            pose = frame.inverse() @ pose
        xyz, rpy = given.offset
        if any(xyz) or any(rpy):
            turn = Pose.from_rpy((0.0, 0.0, 0.0), rpy).quat
            pose = Pose(add(pose.xyz, xyz), normalise(multiply(turn, pose.quat)))
        return PoseReading(time_ns, pose, Twist(*self._add_noise(*twist, time_ns)))


class Imu(RateSensor[Vector3]):
    """libgazebo_ros_imu_sensor.so: its acceleration is what a real one feels, g upwards at rest.

    The acceleration is the mean over a period of the sensor's own rate, which may be another one
    than that of its readings, or over one step.
    """

    def __init__(self, description: SensorDescription, model: Model, world: World, seed: int
                 ) -> None:
        super().__init__(description, model, world, seed)
        self._link_T_imu = Pose.from_rpy(*description.pose)
        rate = description.sample_rate
        self._span_ns = round(1e9 / rate) if rate > 0.0 else 0
        self._start = self._read_motion()[0]

    def _read_state(self) -> Vector3:
        return self._read_motion()[1]

    def _read_motion(self) -> tuple[Quaternion, Vector3, Vector3]:
        """Orientation, velocity and angular velocity of the sensor, world axes."""
        pose, twist = self.model.link_state(self.description.link)
        arm = rotate(pose.quat, self._link_T_imu.xyz)
        velocity = add(twist.linear, cross(twist.angular, arm))
        return (pose @ self._link_T_imu).quat, velocity, twist.angular

    def _sense_acceleration(self, acceleration: Vector3) -> Vector3:
        return subtract(acceleration, self._world.gravity)

    def _measure(self, before: Vector3, time_ns: int, seconds: float) -> ImuReading:
        quat, velocity, turning = self._read_motion()
        felt = self._sense_acceleration(scale(subtract(velocity, before), 1.0 / seconds))
        back = conjugate(quat)
        turning, felt = self._add_noise(rotate(back, turning), rotate(back, felt), time_ns)
        return ImuReading(time_ns, self._compute_orientation(quat), turning, felt)

    def _compute_orientation(self, quat: Quaternion) -> Quaternion:
        given = self.description
        if given.from_start:
            quat = normalise(multiply(conjugate(self._start), quat))
        if any(given.offset[1]):
            turn = Pose.from_rpy((0.0, 0.0, 0.0), given.offset[1]).quat
            quat = normalise(multiply(turn, quat))
        return quat


class BodyImu(Imu):
    """libgazebo_ros_imu.so: its acceleration is that of the link, without gravity."""

    def _sense_acceleration(self, acceleration: Vector3) -> Vector3:
        return acceleration
