"""Sensors with rates in simulated time: poses, IMUs, wrenches, contacts and joint states."""

from .base import PeriodicSensor
from .contact import ContactPoint, ContactReading, ContactSensor
from .joint_states import JointStateReading, JointStateSensor
from .motion import BodyImu, Imu, ImuReading, PoseReading, PoseSensor
from .wrench import WrenchReading, WrenchSensor

KINDS: dict[str, type[PeriodicSensor]] = {
    "pose": PoseSensor, "imu": Imu, "body_imu": BodyImu, "wrench": WrenchSensor,
    "contact": ContactSensor, "joint_states": JointStateSensor,
}

__all__ = [
    "KINDS",
    "BodyImu",
    "ContactReading",
    "ContactSensor",
    "Imu",
    "ImuReading",
    "JointStateReading",
    "JointStateSensor",
    "PoseReading",
    "PoseSensor",
    "PeriodicSensor",
    "ContactPoint",
    "WrenchReading",
    "WrenchSensor",
]
