"""Look-up of models, links and joints by the names that Gazebo's clients use.

A link is named `model::link` or only `link`. If several models have a link of this name, `link`
means the link of the model that was spawned first. The same applies to joints.
"""

from __future__ import annotations

from aras_sim_bridge.description.types import LoopJoint
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Model
from aras_visual_servo_base.poses import IDENTITY, Pose, Twist, conjugate, rotate, subtract

WORLD_ALIASES = ("", "world", "map", "/map")


def find_link(simulation: Simulation, name: str) -> tuple[Model, str]:
    """Return the model of a link, and the link's name without the model.

    Raises:
        WorldError: the link does not exist.
    """
    found = _find_part(simulation, name, "links")
    if found is None:
        raise WorldError(f"link '{name}' does not exist; name it as model::link")
    return found


def find_joint(simulation: Simulation, name: str) -> tuple[Model, str]:
    """Return the model of a joint, and the joint's name without the model.

    Raises:
        WorldError: the joint does not exist or closes a kinematic loop.
    """
    found = _find_part(simulation, name, "joints")
    if found is None and find_loop_joint(simulation, name) is not None:
        raise WorldError(f"joint '{name}' closes a kinematic loop and can only be read; use "
                         "another joint of the loop")
    if found is None:
        raise WorldError(f"joint '{name}' does not exist; name it as model::joint or joint")
    return found


def find_loop_joint(simulation: Simulation, name: str) -> tuple[Model, LoopJoint] | None:
    """Return the model and the joint `name`, if this joint closes a kinematic loop.

    Return None otherwise.
    """
    for candidate in simulation.world.models.values():
        for loop in candidate.description.loops:
            if name in (loop.joint.name, candidate.get_scoped_name(loop.joint.name)):
                return candidate, loop
    return None


def _find_part(simulation: Simulation, name: str, kind: str) -> tuple[Model, str] | None:
    """Return the model of a link or joint, and the name of the part without the model.

    The first part that matches `name` is returned, or None if there is none. `kind` is "links" or
    "joints".
    """
    model_name, scope, plain = name.rpartition("::")
    for candidate in simulation.world.models.values():
        if scope and candidate.main_model.name != model_name:
            continue
        if plain and plain in getattr(candidate.description, kind):
            return candidate, plain
    return None


def find_frame(simulation: Simulation, name: str) -> tuple[Pose, Twist]:
    """Return the pose and twist of a reference frame, expressed in the world frame.

    `name` is the name of a model or a link, or means the world.

    Raises:
        WorldError: the reference frame does not exist.
    """
    if name in simulation.world.models:
        entity = simulation.world.models[name]
        root = entity.description.root
        return entity.link_pose(root), entity.link_twist(root)
    # As in Gazebo, the name 'world' means the world even if a link has this name.
    if name in WORLD_ALIASES:
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
    """Express a pose and a twist in a reference frame, as Gazebo does.

    The frame's twist is subtracted from that of the body. If the frame rotates and the body is not
    at its origin, this is not the exact relative velocity, but Gazebo computes it in this way.

    Args:
        pose, twist: pose and twist of a body in the world frame.
        frame, frame_twist: pose and twist of the reference frame in the world frame.
    """
    inverse = conjugate(frame.quat)
    linear = rotate(inverse, subtract(twist.linear, frame_twist.linear))
    angular = rotate(inverse, subtract(twist.angular, frame_twist.angular))
    return frame.inverse() @ pose, Twist(linear, angular)


def is_world(simulation: Simulation, name: str) -> bool:
    """Return whether the name of a reference frame refers to the world."""
    return name in WORLD_ALIASES and name not in simulation.world.models
