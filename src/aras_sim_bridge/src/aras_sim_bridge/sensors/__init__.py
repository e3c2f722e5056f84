"""Sensors with rates in simulated time: poses, IMUs, wrenches, contacts and joint states."""

from .base import PeriodicSensor
from .contact import ContactPoint, ContactReading, ContactSensor
from .joint_states import JointStateReading, JointStateSensor
from .motion import BodyImu, Imu, ImuReading, PoseReading, PoseSensor
from .wrench import WrenchReading, WrenchSensor

__all__ = ["KINDS", "ContactPoint", "ContactReading", "ImuReading", "JointStateReading",
           "PeriodicSensor", "PoseReading", "WrenchReading"]  # fmt: skip

KINDS: dict[str, type[PeriodicSensor]] = {
    "pose": PoseSensor, "imu": Imu, "body_imu": BodyImu, "wrench": WrenchSensor,
    "contact": ContactSensor, "joint_states": JointStateSensor,
}
