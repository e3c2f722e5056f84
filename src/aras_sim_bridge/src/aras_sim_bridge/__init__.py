"""PyBullet simulation with Gazebo's ROS interface, also usable as a library without ROS.

The names in `__all__` are the public interface; those in `FIRST_PROJECT` are enough for a first
project. Each name is imported on first use.
"""

from typing import TYPE_CHECKING

from aras_visual_servo_base.lazy_imports import lazy_exports

if TYPE_CHECKING:
    from aras_visual_servo_base.poses import Pose as Pose

    from .camera.effects.base import Effect as Effect
    from .control.controllers.base import Controller as Controller
    from .control.controllers.gripper import GripperGoal as GripperGoal
    from .description.description_files import load_description as load_description
    from .description.world_file import load_world as load_world
    from .description.world_file import populate as populate
    from .errors import SimError as SimError
    from .simulation import Simulation as Simulation
    from .simulation import SimulationConfig as SimulationConfig
    from .world.world import World as World

_FIRST = {
    "Simulation": ".simulation",
    "SimulationConfig": ".simulation",
    "load_description": ".description.description_files",
    "Pose": "aras_visual_servo_base.poses",
}
_FURTHER = {
    "load_world": ".description.world_file",
    "populate": ".description.world_file",
    "World": ".world.world",
    "Controller": ".control.controllers.base",
    "GripperGoal": ".control.controllers.gripper",
    "Effect": ".camera.effects.base",
    "SimError": ".errors",
}
FIRST_PROJECT = tuple(_FIRST)
__all__ = [*_FIRST, *_FURTHER]
# Hide __getattr__ from type checkers. If they saw it, they would accept any name as an attribute of
# this module.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy_exports(__name__, {**_FIRST, **_FURTHER})
