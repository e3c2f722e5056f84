"""Conversion of the links and joints of a model into kinematic trees with loop joints.

A simulator in joint coordinates needs trees. A model may consist of several trees that move
independently. In each closed kinematic chain, one joint (the loop joint) is replaced by a
constraint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from aras_sim_bridge.description.types import Link, LoopJoint
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.urdf import Joint

WORLD = "world"


@dataclass
class KinematicTree:
    """One articulated body: its links and joints in the model's order, and its loop joints."""

    root: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    loops: tuple[LoopJoint, ...] = ()


@dataclass(frozen=True)
class JointInModel:
    """A joint and the pose of its frame in the model.

    Attributes:
        joint: the joint; its fields `origin_xyz` and `origin_rpy` are not used.
        pose: pose of the joint's frame in the model.
        is_loop_cut: whether this joint is preferred as the loop joint of a closed chain.
        massless_link: name of the joint's child if it is a massless link that only connects this
            joint to the next one, otherwise '' (see `find_links_between`).
    """

    joint: Joint
    pose: Pose
    is_loop_cut: bool = False
    massless_link: str = ""


def find_links_between(joints: Sequence[JointInModel], links: Mapping[str, Link], where: str
                  ) -> tuple[dict[str, Link], dict[str, Pose]]:
    """Return a massless Link and its pose in the model for each `massless_link` of `joints`.

    Raises:
        DescriptionError: the model already has a link of this name.
    """
    for one in joints:
        if one.massless_link in links:
            raise DescriptionError(f"{where}, joint '{one.joint.name}': the simulator adds a link "
                                   f"'{one.massless_link}' for this joint; rename your link of "
                                   "the same name")
    found = [one for one in joints if one.massless_link]
    return ({one.massless_link: Link(one.massless_link, None) for one in found},
            {one.massless_link: one.pose for one in found})


def assemble(links: Mapping[str, Link], poses: Mapping[str, Pose], joints: Sequence[JointInModel],
             static: bool, where: str) -> list[KinematicTree]:
    """Return the kinematic trees of a model, starting with the tree of the model's first link.

    The root of a tree is the first of its links that are not the child of a joint. The frame of the
    first tree is the model's frame. All links of a static model form one tree, connected or not.

    Args:
        links: links by name, in the model's order.
        poses: poses of the links in the model, by name.
        joints: joints in the model's order.
        static: whether the model is fixed in the world.
        where: name of the model in messages.

    Raises:
        DescriptionError: a joint names a link that does not exist, or two joints have the same
            name.
    """
    names: set[str] = set()
    for one in joints:
        if one.joint.name in names:
            raise DescriptionError(f"{where}: two joints are named '{one.joint.name}'; rename one")
        names.add(one.joint.name)
        for end in (one.joint.parent, one.joint.child):
            if end not in links:
                raise DescriptionError(f"{where}, joint '{one.joint.name}': link '{end}' does not "
                                       "exist; correct the name")
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
    """Assignment of links to trees, and the joints between the links of the trees.

    Attributes:
        tree_of: name of the root of each link's tree, by the name of the link.
        edges: for each joint of the trees, by its name, whether it is reversed: parent and child
            are exchanged compared with the description.
        carried_links: root links of the other trees of a static model, which become fixed to the
            first root.
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
        """Build the tree of `root` from all links that joints connect to it.

        Joints from a parent in the tree to a new child are added first, and among them those
        without `is_loop_cut`. Joints whose child is in the tree and whose parent is new are added
        last, reversed.
        """
        self.tree_of[root] = root
        pending, reached = [root], {root}
        while pending:
            # Breadth-first search: `pending` grows during this loop.
            for link in pending:
                for joint in self._below.get(link, ()):
                    pending += self._add_link(joint, joint.child, root, False)
            reached.update(pending)
            pending = []
            for is_reversed in (False, True):
                for joint in (one.joint for one in self._joints):
                    start, end = joint.parent, joint.child
                    if is_reversed:
                        start, end = end, start
                    if not pending and start in reached:
                        pending = self._add_link(joint, end, root, is_reversed)

    def join(self, roots: Sequence[str]) -> None:
        """Merge all trees into one: fix the other `roots` to the first one."""
        self.carried_links = list(roots[1:])
        self.tree_of = dict.fromkeys(self.tree_of, roots[0])

    def _add_link(self, joint: Joint, link: str, root: str, is_reversed: bool) -> list[str]:
        """Add a link to the tree of `root`; return [link], or [] if it already has a tree."""
        if link in self.tree_of:
            return []
        self.tree_of[link] = root
        self.edges[joint.name] = is_reversed
        return [link]


def _make_tree(root: str, is_main: bool, all_links: Mapping[str, Link], poses: Mapping[str, Pose],
          joints: Sequence[JointInModel], span: _SpanningTrees) -> KinematicTree:
    links = {name: link for name, link in all_links.items() if span.tree_of[name] == root}
    # Pose of each link in the model's frame. The root of the main tree defines the model's frame,
    # so the pose of this root is the identity.
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
            # Insert a massless link at the joint's frame: the joint moves the massless link, and
            # the child is fixed to the massless link.
            frame_link = f"{joint.name}_frame"
            links[frame_link] = Link(frame_link, None)
            found[frame_link] = Joint(frame_link, "fixed", frame_link, child).with_pose(
                one.pose.inverse() @ poses[child]
            )
            child = frame_link
        at = one.pose if joint.is_movable else poses[child]
        found[joint.name] = replace(
            joint, parent=parent, child=child, axis=axis).with_pose(frames[parent].inverse() @ at)
    for name in span.carried_links if is_main else ():
        extra = f"{name}_stands"
        found[extra] = Joint(extra, "fixed", root, name).with_pose(
            frames[root].inverse() @ poses[name]
        )
    return KinematicTree(root, links, found, tuple(loops))


def compute_joint_position(joint: Joint, moved: Pose) -> float:
    """Return the position of a joint (rad or m).

    `moved` is the pose of the child's joint frame in the parent's; both coincide at position 0.
    """
    if joint.kind == "prismatic":
        return sum(a * x for a, x in zip(joint.axis, moved.xyz, strict=True))
    along = sum(a * x for a, x in zip(joint.axis, moved.quat, strict=False))
    return math.remainder(2.0 * math.atan2(along, moved.quat[3]), 2.0 * math.pi)
