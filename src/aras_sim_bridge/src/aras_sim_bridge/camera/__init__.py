"""Models of cameras: lens, intrinsics, image effects, and the sensor that delivers frames."""

from aras_visual_servo_base.lazy_imports import lazy_exports

_PLACES = {
    "CameraConfig": ".config", "CameraIntrinsics": ".intrinsics", "CameraSensor": ".sensor",
    "CameraReading": ".sensor",
}  # fmt: skip
__all__ = list(_PLACES)
__getattr__, __dir__ = lazy_exports(__name__, _PLACES)
