"""Finding models, links and joints by the names that Gazebo's clients use.

A link is named `model::link`, or plainly `find_link` when that is enough (first hit in spawn
order).
"""

from __future__ import annotations

from aras_sim_bridge.description.types import LoopJoint
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Model
from aras_visual_servo_base.poses import IDENTITY, Pose, Twist, conjugate, rotate, subtract

WORLD_ALIASES = ("", "world", "map", "/map")


def find_link(simulation: Simulation, name: str) -> tuple[Model, str]:
    """Return (model, plain link name); raises WorldError naming the link."""
    found = _find_part(simulation, name, "links")
    if found is None:
        raise WorldError(f"link '{name}' does not exist; name it as model::link")
    return found


def find_joint(simulation: Simulation, name: str) -> tuple[Model, str]:
    """Return (model, plain joint name); raises WorldError naming the joint."""
    found = _find_part(simulation, name, "joints")
    if found is None and find_loop_joint(simulation, name) is not None:
        raise WorldError(f"joint '{name}' closes a chain of joints, and is only read; name another "
                         "joint of the chain")
    if found is None:
        raise WorldError(f"joint '{name}' does not exist; name it as model::joint or plainly")
    return found


def find_loop_joint(simulation: Simulation, name: str) -> tuple[Model, LoopJoint] | None:
    """Return (model, joint) where a name means a joint that closes a chain; None where it does
    not."""
    for candidate in simulation.world.models.values():
        for one in candidate.description.loops:
            if name in (one.joint.name, candidate.get_scoped_name(one.joint.name)):
                return candidate, one
    return None


def _find_part(simulation: Simulation, name: str, kind: str) -> tuple[Model, str] | None:
    """(model, plain name) of the first link or joint, in world order, that a name means."""
    model_name, scope, plain = name.rpartition("::")
    for candidate in simulation.world.models.values():
        if scope and candidate.main_model.name != model_name:
            continue
        if plain and plain in getattr(candidate.description, kind):
            return candidate, plain
    return None


def find_frame(simulation: Simulation, name: str) -> tuple[Pose, Twist]:
    """Return pose and twist in the world of the model or link that serves as reference frame.

    Raises:
        WorldError: naming the frame.
    """
    if name in simulation.world.models:
        entity = simulation.world.models[name]
        root = entity.description.root
        return entity.link_pose(root), entity.link_twist(root)
    if name in WORLD_ALIASES:  # also where a robot's root link is called 'world', as in Gazebo
        return IDENTITY, Twist()
    try:
        entity, plain = find_link(simulation, name)
    except WorldError:
        raise WorldError(
            f"reference frame '{name}' does not exist; give a model, model::link, or world"
        ) from None
    return entity.link_pose(plain), entity.link_twist(plain)


def express_in_frame(
    pose: Pose, twist: Twist, frame: Pose, frame_twist: Twist
) -> tuple[Pose, Twist]:
    """Return a pose in a frame, and the twist less the frame's in its axes (no lever arm)."""
    back = conjugate(frame.quat)
    linear = rotate(back, subtract(twist.linear, frame_twist.linear))
    angular = rotate(back, subtract(twist.angular, frame_twist.angular))
    return frame.inverse() @ pose, Twist(linear, angular)


def is_world(simulation: Simulation, name: str) -> bool:
    """Return whether a reference frame's name means the world and no entity."""
    return name in WORLD_ALIASES and name not in simulation.world.models
