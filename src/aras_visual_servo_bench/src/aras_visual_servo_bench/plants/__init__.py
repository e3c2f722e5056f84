"""What is servoed: plants with one interface, so that an experiment can exchange them."""

from .base import CameraReading, JointReading, Plant

__all__ = ["CameraReading", "JointReading", "Plant"]
