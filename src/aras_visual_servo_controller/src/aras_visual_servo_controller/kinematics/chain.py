"""Compiled forward kinematics and Jacobian of a joint chain.

The ROS node and the offline runner both use this code, so their results are bit-identical.
"""

from collections.abc import Mapping, Sequence
from math import cos, sin
from typing import NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import exponential, matrix_from_xyz_rpy
from aras_visual_servo_base.urdf import Joint

from .free_body_kinematics import compute_free_pose_and_jacobian

CHAIN_SIGNATURE = "i8[::1], i8[::1], b1[::1], f8[::1], f8[:,:,::1], f8[:,::1], i8[::1], f8[:,:,::1]"


class Chain(NamedTuple):
    """Joints between a base and a camera, and to a target that the arm moves.

    For a free-flying camera, `origins` has one entry and the other arrays of the joints are empty;
    see `from_free_body`.

    Attributes:
        order: (n,) indices of the joints, each after its parent.
        parents: (n,) index of each joint's parent joint; -1 for the base.
        is_prismatic: (n,) whether each joint is prismatic.
        signs: (n,) 1 if the joint moves the camera, -1 if it moves the target, 0 if it moves both.
        origins: (n, 4, 4) frame of each joint at position 0, in its parent's frame.
        axes: (n, 3) axis of each joint, in its own frame.
        end_joints: (2,) indices of the joints that carry the camera and the target; -1 for the
            base.
        tip_frames: (2, 4, 4) frames of the camera and the target, in the frames of those joints.
    """

    order: np.ndarray
    parents: np.ndarray
    is_prismatic: np.ndarray
    signs: np.ndarray
    origins: np.ndarray
    axes: np.ndarray
    end_joints: np.ndarray
    tip_frames: np.ndarray

    @classmethod
    def from_paths(
        cls, camera_path: Sequence[Joint], target_path: Sequence[Joint], names: Sequence[str],
        locked: Mapping[str, float],
    ) -> "Chain":
        """Construct the chain on the paths from the base to the camera and to the target.

        The chain has the joints `names`. The other joints are fixed at their positions in `locked`,
        or at 0.
        """
        count = len(names)
        chain = cls(
            np.zeros(count, np.int64), np.full(count, -1), np.zeros(count, bool), np.zeros(count),
            np.zeros((count, 4, 4)), np.zeros((count, 3)), np.full(2, -1), np.zeros((2, 4, 4)),
        )  # fmt: skip
        order: list[int] = []
        for end, path in enumerate((camera_path, target_path)):
            parent, parent_T_next = -1, np.eye(4)
            for joint in path:
                parent_T_next = parent_T_next @ matrix_from_xyz_rpy(
                    joint.origin_xyz, joint.origin_rpy
                )
                if joint.name not in names:
                    if joint.is_movable:
                        parent_T_next = parent_T_next @ _compute_joint_motion(
                            joint, locked.get(joint.name, 0.0)
                        )
                    continue
                slot = names.index(joint.name)
                if slot not in order:
                    order.append(slot)
                    chain.parents[slot], chain.origins[slot] = parent, parent_T_next
                    chain.is_prismatic[slot] = joint.kind == "prismatic"
                    chain.axes[slot] = joint.axis
                chain.signs[slot] += 1.0 if end == 0 else -1.0
                parent, parent_T_next = slot, np.eye(4)
            chain.end_joints[end], chain.tip_frames[end] = parent, parent_T_next
        chain.order[:] = order
        return chain

    @classmethod
    def from_free_body(cls, origin: np.ndarray, mounting: np.ndarray | None = None) -> "Chain":
        """Construct the chain of a camera whose pose is origin @ exponential(q) @ mounting.

        Args:
            origin: world_T_body (4, 4) at q (6,) = 0.
            mounting: body_T_camera (4, 4); None if the body is the camera.
        """
        tip = np.eye(4) if mounting is None else mounting
        return NO_JOINTS._replace(
            origins=np.array([origin], float), tip_frames=np.array([tip, np.eye(4)], float)
        )

    def compute_frames(self, q: np.ndarray) -> np.ndarray:
        """Compute rotation (9), origin (3) and axis (3) of each joint in the base frame, (n, 15).
        """
        frames = np.empty((len(self.order), 15))
        _compute_frames(*self[:3], *self[4:6], np.asarray(q, float), frames)
        return frames

    def compute_poses(self, positions: np.ndarray) -> np.ndarray:
        """Compute `target_T_camera` for joint positions (m, n); return an array (m, 4, 4)."""
        positions, poses = np.asarray(positions, float), np.empty((len(positions), 4, 4))
        _compute_poses(*self, positions, poses, np.empty((6, positions.shape[1])))
        return poses


NO_JOINTS = Chain.from_paths((), (), (), {})


def _compute_joint_motion(joint: Joint, position: float) -> np.ndarray:
    """Compute the motion (4, 4) of a joint at a position (rad or m), in the joint's own frame."""
    twist = np.zeros(6)
    along = slice(0, 3) if joint.kind == "prismatic" else slice(3, 6)
    twist[along] = position * np.array(joint.axis)
    return exponential(twist)


@jit("f8[::1], f8[:,:], f8[::1]", allocates=False)
def _transform_frame(frame, transform, out):
    """Compute frame @ transform and write it into `out`.

    A frame (12,) consists of the rotation matrix (9) and the origin (3); transform is (4, 4).
    """
    for i in range(3):
        x, y, z = frame[3 * i], frame[3 * i + 1], frame[3 * i + 2]
        for j in range(3):
            out[3 * i + j] = x * transform[0, j] + y * transform[1, j] + z * transform[2, j]
        out[9 + i] = frame[9 + i] + x * transform[0, 3] + y * transform[1, 3] + z * transform[2, 3]


@jit("i8[::1], i8[::1], b1[::1], f8[:,:,::1], f8[:,::1], f8[:], f8[:,::1]")
def _compute_frames(order, parents, is_prismatic, origins, axes, q, frames):
    """Write rotation (9), origin (3) and axis (3) of each joint, in the base frame, into `frames`.

    `frames` is an array (n, 15).
    """
    base, here = np.zeros(15), np.empty(15)
    base[0] = base[4] = base[8] = 1.0
    for j in order:
        parent, f = parents[j], frames[j]
        _transform_frame(base if parent < 0 else frames[parent], origins[j], here)
        x, y, z = axes[j, 0], axes[j, 1], axes[j, 2]
        for i in range(3):
            f[12 + i] = here[3 * i] * x + here[3 * i + 1] * y + here[3 * i + 2] * z
        if is_prismatic[j]:
            for i in range(9):
                f[i] = here[i]
            for i in range(3):
                f[9 + i] = here[9 + i] + q[j] * f[12 + i]
            continue
        c, s = cos(q[j]), sin(q[j])
        v = 1.0 - c
        for i in range(3):
            a, b, d = here[3 * i], here[3 * i + 1], here[3 * i + 2]
            f[3 * i] = (a * (c + v * x * x) + b * (v * x * y + s * z) + d * (v * x * z - s * y))
            f[3 * i + 1] = (a * (v * x * y - s * z) + b * (c + v * y * y) + d * (v * y * z + s * x))
            f[3 * i + 2] = (a * (v * x * z + s * y) + b * (v * y * z - s * x) + d * (c + v * z * z))
            f[9 + i] = here[9 + i]


@jit(f"{CHAIN_SIGNATURE}, f8[:], f8[:,::1], f8[:,::1]")
def compute_pose_and_jacobian(
    order, parents, is_prismatic, signs, origins, axes, end_joints, tip_frames, q, pose, jacobian
):
    """Write target_T_camera (4, 4) and its Jacobian (6, n) into `pose` and `jacobian`."""
    if len(order) == 0:
        compute_free_pose_and_jacobian(origins[0], tip_frames[0], q, pose, jacobian)
        return
    frames, base = np.empty((len(order), 15)), np.zeros(15)
    base[0] = base[4] = base[8] = 1.0
    _compute_frames(order, parents, is_prismatic, origins, axes, q, frames)
    camera, target = np.empty(15), np.empty(15)
    _transform_frame(base if end_joints[0] < 0 else frames[end_joints[0]], tip_frames[0], camera)
    _transform_frame(base if end_joints[1] < 0 else frames[end_joints[1]], tip_frames[1], target)
    # Pose of the camera in the target's frame.
    dx, dy, dz = camera[9] - target[9], camera[10] - target[10], camera[11] - target[11]
    for i in range(3):
        tx, ty, tz = target[i], target[3 + i], target[6 + i]
        for j in range(3):
            pose[i, j] = tx * camera[j] + ty * camera[3 + j] + tz * camera[6 + j]
        pose[i, 3] = tx * dx + ty * dy + tz * dz
        pose[3, i] = 0.0
    pose[3, 3] = 1.0
    for j in range(len(order)):
        f, sign = frames[j], signs[j]
        wx, wy, wz = sign * f[12], sign * f[13], sign * f[14]
        if is_prismatic[j]:
            vx, vy, vz = wx, wy, wz
            wx = wy = wz = 0.0
        else:
            dx, dy, dz = camera[9] - f[9], camera[10] - f[10], camera[11] - f[11]
            vx, vy, vz = wy * dz - wz * dy, wz * dx - wx * dz, wx * dy - wy * dx
        for i in range(3):
            cx, cy, cz = camera[i], camera[3 + i], camera[6 + i]
            jacobian[i, j] = cx * vx + cy * vy + cz * vz
            jacobian[3 + i, j] = cx * wx + cy * wy + cz * wz


@jit(f"{CHAIN_SIGNATURE}, f8[:,:], f8[:,:,::1], f8[:,::1]")
def _compute_poses(
    order, parents, is_prismatic, signs, origins, axes, end_joints, tip_frames, positions, poses,
    jacobian,
):
    """Write target_T_camera of m joint positions (m, n) into `poses` (m, 4, 4).

    `jacobian` (6, n) is working memory.
    """
    for m in range(len(poses)):
        compute_pose_and_jacobian(
            order, parents, is_prismatic, signs, origins, axes, end_joints, tip_frames,
            positions[m], poses[m], jacobian,
        )  # fmt: skip
