"""What is servoed: plants with one interface, so that an experiment can exchange them."""

from .base import JointReading, Plant

__all__ = ["JointReading", "Plant"]
