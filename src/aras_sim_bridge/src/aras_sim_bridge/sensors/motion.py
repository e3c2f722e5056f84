"""Pose sensors and inertial measurement units (IMUs) on links."""

from __future__ import annotations

from dataclasses import dataclass

from aras_sim_bridge.description.sensor_tags import WORLDS
from aras_sim_bridge.sensors.base import PeriodicSensor
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
    """Pose and twist of a link frame, expressed in the reference frame of the sensor."""

    stamp_ns: int
    pose: Pose
    twist: Twist


@dataclass(frozen=True)
class ImuReading:
    """One reading of an IMU.

    `orientation` is relative to the world or to the orientation at the start. `angular_velocity`
    (rad/s) and `linear_acceleration` (m/s²) are expressed in the sensor frame.
    """

    stamp_ns: int
    orientation: Quaternion
    angular_velocity: Vector3
    linear_acceleration: Vector3


class PoseSensor(PeriodicSensor[None]):
    """Pose sensor of libgazebo_ros_p3d.so.

    If its reference frame is the world, its readings are bit-identical to those of
    /gazebo/link_states.
    """

    def _measure(self, before: None, time_ns: int, seconds: float) -> PoseReading:
        description = self.description
        pose, twist = self.model.link_state(description.link)
        if description.frame not in WORLDS:
            frame, frame_twist = self.model.link_state(description.frame)
            lever = subtract(pose.xyz, frame.xyz)
            inverse = conjugate(frame.quat)
            # Velocity that the link's origin would have if the link were fixed in the moving
            # reference frame.
            transport = add(frame_twist.linear, cross(frame_twist.angular, lever))
            twist = Twist(rotate(inverse, subtract(twist.linear, transport)),
                          rotate(inverse, subtract(twist.angular, frame_twist.angular)))
            pose = frame.inverse() @ pose
        xyz, rpy = description.offset
        if any(xyz) or any(rpy):
            turn = Pose.from_rpy((0.0, 0.0, 0.0), rpy).quat
            pose = Pose(add(pose.xyz, xyz), normalise(multiply(turn, pose.quat)))
        return PoseReading(time_ns, pose, Twist(*self._add_noise(*twist, time_ns)))


class Imu(PeriodicSensor[Vector3]):
    """IMU of libgazebo_ros_imu_sensor.so; at rest it measures g upwards, like a real IMU.

    The acceleration is an average over 1 / (sampling rate). The sampling rate may differ from the
    rate at which readings are published. If it is 0, the average is over one physics step.
    """

    def _prepare(self) -> None:
        self._link_T_imu = Pose.from_rpy(*self.description.pose)
        rate = self.description.sample_rate
        self._span_ns = round(1e9 / rate) if rate > 0.0 else 0
        self._start = self._read_motion()[0]

    def _read_state(self) -> Vector3:
        return self._read_motion()[1]

    def _read_motion(self) -> tuple[Quaternion, Vector3, Vector3]:
        """Return orientation, velocity and angular velocity of the sensor in world axes."""
        pose, twist = self.model.link_state(self.description.link)
        arm = rotate(pose.quat, self._link_T_imu.xyz)
        velocity = add(twist.linear, cross(twist.angular, arm))
        return (pose @ self._link_T_imu).quat, velocity, twist.angular

    def _sense_acceleration(self, acceleration: Vector3) -> Vector3:
        return subtract(acceleration, self._world.gravity)

    def _measure(self, before: Vector3, time_ns: int, seconds: float) -> ImuReading:
        quat, velocity, omega = self._read_motion()
        acceleration = self._sense_acceleration(scale(subtract(velocity, before), 1.0 / seconds))
        inverse = conjugate(quat)
        omega, acceleration = self._add_noise(
            rotate(inverse, omega), rotate(inverse, acceleration), time_ns
        )
        return ImuReading(time_ns, self._compute_orientation(quat), omega, acceleration)

    def _compute_orientation(self, quat: Quaternion) -> Quaternion:
        description = self.description
        if description.from_start:
            quat = normalise(multiply(conjugate(self._start), quat))
        if any(description.offset[1]):
            turn = Pose.from_rpy((0.0, 0.0, 0.0), description.offset[1]).quat
            quat = normalise(multiply(turn, quat))
        return quat


class BodyImu(Imu):
    """IMU of libgazebo_ros_imu.so; it measures the acceleration of the link without gravity."""

    def _sense_acceleration(self, acceleration: Vector3) -> Vector3:
        return acceleration
