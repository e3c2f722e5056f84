"""The physics world: the only folder that calls Bullet's dynamics."""

from aras_sim_bridge.world.grasping import GraspFix
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.world import World
from aras_visual_servo_base.poses import Pose, Twist

__all__ = ["GraspFix", "Model", "Pose", "Twist", "World"]
