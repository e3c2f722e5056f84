"""What a model is: URDF with its <gazebo> tags, or SDF, as frozen dataclasses.

Knows neither ROS nor Bullet.

    robot = parse_urdf(xml)
    robot.joints["J1"].limits.effort
"""

from aras_sim_bridge.description.sdf import SdfContent, parse_sdf, read_sdf
from aras_sim_bridge.description.types import (
    CameraDescription,
    CameraPlugin,
    ChannelNoise,
    Collision,
    ControlPlugin,
    DepthTopics,
    Geometry,
    GraspArm,
    GraspDescription,
    Inertial,
    LensDescription,
    Light,
    Link,
    Noise,
    RobotDescription,
    SensorDescription,
    Transmission,
    Visual,
)
from aras_sim_bridge.description.urdf import parse_cameras, parse_urdf
from aras_visual_servo_base.urdf import Joint, JointLimits, Mimic, SoftLimits

__all__ = [
    "CameraDescription",
    "CameraPlugin",
    "ChannelNoise",
    "Collision",
    "ControlPlugin",
    "DepthTopics",
    "Geometry",
    "GraspArm",
    "GraspDescription",
    "Inertial",
    "Joint",
    "JointLimits",
    "LensDescription",
    "Light",
    "Link",
    "Mimic",
    "Noise",
    "RobotDescription",
    "SdfContent",
    "SensorDescription",
    "SoftLimits",
    "Transmission",
    "Visual",
    "parse_cameras",
    "parse_sdf",
    "parse_urdf",
    "read_sdf",
]
