"""Fixed joints between links of any two models, made and taken away while time passes.

The plug-ins gazebo_ros_link_attacher and gazebo_grasp_fix hold things in this way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.poses import Pose

# N and N m that a joint gives at most: more than any motor here, and little enough that a
# thing that is caught in a wall does not make the solver diverge.
_LARGEST_FORCE = 1e6


class AttachedLinks(NamedTuple):
    """The two links that a fixed joint connects, by their models' names."""

    model: str
    link: str
    other_model: str
    other_link: str


class Attachments:
    """The fixed joints of a world.

    Two links that are attached do not collide, as ODE has it of bodies that a joint connects. A
    model that is attached makes its steps in Bullet, together with what it holds.
    """

    def __init__(self, client: int, models: Mapping[str, Model],
                 on_change: Callable[[], None]) -> None:
        """`on_change` is called when a joint came or went."""
        self._client, self._models, self._on_change = client, models, on_change
        self._frames: dict[AttachedLinks, Pose] = {}
        self._constraints: dict[AttachedLinks, int] = {}
        self._without_contacts: set[AttachedLinks] = set()

    def __bool__(self) -> bool:
        return bool(self._frames)

    def __contains__(self, ends: AttachedLinks) -> bool:
        return ends in self._frames

    def attach(self, ends: AttachedLinks, collides: bool = True) -> None:
        """Hold the second link where it is now in the first one's frame.

        Args:
            collides: whether the second link touches anything meanwhile.

        Raises:
            WorldError: a model or link that does not exist, or twice the same link.
        """
        first, second = self._find_link(ends.model, ends.link), self._find_link(ends.other_model,
                                                                    ends.other_link)
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

    def detach(self, ends: AttachedLinks) -> None:
        """Let the second link go; WorldError where it is not held."""
        if ends not in self._frames:
            held = ", ".join(f"{a}::{b} and {c}::{d}" for a, b, c, d in self._frames) or "none"
            raise WorldError(f"'{ends.model}::{ends.link}' and '{ends.other_model}::"
                             f"{ends.other_link}' are not attached; attached are: {held}")
        self._forget(ends)
        self._update_models()
        self._on_change()

    def detach_model(self, model: Model) -> None:
        """A model goes: whatever is attached to it is free."""
        for ends in self._find_attachments(model):
            self._forget(ends)
        self._update_models()

    def clear(self) -> None:
        """Forget all of them: Bullet has none any more."""
        self._without_contacts.clear()
        self._frames.clear()
        self._constraints.clear()
        self._update_models()

    def suspend(self, model: Model) -> None:
        """A model is about to be loaded again: take its joints out of Bullet until `renew`."""
        for ends in self._find_attachments(model):
            self._remove_constraint(ends)

    def renew(self) -> None:
        """Give Bullet the joints that it does not have."""
        for ends in self._frames:
            if ends not in self._constraints:
                self._make_constraint(ends)

    def disable_contacts(self) -> None:
        """Keep Bullet from looking at links that touch nothing while they are held."""
        for ends in self._without_contacts:
            second, index = self._find_link(ends.other_model, ends.other_link)
            pybullet.setCollisionFilterGroupMask(second.body_id, index, 0, 0,
                                                 physicsClientId=self._client)

    def _forget(self, ends: AttachedLinks) -> None:
        self._remove_constraint(ends)
        del self._frames[ends]
        self._without_contacts.discard(ends)

    def _find_bodies(self, ends: AttachedLinks) -> tuple[Model, Model]:
        return self._find_link(ends.model, ends.link)[0], self._find_link(
            ends.other_model, ends.other_link
        )[0]

    def _find_attachments(self, model: Model) -> list[AttachedLinks]:
        return [one for one in self._frames if model in self._find_bodies(one)]

    def _find_link(self, model: str, link: str) -> tuple[Model, int]:
        if model not in self._models:
            raise WorldError(f"model '{model}' does not exist; there are: "
                             f"{', '.join(self._models) or 'none'}")
        bodies = self._models[model].bodies
        found = next((one for one in bodies if link in one.link_indices), bodies[0])
        return found, found.link_index(link)

    def _update_models(self) -> None:
        held = {id(body) for one in self._frames for body in self._find_bodies(one)}
        for model in self._models.values():
            model.is_attached = id(model) in held

    def _make_constraint(self, ends: AttachedLinks) -> None:
        (first, index), (second, other) = (self._find_link(ends.model, ends.link),
                                           self._find_link(ends.other_model, ends.other_link))
        own = first.body.inertial_poses[ends.link].inverse() @ self._frames[ends]
        theirs = second.body.inertial_poses[ends.other_link].inverse()
        joint = pybullet.createConstraint(
            first.body_id, index, second.body_id, other, pybullet.JOINT_FIXED, (0.0, 0.0, 0.0),
            own.xyz, theirs.xyz, own.quat, theirs.quat, physicsClientId=self._client)
        pybullet.changeConstraint(joint, maxForce=_LARGEST_FORCE, physicsClientId=self._client)
        self._constraints[ends] = joint
        self._set_collision(ends, False)

    def _remove_constraint(self, ends: AttachedLinks) -> None:
        joint = self._constraints.pop(ends, None)
        if joint is not None:
            pybullet.removeConstraint(joint, physicsClientId=self._client)
            self._set_collision(ends, True)

    def _set_collision(self, ends: AttachedLinks, collide: bool) -> None:
        (first, index), (second, other) = (self._find_link(ends.model, ends.link),
                                           self._find_link(ends.other_model, ends.other_link))
        pybullet.setCollisionFilterPair(first.body_id, second.body_id, index, other, collide,
                                        physicsClientId=self._client)
