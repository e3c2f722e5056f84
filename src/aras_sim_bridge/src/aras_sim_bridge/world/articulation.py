"""Kinematic tree of a model with a fixed base, as arrays for joint_dynamics.py."""

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
from aras_visual_servo_base.poses import IDENTITY, Pose

_BODY = 50  # columns of a row of `bodies`
# rad/s or m/s: speed at which a joint without a velocity limit returns into its position limits
_RETURN_SPEED = 1.0


class Articulation:
    """Rigid bodies of a fixed-base model, one per moving joint.

    A body consists of the child link of a moving joint and all links that are fixed to it. The base
    consists of the root link and all links that are fixed to it.

    Attributes:
        names: moving joints; row k of the arrays belongs to joint names[k].
        bodies (n, 50): one row per moving joint. Columns 0:30 give the joint frame in the frame of
            the parent body: three (3, 3) matrices A, B, C for the rotation
            A + B cos(q) + C sin(q), then the origin (m). Columns 30:33 are the axis in the joint
            frame, 33 the mass (kg), 34:37 the first moments (kg m) and 37:43 the second moments of
            mass (kg m²; xx xy xz yy yz zz) in the joint frame about its origin, 43:47 the mass and
            first moments of the links that gravity acts on, 47:50 the axis in the parent's frame.
        base (50,): the same columns for the base, in the root frame.
        tree (n, 4): topology, see joint_dynamics.py.
        link_joint: index of the joint that moves each link; -1 for the links of the base.
    """

    def __init__(self, description: RobotDescription, names: Sequence[str]) -> None:
        self.names = tuple(names)
        number = {name: k for k, name in enumerate(self.names)}
        count = len(self.names)
        self.bodies, self.base = np.zeros((count, _BODY)), np.zeros(_BODY)
        self.tree = np.zeros((count, 4), dtype=np.int64)
        self.link_joint: dict[str, int] = {}
        children: dict[str, list] = {}
        for joint in description.joints.values():
            children.setdefault(joint.parent, []).append(joint)
        order: list[int] = []
        # link, index of the joint that moves it, pose of the link in that joint's frame
        pending: list[tuple[str, int, Pose]] = [(description.root, -1, IDENTITY)]
        while pending:
            name, mover, pose = pending.pop()
            self.link_joint[name] = mover
            link = description.links[name]
            if link.inertial is not None:
                row = self.base if mover < 0 else self.bodies[mover]
                _add_mass(row, link.inertial, pose, link.gravity)
            for joint in children.get(name, ()):
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
        """Write the pose `at` of the joint frame in the parent frame, and the axis."""
        rotation, u = at.matrix()[:3, :3], np.array(axis)
        along = np.outer(u, u)
        skew = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
        row = self.bodies[body]
        for k, part in enumerate((along, np.eye(3) - along, skew)):
            row[9 * k : 9 * k + 9] = (rotation @ part).ravel()
        row[27:30] = at.xyz
        row[30:33] = u
        row[47:50] = rotation @ u


def _add_mass(row: np.ndarray, inertial: Inertial, pose: Pose, gravity: bool) -> None:
    """Add the inertia of a link to the row of its body; `pose` is the link's frame in the joint's.
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
    row[37:43] += second[np.triu_indices(3)]
    if gravity:
        row[43] += inertial.mass
        row[44:47] += inertial.mass * centre


def make_joint_rows(
    description: RobotDescription, names: Sequence[str], tree: np.ndarray
) -> np.ndarray:
    """Return the (n, 11) array `joints` of joint_dynamics.py, without damping and friction.

    For each mimicking joint, the index of its leader is written to tree[:, 3].
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
        while joint.mimic is not None:  # ends: the reader rejects files whose mimics form a loop
            offset += ratio * joint.mimic.offset
            ratio *= joint.mimic.multiplier
            joint = description.joints[joint.mimic.joint]
        rows[k, RATIO], rows[k, OFFSET] = ratio, offset
        tree[k, 3] = number[joint.name]
    return rows
