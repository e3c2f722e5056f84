"""Compiled forward kinematics of a tree with a fixed base: link poses from joint positions."""

from collections.abc import Sequence

import numpy as np

from aras_sim_bridge.description.types import RobotDescription
from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import IDENTITY, Pose


class ForwardKinematics:
    """Forward kinematics of all links of a model.

    Attributes:
        row: row of each link in the result of `compute_poses`, by name. The root has row 0, and
            each link follows its parent.
    """

    def __init__(self, description: RobotDescription, names: Sequence[str]) -> None:
        """Read the tree; `names` lists the moving joints in the order of the joint positions."""
        number = {name: k for k, name in enumerate(names)}
        self.row = {description.root: 0}
        tree, offsets, axes = [(-1, -1, 0)], [IDENTITY], [(0.0, 0.0, 1.0)]
        pending = [description.root]
        while pending:
            parent = pending.pop()
            for joint in description.list_child_joints(parent):
                self.row[joint.child] = len(tree)
                mover = number.get(joint.name, -1)
                tree.append((self.row[parent], mover, int(joint.kind == "prismatic")))
                offsets.append(joint.pose)
                axes.append(joint.axis if mover >= 0 else (0.0, 0.0, 1.0))
                pending.append(joint.child)
        self._tree = np.array(tree, np.int64)
        self._offsets = np.array([(*pose.xyz, *pose.quat) for pose in offsets])
        self._axes = np.array(axes, float)
        self._poses = np.empty((len(tree), 3)), np.empty((len(tree), 4))
        # Joint positions of the last call of `compute_poses`; None if its result is not valid.
        self._positions: bytes | None = None

    def set_root(self, root: Pose) -> None:
        """Set the pose of the root, world_T_root."""
        self._offsets[0] = (*root.xyz, *root.quat)
        self._positions = None

    def compute_poses(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the poses of all link frames in the world from joint positions (n,), rad or m.

        Returns:
            Origins (links, 3), m, and unit quaternions (x, y, z, w), (links, 4). They must not be
            changed; the next call overwrites them.
        """
        key = positions.tobytes()
        # Use the last result if possible, because cameras and listeners often read the poses at the
        # same joint positions.
        if key != self._positions:
            _compute_poses(self._tree, self._offsets, self._axes, positions, *self._poses)
            self._positions = key
        return self._poses


@jit("i8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,::1]", allocates=False)
def _compute_poses(tree, offsets, axes, positions, origins, quaternions):
    """Compute the poses of all links, see ForwardKinematics.compute_poses.

    Args:
        tree (links, 3): for each link, the row of its parent (-1 for the root), the index of the
            joint that moves it (-1 if none does), and whether this joint is prismatic.
        offsets (links, 7): pose of each joint frame at position 0 in the parent's frame.
        axes (links, 3): joint axes in the joint frames.
        positions (n,): joint positions, rad or m.
        origins, quaternions (links, 3), (links, 4): outputs.
    """
    for n in range(len(tree)):
        parent, joint = tree[n, 0], tree[n, 1]
        x, y, z = offsets[n, 0], offsets[n, 1], offsets[n, 2]
        a, b, c, d = offsets[n, 3], offsets[n, 4], offsets[n, 5], offsets[n, 6]
        if joint >= 0:
            q, u, v, w = positions[joint], axes[n, 0], axes[n, 1], axes[n, 2]
            if tree[n, 2] == 1:
                # A prismatic joint shifts the link along the joint axis, rotated to the parent's
                # axes, by the joint position.
                s, t, r = 2.0 * (b * w - c * v), 2.0 * (c * u - a * w), 2.0 * (a * v - b * u)
                x += q * (u + d * s + b * r - c * t)
                y += q * (v + d * t + c * s - a * r)
                z += q * (w + d * r + a * t - b * s)
            else:
                sine, e = np.sin(0.5 * q), np.cos(0.5 * q)
                u, v, w = sine * u, sine * v, sine * w
                a, b, c, d = (
                    d * u + a * e + b * w - c * v,
                    d * v - a * w + b * e + c * u,
                    d * w + a * v - b * u + c * e,
                    d * e - a * u - b * v - c * w,
                )
        if parent >= 0:
            i, j, k, h = (
                quaternions[parent, 0],
                quaternions[parent, 1],
                quaternions[parent, 2],
                quaternions[parent, 3],
            )
            s, t, r = 2.0 * (j * z - k * y), 2.0 * (k * x - i * z), 2.0 * (i * y - j * x)
            x, y, z = (
                origins[parent, 0] + x + h * s + j * r - k * t,
                origins[parent, 1] + y + h * t + k * s - i * r,
                origins[parent, 2] + z + h * r + i * t - j * s,
            )
            a, b, c, d = (
                h * a + i * d + j * c - k * b,
                h * b - i * c + j * d + k * a,
                h * c + i * b - j * a + k * d,
                h * d - i * a - j * b - k * c,
            )
        unit = 1.0 / np.sqrt(a * a + b * b + c * c + d * d)
        origins[n, 0], origins[n, 1], origins[n, 2] = x, y, z
        quaternions[n, 0], quaternions[n, 1], quaternions[n, 2], quaternions[n, 3] = (
            a * unit,
            b * unit,
            c * unit,
            d * unit,
        )
