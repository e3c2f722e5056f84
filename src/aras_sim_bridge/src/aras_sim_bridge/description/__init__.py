"""Robot and model descriptions (URDF with <gazebo> tags, or SDF) as frozen dataclasses.

This package depends on neither ROS nor Bullet.

    robot = parse_urdf(xml)
    robot.joints["J1"].limits.effort
"""

from aras_visual_servo_base.lazy_imports import lazy_exports

_CAMERA_TYPES = (
    "CameraDescription",
    "CameraPlugin",
    "DepthDescription",
    "LensDescription",
    "PixelNoise",
)
_TYPES = (
    "ChannelNoise",
    "Collision",
    "ControlPlugin",
    "Geometry",
    "GripperDescription",
    "GraspFixPlugin",
    "Inertial",
    "Light",
    "Link",
    "RobotDescription",
    "SensorDescription",
    "Transmission",
    "Visual",
)
_PLACES = {
    **dict.fromkeys(_CAMERA_TYPES, ".camera_types"),
    **dict.fromkeys(_TYPES, ".types"),
    **dict.fromkeys(("Joint", "JointLimits", "Mimic", "SoftLimits"), "aras_visual_servo_base.urdf"),
    **dict.fromkeys(("SdfContent", "parse_sdf", "read_sdf"), ".sdf"),
    "parse_cameras": ".camera_tags",
    "parse_urdf": ".urdf",
}
__all__ = sorted(_PLACES)
__getattr__, __dir__ = lazy_exports(__name__, _PLACES)
