"""The physics world: the only folder that calls Bullet's dynamics."""

from aras_sim_bridge.poses import Pose, Twist
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.world import World

__all__ = ["Model", "Pose", "Twist", "World"]
