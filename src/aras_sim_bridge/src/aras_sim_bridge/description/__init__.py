"""What a robot is: URDF and its <gazebo> tags as frozen dataclasses. Knows neither ROS nor Bullet.

    robot = parse_urdf(xml)
    robot.joints["J1"].limits.effort
"""

from aras_sim_bridge.description.model import (
    CameraDescription,
    CameraPlugin,
    Collision,
    ControlPlugin,
    Geometry,
    Inertial,
    Joint,
    JointLimits,
    LensDescription,
    Link,
    Mimic,
    Noise,
    RobotDescription,
    SoftLimits,
    Transmission,
    Visual,
)
from aras_sim_bridge.description.urdf import parse_urdf

__all__ = [
    "CameraDescription",
    "CameraPlugin",
    "Collision",
    "ControlPlugin",
    "Geometry",
    "Inertial",
    "Joint",
    "JointLimits",
    "LensDescription",
    "Link",
    "Mimic",
    "Noise",
    "RobotDescription",
    "SoftLimits",
    "Transmission",
    "Visual",
    "parse_urdf",
]
