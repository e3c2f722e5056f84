"""What the moving links of a model run into, as it stands now."""

from __future__ import annotations

from dataclasses import dataclass

from aras_sim_bridge.world.bullet import find_contacts, pybullet
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.reach import disable_distant_pairs
from aras_sim_bridge.world.world import World


@dataclass(frozen=True)
class Overlap:
    """A link of a model within a link of another one; depth: m, to which they are in each other."""

    link: str
    model: str
    other_link: str
    depth: float


def find_overlaps(world: World, model: Model, before_step: bool = False) -> list[Overlap]:
    """The links of a model that joints move and that touch something, the deepest first.

    Links of one model pass through each other here, as in Gazebo.

    Args:
        world: in which the model is. posed: it was put there and no step was made since; without,
            contacts are those of the last step.
    """
    if before_step:
        model.joints.update_bullet()
        # Contacts of an earlier posture would stay while boxes overlap; this makes all pairs anew.
        disable_distant_pairs(list(world.models.values()))
        pybullet.performCollisionDetection(physicsClientId=world.client)
    names = {index: name for name, index in model.link_indices.items()}
    others = {other.body_id: other for other in world.models.values()}
    still = model.list_base_links()
    found = []
    for link, body, other_link, numbers in find_contacts(model.body_id, world.client):
        depth = numbers[15]
        if link in still or depth <= 0.0:
            continue
        other = others[body]
        named = {index: name for name, index in other.link_indices.items()}
        found.append(Overlap(names[link], other.name, named[other_link], depth))
    return sorted(found, key=lambda one: -one.depth)
