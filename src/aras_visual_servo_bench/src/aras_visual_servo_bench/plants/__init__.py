"""Plants: simulated arms and free cameras with a common interface."""

from .base import JointReading, Plant

__all__ = ["JointReading", "Plant"]
