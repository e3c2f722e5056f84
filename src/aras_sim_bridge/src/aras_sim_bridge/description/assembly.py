"""Links that stand in a model, and joints between them, as trees with joints that close loops.

A simulator in joint coordinates needs trees. A model may be several of them, which move freely; and
of the joints of a closed chain one is cut, to be held by a constraint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from aras_sim_bridge.description.types import Link, LoopJoint
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.urdf import Joint

WORLD = "world"


@dataclass
class KinematicTree:
    """One articulated body: its links and joints in the model's order; what closes its loops."""

    root: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    loops: tuple[LoopJoint, ...] = ()


@dataclass(frozen=True)
class JointInModel:
    """A joint whose frame stands at `pose` in the model; its `origin_*` mean nothing yet.

    cut: to be cut where it is in a closed chain, rather than another. between: its child, where
    that is a link without mass that only joins it to the next one (see `find_links_between`).
    """

    joint: Joint
    pose: Pose
    is_loop_cut: bool = False
    massless_link: str = ""


def find_links_between(joints: Sequence[JointInModel], links: Mapping[str, Link], where: str
                  ) -> tuple[dict[str, Link], dict[str, Pose]]:
    """Return the links without mass that join one of these joints to the next, and their poses.

    Raises:
        DescriptionError: a link of that name exists.
    """
    for one in joints:
        if one.massless_link in links:
            raise DescriptionError(f"{where}, joint '{one.joint.name}': it needs a link "
                                   f"'{one.massless_link}' of its own; rename the other one")
    found = [one for one in joints if one.massless_link]
    return ({one.massless_link: Link(one.massless_link, None) for one in found},
            {one.massless_link: one.pose for one in found})


def assemble(links: Mapping[str, Link], poses: Mapping[str, Pose], joints: Sequence[JointInModel],
             static: bool, where: str) -> list[KinematicTree]:
    """Return the trees of a model, first that of its first link.

    The root of a tree is the first link that is no joint's child, the first tree's frame the
    model's own. The links of a static model are one tree whatever joins them.

    Args:
        links, poses: by name, in the model's order; poses in the model. joints: in its order.
        where: names the model in messages.

    Raises:
        DescriptionError: a joint's end that does not exist, or two joints of one name.
    """
    names: set[str] = set()
    for one in joints:
        if one.joint.name in names:
            raise DescriptionError(f"{where}: two joints are named '{one.joint.name}'; rename one")
        names.add(one.joint.name)
        for end in (one.joint.parent, one.joint.child):
            if end not in links:
                raise DescriptionError(f"{where}, joint '{one.joint.name}': link '{end}' does not "
                                       "exist")
    children = {one.joint.child for one in joints}
    span = _SpanningTrees(joints)
    roots = []
    for name in (*(name for name in links if name not in children), *links):
        if name not in span.tree_of:
            roots.append(name)
            span.grow(name)
    first = span.tree_of[next(iter(links))]
    roots.sort(key=lambda root: root != first)
    if static:
        span.join(roots)
        roots = roots[:1]
    return [_make_tree(root, root == roots[0], links, poses, joints, span) for root in roots]


class _SpanningTrees:
    """Which link is in which tree, and which joints hold the trees together.

    tree_of: root of the tree, by link. edges: joints of the trees by name; True: turned round, so
    that its child carries its parent. stands: links that a static model's root carries.
    """

    def __init__(self, joints: Sequence[JointInModel]) -> None:
        self._joints = joints
        self._below: dict[str, list[Joint]] = {}
        for one in joints:
            if not one.is_loop_cut:
                self._below.setdefault(one.joint.parent, []).append(one.joint)
        self.tree_of: dict[str, str] = {}
        self.edges: dict[str, bool] = {}
        self.carried_links: list[str] = []

    def grow(self, root: str) -> None:
        """Add all that hangs together with `root`: downwards first, then by joints that are to be
        cut, then through other roots, whose joints are turned round."""
        self.tree_of[root] = root
        pending, reached = [root], {root}
        while pending:
            for link in pending:  # grows while it is read: nearest links first
                for joint in self._below.get(link, ()):
                    if self._is_new(joint.child):
                        pending.append(self._add(joint, joint.child, root, False))
            reached.update(pending)
            pending = []
            for one in self._joints:
                joint = one.joint
                if joint.parent in reached and self._is_new(joint.child):
                    pending = [self._add(joint, joint.child, root, False)]
                    break
            for one in self._joints if not pending else ():
                joint = one.joint
                if joint.child in reached and self._is_new(joint.parent):
                    pending = [self._add(joint, joint.parent, root, True)]
                    break

    def join(self, roots: Sequence[str]) -> None:
        """Let the first root carry the others: they are fixed to it."""
        self.carried_links = list(roots[1:])
        self.tree_of = dict.fromkeys(self.tree_of, roots[0])

    def _is_new(self, link: str) -> bool:
        return link not in self.tree_of

    def _add(self, joint: Joint, link: str, root: str, is_reversed: bool) -> str:
        self.tree_of[link] = root
        self.edges[joint.name] = is_reversed
        return link


def _make_tree(root: str, is_main: bool, all_links: Mapping[str, Link], poses: Mapping[str, Pose],
          joints: Sequence[JointInModel], span: _SpanningTrees) -> KinematicTree:
    links = {name: link for name, link in all_links.items() if span.tree_of[name] == root}
    # The main root's frame becomes the model's, so what hangs on it is placed in the model.
    frames = {**poses, root: Pose()} if is_main else poses
    found: dict[str, Joint] = {}
    loops: list[LoopJoint] = []

    for one in joints:
        joint = one.joint
        if span.tree_of[joint.parent] != root:
            continue
        if joint.name not in span.edges:
            loops.append(LoopJoint(
                joint, frames[joint.parent].inverse() @ one.pose,
                frames[joint.child].inverse() @ one.pose))
            continue
        parent, child, axis = joint.parent, joint.child, joint.axis
        if span.edges[joint.name]:
            parent, child, axis = child, parent, tuple(-part for part in axis)
        if joint.is_movable and one.pose != poses[child]:
            # The joint moves a massless link that stands on it, and that one carries the child.
            own = f"{joint.name}_frame"
            links[own] = Link(own, None)
            found[own] = Joint(own, "fixed", own, child).with_pose(
                one.pose.inverse() @ poses[child]
            )
            child = own
        at = one.pose if joint.is_movable else poses[child]
        found[joint.name] = replace(
            joint, parent=parent, child=child, axis=axis).with_pose(frames[parent].inverse() @ at)
    for name in span.carried_links if is_main else ():
        extra = f"{name}_stands"
        found[extra] = Joint(extra, "fixed", root, name).with_pose(
            frames[root].inverse() @ poses[name]
        )
    return KinematicTree(root, links, found, tuple(loops))
