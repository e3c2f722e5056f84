"""Overlaps of the moving links of a model with other models, in the present state."""

from __future__ import annotations

from dataclasses import dataclass

from aras_sim_bridge.world.bullet import find_contacts, pybullet
from aras_sim_bridge.world.collision_filters import disable_distant_pairs
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.world import World


@dataclass(frozen=True)
class Overlap:
    """Overlap of a link of one model with a link of another model; `depth` is in m."""

    link: str
    model: str
    other_link: str
    depth: float


def find_overlaps(world: World, model: Model, before_step: bool = False) -> list[Overlap]:
    """Return the overlaps of the moving links of a model with other models, deepest first.

    As in Gazebo, links of the same model may overlap; this is not reported.

    Args:
        world: world that contains the model.
        model: model to check.
        before_step: True if no step was made since the model was moved. Contacts are then computed
            here; otherwise those of the last step are used.
    """
    if before_step:
        model.joints.update_bullet()
        # Bullet keeps old contacts of two links while their bounding boxes overlap. Setting the
        # collision filters removes these contacts, so that only present ones are found.
        disable_distant_pairs(list(world.models.values()))
        pybullet.performCollisionDetection(physicsClientId=world.client)
    names = {index: name for name, index in model.link_indices.items()}
    others = {other.body_id: other for other in world.models.values()}
    base_links = model.list_base_links()
    found = []
    for link, body, other_link, numbers in find_contacts(model.body_id, world.client):
        depth = numbers[15]
        if link in base_links or depth <= 0.0:
            continue
        other = others[body]
        other_names = {index: name for name, index in other.link_indices.items()}
        found.append(Overlap(names[link], other.name, other_names[other_link], depth))
    return sorted(found, key=lambda one: -one.depth)
