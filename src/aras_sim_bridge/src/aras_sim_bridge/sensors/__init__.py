"""Sensors of motion and forces: poses, IMUs and wrenches of joints, at rates of simulated time."""

from .base import RateSensor
from .motion import BodyImu, Imu, ImuReading, PoseReading, PoseSensor
from .wrench import WrenchReading, WrenchSensor

KINDS: dict[str, type[RateSensor]] = {
    "pose": PoseSensor, "imu": Imu, "body_imu": BodyImu, "wrench": WrenchSensor,
}

__all__ = [
    "KINDS", "BodyImu", "Imu", "ImuReading", "PoseReading", "PoseSensor", "RateSensor",
    "WrenchReading", "WrenchSensor",
]
