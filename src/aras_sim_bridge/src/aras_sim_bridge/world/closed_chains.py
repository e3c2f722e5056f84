"""Closed kinematic chains: joints that are not part of the tree become constraints of Bullet."""

import math
from collections.abc import Iterator

from aras_sim_bridge.description.kinematic_tree import compute_joint_position
from aras_sim_bridge.description.types import LoopJoint
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.bullet_body import BulletBody
from aras_visual_servo_base.poses import Pose, Vector3, scale

# Largest force of a constraint that closes a kinematic loop, N: large enough that the constraint
# does not yield.
_LARGEST_FORCE = 1e12
# Smallest distance between the origin of a loop-closing revolute joint and the two points on its
# axis that are constrained, m.
_SMALLEST_LENGTH = 1e-3


def close_loop(body: BulletBody, loop: LoopJoint) -> list[int]:
    """Connect the two links of a loop-closing joint by constraints; return Bullet's ids of them.

    A revolute joint becomes two constraints. Each of them makes a point on the joint axis of one
    link coincide with the same point of the other link. The two points are on both sides of the
    joint, far enough apart for an accurate solution.
    """
    joint = loop.joint
    parent, child = (body.inertial_poses[name].inverse() @ pose for name, pose in (
        (joint.parent, loop.in_parent), (joint.child, loop.in_child)))
    made = []
    for kind, axis, at in _list_constraints(loop):
        ends = [frame @ Pose(at) for frame in (parent, child)]
        made.append(pybullet.createConstraint(
            body.body_id, body.links[joint.parent], body.body_id, body.links[joint.child], kind,
            axis, ends[0].xyz, ends[1].xyz, ends[0].quat, ends[1].quat,
            physicsClientId=body.client))
        pybullet.changeConstraint(made[-1], maxForce=_LARGEST_FORCE, physicsClientId=body.client)
    return made


def _list_constraints(loop: LoopJoint) -> Iterator[tuple[int, Vector3, Vector3]]:
    """Yield the type of each constraint, and its axis and point in the joint's frame."""
    joint = loop.joint
    if joint.kind in ("revolute", "continuous"):
        half = max(
            math.hypot(*loop.in_parent.xyz), math.hypot(*loop.in_child.xyz), _SMALLEST_LENGTH
        )
        for side in (-half, half):
            yield pybullet.JOINT_POINT2POINT, (0.0, 0.0, 0.0), scale(joint.axis, side)
    elif joint.kind == "prismatic":
        yield pybullet.JOINT_PRISMATIC, joint.axis, (0.0, 0.0, 0.0)
    else:
        yield pybullet.JOINT_FIXED, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


def compute_position(loop: LoopJoint, parent: Pose, child: Pose) -> float:
    """Return the position of a loop-closing joint (rad or m) from the poses of its links."""
    return compute_joint_position(
        loop.joint, (parent @ loop.in_parent).inverse() @ child @ loop.in_child)
