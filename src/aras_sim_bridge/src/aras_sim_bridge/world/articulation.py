"""A bolted model as a tree of bodies that its joints move: numbers for joint_dynamics.py."""

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

_BODY = 50  # numbers of a body
_RETURN_SPEED = 1.0  # rad/s or m/s, of a joint without a velocity limit back into its limits


class Articulation:
    """What one joint moves, with all that is fixed to it, is one body; the root stands still.

    Attributes:
        bodies (n, 50): of each joint, in the order of `names`: its frame in its parent body's at
            position 0 (0:27 three matrices for rotation = 0 + cos q * 9 + sin q * 18, 27:30
            origin), 30:33 axis, mass 33, first moment 34:37 and second 37:43 (xx xy xz yy yz zz) in
            the joint's frame, about its origin; 43:47 mass and first moment that gravity pulls at;
            47:50 axis in the parent's frame.
        base (50,): the same of all that no joint moves, in the root's frame.
        tree (n, 4): see joint_dynamics.py.
        link_joint: by link, the joint that moves it, by number; -1: none does.
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
        # link, the joint that moves it, its frame in that joint's
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
        """Put the joint's frame at `at` in the parent's."""
        turn, u = at.matrix()[:3, :3], np.array(axis)
        along = np.outer(u, u)
        skew = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
        row = self.bodies[body]
        for k, part in enumerate((along, np.eye(3) - along, skew)):
            row[9 * k : 9 * k + 9] = (turn @ part).ravel()
        row[27:30] = at.xyz
        row[30:33] = u
        row[47:50] = turn @ u


def _add_mass(row: np.ndarray, inertial: Inertial, pose: Pose, gravity: bool) -> None:
    """Add a link's inertia to the body's; `pose` is the link's frame in the joint's."""
    frame = pose @ inertial.pose
    turn = frame.matrix()[:3, :3]
    centre = np.array(frame.xyz)
    about_centre = turn @ inertia_tensor(inertial.inertia) @ turn.T
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
    """(n, 11) `joints` of joint_dynamics.py without damping and friction; mimicking ones enter
    their leaders into `tree`."""
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
        while joint.mimic is not None:  # a file whose mimics form a loop is refused
            offset += ratio * joint.mimic.offset
            ratio *= joint.mimic.multiplier
            joint = description.joints[joint.mimic.joint]
        rows[k, RATIO], rows[k, OFFSET] = ratio, offset
        tree[k, 3] = number[joint.name]
    return rows
