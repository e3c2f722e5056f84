"""Cameras: lens, intrinsics, effects and the sensor that turns rendered views into frames."""

from .config import CameraConfig
from .intrinsics import CameraIntrinsics
from .sensor import CameraSensor, Frame

__all__ = ["CameraConfig", "CameraIntrinsics", "CameraSensor", "Frame"]
