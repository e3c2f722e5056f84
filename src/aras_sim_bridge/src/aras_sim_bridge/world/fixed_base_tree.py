"""Arrays of mass_matrix.py and joint_dynamics.py for the kinematic tree of a fixed-base model."""

from collections.abc import Sequence

import numpy as np

from aras_sim_bridge.description.inertia import inertia_tensor
from aras_sim_bridge.description.types import Inertial, RobotDescription, Vector3
from aras_sim_bridge.world.joint_dynamics import (
    FASTEST,
    LOWER,
    OFFSET,
    RATIO,
    REST,
    RETURN,
    STIFFNESS,
    UPPER,
)
from aras_visual_servo_base.poses import IDENTITY, Pose, skew

UPPER_TRIANGLE = np.triu_indices(3)
_BODY = 50  # number of columns of FixedBaseTree.bodies
# Largest speed at which a joint returns from beyond a position limit, if it has no velocity limit,
# rad/s or m/s.
_RETURN_SPEED = 1.0


class FixedBaseTree:
    """Rigid bodies of a model with a fixed base, one per moving joint.

    A body consists of the child link of a moving joint and all links that are fixed to it. The base
    consists of the root link and all links that are fixed to it. The joint frame is the frame in
    which the joint axis is given; it moves with the body.

    Attributes:
        names: names of the moving joints. Row k of each array belongs to the joint names[k].
        bodies (n, 50): data of the bodies, in the columns below. q is the joint position.
            0:27   rotation of the joint frame in the frame of the parent body,
                   A + B cos(q) + C sin(q): the (3, 3) matrices A, B and C
            27:30  origin of the joint frame at q = 0 in the frame of the parent body, m
            30:33  joint axis in the joint frame
            33     mass, kg
            34:37  mass times centre of mass in the joint frame, kg m
            37:43  inertia tensor about the origin of the joint frame, in its axes
                   (xx xy xz yy yz zz), kg m²
            43     mass of only those links that gravity acts on, kg
            44:47  this mass times its centre of mass in the joint frame, kg m
            47:50  joint axis in the frame of the parent body
        base (50,): the same columns for the base, in the root frame.
        tree (n, 4): topology, described in mass_matrix.py.
        link_joint: index of the joint that moves each link; -1 for the links of the base.
    """

    def __init__(self, description: RobotDescription, names: Sequence[str]) -> None:
        self.names = tuple(names)
        number = {name: k for k, name in enumerate(self.names)}
        count = len(self.names)
        self.bodies, self.base = np.zeros((count, _BODY)), np.zeros(_BODY)
        self.tree = np.zeros((count, 4), dtype=np.int64)
        self.link_joint: dict[str, int] = {}
        order: list[int] = []
        # Links still to be visited. An entry contains the link's name, the index of the joint that
        # moves the link, and the link's pose in the frame of this joint.
        pending: list[tuple[str, int, Pose]] = [(description.root, -1, IDENTITY)]
        while pending:
            name, mover, pose = pending.pop()
            self.link_joint[name] = mover
            link = description.links[name]
            if link.inertial is not None:
                row = self.base if mover < 0 else self.bodies[mover]
                _add_mass(row, link.inertial, pose, link.gravity)
            for joint in description.list_child_joints(name):
                at = pose @ joint.pose
                if joint.name not in number:
                    pending.append((joint.child, mover, at))
                    continue
                own = number[joint.name]
                order.append(own)
                self.tree[own, 1] = mover
                self.tree[own, 2] = joint.kind == "prismatic"
                self._set_frame(own, at, joint.axis)
                pending.append((joint.child, own, IDENTITY))
        self.tree[:, 0] = order
        self.tree[:, 3] = range(count)

    def _set_frame(self, body: int, at: Pose, axis: Vector3) -> None:
        """Write the joint axis and the pose of the joint frame to row `body` of `bodies`.

        `at` is the pose of the joint frame in the frame of the parent body, at joint position 0.
        """
        rotation, u = at.matrix()[:3, :3], np.array(axis)
        along = np.outer(u, u)
        row = self.bodies[body]
        for k, part in enumerate((along, np.eye(3) - along, skew(u))):
            row[9 * k : 9 * k + 9] = (rotation @ part).ravel()
        row[27:30] = at.xyz
        row[30:33] = u
        row[47:50] = rotation @ u


def _add_mass(row: np.ndarray, inertial: Inertial, pose: Pose, gravity: bool) -> None:
    """Add the mass and the inertia of a link to the row of its body in FixedBaseTree.bodies.

    Args:
        row: (50,) row of the body.
        inertial: inertial of the link.
        pose: joint_T_link, pose of the link in the joint frame of its body.
        gravity: whether gravity acts on the link.
    """
    frame = pose @ inertial.pose
    rotation = frame.matrix()[:3, :3]
    centre = np.array(frame.xyz)
    about_centre = rotation @ inertia_tensor(inertial.inertia) @ rotation.T
    second = about_centre + inertial.mass * (
        centre @ centre * np.eye(3) - np.outer(centre, centre)
    )
    row[33] += inertial.mass
    row[34:37] += inertial.mass * centre
    row[37:43] += second[UPPER_TRIANGLE]
    if gravity:
        row[43] += inertial.mass
        row[44:47] += inertial.mass * centre


def make_joint_rows(
    description: RobotDescription, names: Sequence[str], tree: np.ndarray
) -> np.ndarray:
    """Return the joint parameters (n, 11) that joint_dynamics.py reads from its array `joints`.

    Damping and friction stay 0. If joint k mimics another joint, the index of that joint is written
    to tree[k, 3].
    """
    rows = np.zeros((len(names), 11))
    rows[:, RATIO] = 1.0
    rows[:, LOWER], rows[:, UPPER], rows[:, FASTEST] = -np.inf, np.inf, np.inf
    number = {name: k for k, name in enumerate(names)}
    for k, name in enumerate(names):
        joint = description.joints[name]
        limits = joint.limits
        rows[k, RETURN] = _RETURN_SPEED
        rows[k, STIFFNESS], rows[k, REST] = joint.stiffness, joint.rest
        if limits is not None:
            rows[k, LOWER], rows[k, UPPER] = joint.stops
            if limits.velocity > 0.0:
                rows[k, RETURN] = limits.velocity
        ratio, offset = 1.0, 0.0
        # This loop ends, because the reader rejects descriptions in which joints mimic each other
        # in a circle.
        while joint.mimic is not None:
            offset += ratio * joint.mimic.offset
            ratio *= joint.mimic.multiplier
            joint = description.joints[joint.mimic.joint]
        rows[k, RATIO], rows[k, OFFSET] = ratio, offset
        tree[k, 3] = number[joint.name]
    return rows
