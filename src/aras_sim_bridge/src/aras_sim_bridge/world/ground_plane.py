"""Description of Gazebo's ground plane."""

from aras_sim_bridge.description.gazebo_materials import COLOURS
from aras_sim_bridge.description.types import (
    Collision,
    Geometry,
    Link,
    RobotDescription,
    Visual,
)
from aras_visual_servo_base.urdf import ZERO


def make_ground_plane(name: str) -> RobotDescription:
    """Return the description of a grey plane z = 0, which is infinite but drawn 100 m wide."""
    plane = Geometry("plane", size=(100.0, 100.0, 0.0))
    link = Link("link", None, (Visual("visual", ZERO, ZERO, plane),),
                (Collision("collision", ZERO, ZERO, plane),), mu=100.0)
    return RobotDescription(name, "link", {"link": link}, {}, static=True,
                            colours={"link": COLOURS["Gazebo/Grey"]})
