"""Topics of motion and force sensors, with the same message types as those of Gazebo's plug-ins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from gazebo_msgs.msg import ContactState
from genpy import Message
from geometry_msgs.msg import Quaternion, Vector3, Wrench
from roslib.message import get_message_class

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.camera.info import add_prefix
from aras_sim_bridge.ros.control.state_publisher import StatePublisher
from aras_sim_bridge.ros.conversions import to_pose, to_time, to_twist
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.sensors import (
    ContactReading,
    ImuReading,
    JointStateReading,
    PeriodicSensor,
    PoseReading,
    WrenchReading,
)
from aras_visual_servo_base.names import resolve_name


def _fill_pose(message: Message, reading: PoseReading, sensor: PeriodicSensor) -> None:
    message.child_frame_id = sensor.description.link
    message.pose.pose, message.twist.twist = to_pose(reading.pose), to_twist(reading.twist)
    _fill_variances(sensor, 7, message.pose.covariance, message.twist.covariance)


def _fill_imu(message: Message, reading: ImuReading, sensor: PeriodicSensor) -> None:
    message.orientation = Quaternion(*reading.orientation)
    message.angular_velocity = Vector3(*reading.angular_velocity)
    message.linear_acceleration = Vector3(*reading.linear_acceleration)
    _fill_variances(sensor, 4, message.orientation_covariance, message.angular_velocity_covariance,
               message.linear_acceleration_covariance)


def _fill_wrench(message: Message, reading: WrenchReading, _sensor: PeriodicSensor) -> None:
    message.wrench.force = Vector3(*reading.force)
    message.wrench.torque = Vector3(*reading.torque)


def _fill_contacts(message: Message, reading: ContactReading, _sensor: PeriodicSensor) -> None:
    stamp, count = to_time(reading.stamp_ns), len(reading.contacts)
    message.states = []
    for k, (names, points) in enumerate(reading.contacts.items()):
        wrenches = [Wrench(Vector3(*point.force), Vector3(*point.torque)) for point in points]
        total = np.array([[*point.force, *point.torque] for point in points]).sum(axis=0).tolist()
        message.states.append(ContactState(
            info=f"Debug:  i:({k}/{count})     my geom:{names[0]}   other geom:{names[1]}"
                 f"         time:{stamp.secs}.{stamp.nsecs:09d}\n",
            collision1_name=names[0], collision2_name=names[1], wrenches=wrenches,
            total_wrench=Wrench(Vector3(*total[:3]), Vector3(*total[3:])),
            contact_positions=[Vector3(*point.position) for point in points],
            contact_normals=[Vector3(*point.normal) for point in points],
            depths=[point.depth for point in points]))


def _fill_joint_states(
    message: Message, reading: JointStateReading, _sensor: PeriodicSensor
) -> None:
    message.name, message.position = list(reading.names), list(reading.positions)
    message.velocity = list(reading.velocities)


def _fill_variances(sensor: PeriodicSensor, step: int, *covariances: list[float]) -> None:
    """Write the noise variance to the diagonals of covariance matrices.

    Each covariance matrix is square and stored row by row in a flat list. `step` is the number of
    its columns plus 1, the distance between two diagonal elements in this list.
    """
    for covariance in covariances:
        covariance[::step] = [sensor.description.noise**2] * len(covariance[::step])


MESSAGES: dict[str, tuple[str, Callable[[Message, object, PeriodicSensor], None]]] = {
    "pose": ("nav_msgs/Odometry", _fill_pose),
    "imu": ("sensor_msgs/Imu", _fill_imu),
    "body_imu": ("sensor_msgs/Imu", _fill_imu),
    "wrench": ("geometry_msgs/WrenchStamped", _fill_wrench),
    "contact": ("gazebo_msgs/ContactsState", _fill_contacts),
    "joint_states": ("sensor_msgs/JointState", _fill_joint_states),
}


class SensorTopic(StatePublisher):
    """Topic of one sensor; the sensor measures only while the topic has subscribers."""

    def __init__(self, sensor: PeriodicSensor, thread: SimulationThread) -> None:
        """Advertise the topic.

        Raises:
            SimError: the package of the message type is not installed.
        """
        description = sensor.description
        namespace = description.namespace
        if namespace is None:
            namespace = sensor.model.main_model.name
        frame = description.frame or self._find_frame(sensor)
        frame_id = add_prefix(frame, namespace) if frame else ""
        name, write = MESSAGES[description.kind]
        message_type = get_message_class(name)
        if message_type is None:
            package = name.partition("/")[0].replace("_", "-")
            raise SimError(f"message type {name} is not installed; install python3-{package}")

        def fill(message: Message, reading: object) -> None:
            message.header.stamp, message.header.frame_id = to_time(reading.stamp_ns), frame_id
            write(message, reading, sensor)

        topic = resolve_name(namespace, description.topic)
        super().__init__(topic, message_type, 1, sensor, fill, thread)

    @staticmethod
    def _find_frame(sensor: PeriodicSensor) -> str:
        """Return the link whose axes the readings use if the plug-in specifies no frame."""
        description = sensor.description
        if description.wrench_frame == "parent":
            return sensor.model.description.joints[description.joint].parent
        return description.link
