"""State, forces and time steps of a fixed-base model in joint coordinates."""

from collections.abc import Sequence

import numpy as np

from aras_sim_bridge.description.inertia import inertia_tensor
from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.world import joint_dynamics
from aras_sim_bridge.world.fixed_base_tree import FixedBaseTree, make_joint_rows
from aras_sim_bridge.world.forward_kinematics import ForwardKinematics
from aras_sim_bridge.world.joint_dynamics import (
    BEFORE,
    DAMPING,
    FASTEST,
    FORCE,
    PUSH,
    RETURN,
    TARGET,
)
from aras_sim_bridge.world.mass_matrix import BIAS, compute_dynamics
from aras_visual_servo_base.poses import (
    IDENTITY,
    Pose,
    Vector3,
    add,
    conjugate,
    cross,
    rotate,
    skew,
    subtract,
)


class FixedBaseDynamics:
    """State and dynamics of one model's joints, in the arrays of mass_matrix.py.

    The joints are in the order of the constructor's argument `names`.

    Attributes:
        moving_links: names of the links that a joint moves.
        return_speeds (n,): speed at which each joint returns from beyond its stops, rad/s or m/s.
        state (3, n): positions (rad or m), velocities (rad/s or m/s) and efforts (N m or N). The
            caller sets them.
        previous_speeds (n,): velocities before the last step, rad/s or m/s.
        gravity (3,): gravity vector in the root's axes, m/s².
        tree, frames: arrays that are described in mass_matrix.py.
        arrays: all arguments of `joint_dynamics.advance` except dt.
    """

    def __init__(self, description: RobotDescription, names: Sequence[str]) -> None:
        count = len(names)
        tree = FixedBaseTree(description, names)
        self._link_joint = tree.link_joint
        self.moving_links = tuple(n for n, joint in tree.link_joint.items() if joint >= 0)
        self._joints = make_joint_rows(description, names, tree.tree)
        self._joints[:, DAMPING] = [description.joints[name].damping for name in names]
        self.return_speeds = self._joints[:, RETURN]
        self.state = np.zeros((3, count))
        self._wrenches = np.zeros((count, 6))
        self.gravity = np.zeros(3)
        self.tree, self.frames = tree.tree, np.zeros((count, 46))
        self._base = tree.base
        self._rows = np.zeros((9, count))
        self.previous_speeds = self._rows[BEFORE]
        self._matrices = np.zeros((3, count, count))
        self._modes = np.zeros(count, dtype=np.int64)
        self._arrays = (tree.bodies, tree.tree, self.state, self._wrenches, self.gravity,
                        self.frames, self._matrices, self._rows)
        self.arrays = (*self._arrays, self._joints, self._modes)
        self._root = IDENTITY
        self._links = ForwardKinematics(description, names)
        # Names of the last call of `link_frames`, and the rows of these links.
        self._frame_rows: tuple[tuple[str, ...], np.ndarray] = ((), np.zeros(0, np.int64))

    def set_root(self, root: Pose, gravity: Vector3) -> None:
        """Set the pose of the root, world_T_root, and the gravity vector in world axes (m/s²)."""
        self._root = root
        self._links.set_root(root)
        self.gravity[:] = rotate(conjugate(root.quat), gravity)

    def link_pose(self, name: str) -> Pose:
        """Return world_T_link, the pose of a link's frame."""
        origins, quaternions = self._links.compute_poses(self.state[0])
        row = self._links.row[name]
        return Pose(tuple(origins[row].tolist()), tuple(quaternions[row].tolist()))

    def link_frames(self, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (m, 3) and quaternions (m, 4) of the links' frames in the world."""
        if names != self._frame_rows[0]:
            self._frame_rows = names, np.array([self._links.row[name] for name in names], np.int64)
        origins, quaternions = self._links.compute_poses(self.state[0])
        rows = self._frame_rows[1]
        return origins.take(rows, axis=0), quaternions.take(rows, axis=0)

    def set_motor(self, slot: int, velocity: float, force: float) -> None:
        """Drive a joint at `velocity` (rad/s or m/s) with at most `force` (N m or N).

        If `velocity` is 0, the motor acts like Coulomb friction. `slot` is the index of the joint.
        """
        self._joints[slot, TARGET] = velocity
        self._joints[slot, FORCE] = force

    def read_motor(self, slot: int) -> tuple[float, float]:
        """Return the velocity (rad/s or m/s) and the force (N m or N) set by `set_motor`."""
        return self._joints.item(slot, TARGET), self._joints.item(slot, FORCE)

    def bound_speed(self, slot: int, fastest: float) -> None:
        """Limit the speed of the joint with the index `slot` to `fastest`, rad/s or m/s.

        The speed stays below this limit under any force; inf removes the limit.
        """
        self._joints[slot, FASTEST] = fastest

    def apply_force(self, link: str, force: Vector3, position: Vector3, torque: Vector3) -> None:
        """Apply a force (N) at a point and a torque (N m) in the next step, all in world axes."""
        body = self._link_joint[link]
        if body < 0:
            return  # a force on the fixed base has no effect on the joints
        root_q_world = conjugate(self._root.quat)
        root_force = rotate(root_q_world, force)
        lever = rotate(root_q_world, subtract(position, self._root.xyz))
        self._wrenches[body] += (
            *add(cross(lever, root_force), rotate(root_q_world, torque)),
            *root_force,
        )

    def advance(self, dt: float) -> int:
        """Make one step of `dt` s; return the index of a joint that diverged, or -1 if none did."""
        return joint_dynamics.advance(*self.arrays, dt)

    def compute_reactions(self, dt: float) -> list[float]:
        """Return the efforts of damping, springs and stops that act in a step of `dt` s.

        They are computed as in joint_dynamics.py. The step itself is made by Bullet.
        """
        joint_dynamics.compute_reactions(*self.arrays, dt)
        return self._rows[PUSH].tolist()

    def bias_efforts(self) -> list[float]:
        """Return the efforts of gravity, Coriolis and centrifugal forces, N m or N."""
        compute_dynamics(*self._arrays)
        return self._rows[BIAS].tolist()

    def mass_matrix(self) -> np.ndarray:
        """Return the joint-space inertia matrix (n, n), kg m² or kg.

        Joints that mimic others are treated as independent joints.
        """
        compute_dynamics(*self._arrays)
        return self._matrices[0].copy()

    def free_mass_matrix(self) -> np.ndarray:
        """Return the mass matrix (6 + n, 6 + n) that the model would have with a free base.

        The first six coordinates are the twist of the root, angular part first, in root axes. The
        others are the joint velocities.
        """
        mass, base = self.mass_matrix(), self._base
        matrix = np.zeros((6 + len(mass), 6 + len(mass)))
        matrix[:6, :6] = _spatial_inertia(base[33], base[34:37], base[37:43])
        matrix[6:, 6:] = mass
        for j, frame in enumerate(self.frames, 6):
            # Spatial inertia of all bodies that the joint moves.
            inertia = _spatial_inertia(frame[30], frame[31:34], frame[34:40])
            matrix[:6, j] = matrix[j, :6] = inertia @ frame[12:18]
            if self.tree[j - 6, 1] < 0:
                matrix[:6, :6] += inertia
        return matrix


def _spatial_inertia(mass: float, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the spatial inertia matrix (6, 6), angular part first.

    Args:
        mass: mass, kg.
        first: (3,) mass times centre of mass, kg m.
        second: (6,) inertia tensor about the origin (xx xy xz yy yz zz), kg m².
    """
    inertia = np.diag([mass] * 6)
    inertia[:3, :3], inertia[:3, 3:] = inertia_tensor(second), skew(first)
    inertia[3:, :3] = -skew(first)
    return inertia
