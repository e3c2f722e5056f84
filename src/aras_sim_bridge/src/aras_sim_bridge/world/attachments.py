"""Fixed joints that are added and removed between links of two models during the simulation.

They are used by the counterparts of the Gazebo plug-ins gazebo_ros_link_attacher and
gazebo_grasp_fix.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.poses import Pose

# Largest force (N) and torque (N m) that a fixed joint between two links transmits. Both exceed
# those of any motor of the simulated robots, but are small enough that the solver does not diverge
# when an attached object is caught in a wall.
_LARGEST_FORCE = 1e6


class LinkPair(NamedTuple):
    """Two links that are connected by a fixed joint, and the names of their models."""

    model: str
    link: str
    other_model: str
    other_link: str


class Attachments:
    """Fixed joints between the models of a world.

    Two attached links do not collide with each other, as in ODE. While a model is attached, Bullet
    steps it together with the model at the other end of the joint.
    """

    def __init__(self, client: int, models: Mapping[str, Model],
                 on_change: Callable[[], None]) -> None:
        """Create an empty set of joints; `on_change` is called after one is added or removed."""
        self._client, self._models, self._on_change = client, models, on_change
        self._frames: dict[LinkPair, Pose] = {}
        self._constraints: dict[LinkPair, int] = {}
        self._without_contacts: set[LinkPair] = set()

    def __bool__(self) -> bool:
        return bool(self._frames)

    def __contains__(self, ends: LinkPair) -> bool:
        return ends in self._frames

    def attach(self, ends: LinkPair, collides: bool = True) -> None:
        """Fix the second link at its present pose in the frame of the first link.

        Args:
            ends: links to connect.
            collides: whether the second link still collides with other bodies.

        Raises:
            WorldError: a model or link does not exist, or both links are the same.
        """
        first, second = self._find_links(ends)
        if first == second:
            raise WorldError(f"link '{ends.link}' of model '{ends.model}' cannot be attached to "
                             "itself; name two links")
        if ends in self._frames:
            return
        self._frames[ends] = (first[0].link_pose(ends.link).inverse()
                              @ second[0].link_pose(ends.other_link))
        if not collides:
            self._without_contacts.add(ends)
        self._update_models()
        self._on_change()

    def detach(self, ends: LinkPair) -> None:
        """Remove the joint between two links.

        Raises:
            WorldError: the links are not attached.
        """
        if ends not in self._frames:
            attached = ", ".join(f"{a}::{b} and {c}::{d}" for a, b, c, d in self._frames) or "none"
            raise WorldError(f"'{ends.model}::{ends.link}' and '{ends.other_model}::"
                             f"{ends.other_link}' are not attached; attached are: {attached}")
        self._forget(ends)
        self._update_models()
        self._on_change()

    def detach_model(self, model: Model) -> None:
        """Remove all joints of a model that is about to be deleted."""
        for ends in self._find_attachments(model):
            self._forget(ends)
        self._update_models()

    def clear(self) -> None:
        """Forget all fixed joints; called after Bullet was reset."""
        self._without_contacts.clear()
        self._frames.clear()
        self._constraints.clear()
        self._update_models()

    def suspend(self, model: Model) -> None:
        """Remove the joints of a model from Bullet before it is reloaded; `renew` restores them."""
        for ends in self._find_attachments(model):
            self._remove_constraint(ends)

    def renew(self) -> None:
        """Create the fixed joints that are missing in Bullet, for example after `suspend`."""
        for ends in self._frames:
            if ends not in self._constraints:
                self._make_constraint(ends)

    def disable_contacts(self) -> None:
        """Disable all contacts of the links that were attached with `collides=False`."""
        for ends in self._without_contacts:
            _, (second, index) = self._find_links(ends)
            pybullet.setCollisionFilterGroupMask(second.body_id, index, 0, 0,
                                                 physicsClientId=self._client)

    def _forget(self, ends: LinkPair) -> None:
        self._remove_constraint(ends)
        del self._frames[ends]
        self._without_contacts.discard(ends)

    def _find_attachments(self, model: Model) -> list[LinkPair]:
        return [one for one in self._frames if model in self._list_bodies(one)]

    def _list_bodies(self, ends: LinkPair) -> list[Model]:
        return [body for body, _ in self._find_links(ends)]

    def _find_links(self, ends: LinkPair) -> tuple[tuple[Model, int], tuple[Model, int]]:
        """Return the model and Bullet's link index of both links."""
        return (self._find_link(ends.model, ends.link),
                self._find_link(ends.other_model, ends.other_link))

    def _find_link(self, model: str, link: str) -> tuple[Model, int]:
        if model not in self._models:
            raise WorldError(f"model '{model}' does not exist; existing models: "
                             f"{', '.join(self._models) or 'none'}")
        found = self._models[model].find_body(link) or self._models[model]
        return found, found.link_index(link)

    def _update_models(self) -> None:
        attached = {id(body) for one in self._frames for body in self._list_bodies(one)}
        for model in self._models.values():
            model.is_attached = id(model) in attached

    def _make_constraint(self, ends: LinkPair) -> None:
        (first, index), (second, other) = self._find_links(ends)
        first_frame = first.body.inertial_poses[ends.link].inverse() @ self._frames[ends]
        second_frame = second.body.inertial_poses[ends.other_link].inverse()
        joint = pybullet.createConstraint(
            first.body_id, index, second.body_id, other, pybullet.JOINT_FIXED, (0.0, 0.0, 0.0),
            first_frame.xyz, second_frame.xyz, first_frame.quat, second_frame.quat,
            physicsClientId=self._client)
        pybullet.changeConstraint(joint, maxForce=_LARGEST_FORCE, physicsClientId=self._client)
        self._constraints[ends] = joint
        self._set_collision(ends, False)

    def _remove_constraint(self, ends: LinkPair) -> None:
        joint = self._constraints.pop(ends, None)
        if joint is not None:
            pybullet.removeConstraint(joint, physicsClientId=self._client)
            self._set_collision(ends, True)

    def _set_collision(self, ends: LinkPair, collide: bool) -> None:
        (first, index), (second, other) = self._find_links(ends)
        pybullet.setCollisionFilterPair(first.body_id, second.body_id, index, other, collide,
                                        physicsClientId=self._client)
