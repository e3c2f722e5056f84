"""A model (robot or object) in the World: its body in Bullet, its joints and its link frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.errors import UnknownLinkError
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.bullet_body import BulletBody
from aras_sim_bridge.world.model_joints import ModelJoints
from aras_visual_servo_base.poses import (
    Pose,
    Quaternion,
    Twist,
    Vector3,
    add,
    cross,
    rotate,
    subtract,
)


class Model:
    """A model that was spawned by `World.spawn`. A reset of the world does not replace this object.

    If no joint connects some links of a description to its root, they become a separate Model. The
    Model with the root is then the main model.

    Attributes:
        client: Bullet's client id.
        name: name of the model in the world.
        description: description from which the model was loaded.
        main_model: the main model of a separate part; otherwise the model itself.
        bodies: the model, followed by its separate parts if it is the main model.
        spawn_pose: world_T_root at the spawn.
        fixed_base: whether the root is fixed in the world.
        release: for a model that rests on the ground (see resting_base.py), function that must be
            called before its root is moved or pushed. None for other models.
        is_attached: whether a fixed joint of attachments.py connects a link to another model.
        is_disturbed: whether the model was pushed. The code that reads this attribute resets it.
        applied_forces: arguments of recent calls of `apply_force`, newest last. The code that reads
            them clears them.
        body: body of the model in Bullet.
        joints: moving joints. Their most used methods are also methods of the model.
    """

    def __init__(self, client: int, description: RobotDescription, name: str, pose: Pose,
                 joint_positions: Mapping[str, float], fixed_base: bool,
                 gravity: Vector3, on_move: Callable[..., None],
                 main_model: Model | None = None) -> None:
        """Load the model.

        `on_move(model, is_moved, has_new_positions)` is called when the model is changed between
        two steps. `is_moved` is True if the whole model was moved to another pose,
        `has_new_positions` if its joints were set to other positions. Both are False if its twist
        was set or a free model was pushed.
        """
        self.client = client
        self.name = name
        self.description = description
        self.main_model = self if main_model is None else main_model
        self.bodies = [self]
        if main_model is not None:
            main_model.bodies.append(self)
        self.spawn_pose = pose
        self.fixed_base = fixed_base
        self._spawn_positions = joint_positions
        self._on_move = on_move
        self.release: Callable[[], None] | None = None
        self.is_attached = False
        self.is_disturbed = False
        self.applied_forces: deque[tuple[str, Vector3, Vector3, Vector3]] = deque(maxlen=100)
        self.body = BulletBody(client, name, fixed_base)
        self.joints = ModelJoints(self.body, gravity)
        self.reload()
        self.read_joints = self.joints.read
        self.apply_effort = self.joints.apply_effort
        self.set_position = self.joints.set_position
        self.set_velocity_motor = self.joints.set_velocity_motor
        self.bound_speed = self.joints.bound_speed
        self.bias_efforts = self.joints.bias_efforts
        self.check_efforts = self.joints.check_efforts
        self.advance = self.joints.advance
        self.after_step = self.joints.after_step

    @property
    def body_id(self) -> int:
        """Bullet's body id, which changes with each load.

        Reading this property also copies the joint states to Bullet, so that Bullet can be queried.
        """
        self.joints.update_bullet()
        return self.body.body_id

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, in the order of all sequences of joint values."""
        return self.joints.names

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of all links in the order of the description; the root need not be first."""
        return tuple(self.description.links)

    def get_scoped_name(self, part: str) -> str:
        """Return the name of a link or joint with the name of its model in front: 'model::link'."""
        return f"{self.main_model.name}::{part}"

    @property
    def mass(self) -> float:
        """Mass of all links, kg."""
        return sum(one.inertial.mass for one in self.description.links.values() if one.inertial)

    def reload(self) -> None:
        """Load the model into an empty Bullet, in the state in which it was spawned."""
        self.body.load(self.description, self.spawn_pose)
        self._root_pose = self.spawn_pose
        self.joints.load(self.description, self._spawn_positions)
        self.joints.set_root(self.spawn_pose)

    def remove(self) -> None:
        """Remove the model from Bullet."""
        self.joints.remove_constraints()
        self.body.remove()

    def rebuild(self, description: RobotDescription) -> None:
        """Reload the model with a changed description, and continue from the present state.

        The links and joints must be the same; masses, limits and other parameters may differ. The
        body is loaded again and gets a new body id, because Bullet cannot move a centre of mass.
        """
        states = self.joints.read_states()
        pose, twist = self.link_state(self.description.root)
        self.remove()
        self.description = description
        self.reload()
        self.set_pose(pose)
        if not self.fixed_base:
            self.set_twist(twist)
        self.joints.restore(states)

    def set_fixed_base(self, fixed: bool) -> None:
        """Fix the root in the world or free it, and continue from the present state."""
        applied, pending = self.joints.applied_efforts, self.joints.pending_efforts
        self.fixed_base = self.body.fixed_base = fixed
        self.rebuild(self.description)
        self.joints.applied_efforts = applied
        for name, effort in zip(self.joint_names, pending, strict=True):
            self.apply_effort(name, effort)

    @property
    def needs_steps(self) -> bool:
        """Whether `before_step` must be called before each step of Bullet."""
        return bool(self.joint_names or self.body.weightless_link_masses)

    def before_step(self, dt: float) -> None:
        """Pass efforts and gravity compensation to Bullet; called by `World.step`."""
        if self.joints.names:
            self.joints.before_step(dt)
        for link, mass in self.body.weightless_link_masses.items():
            centre = self.link_pose(link).apply(self.body.inertial_poses[link].xyz)
            self._apply_force(link, tuple(-mass * g for g in self.joints.gravity), centre)

    def update_physics(self, gravity: Vector3) -> None:
        """Apply a changed time step or gravity; called by `World.set_physics`."""
        self.joints.gravity = gravity
        if self.fixed_base:
            self.joints.set_root(self.pose())
        elif self.joints.damping is not None:
            self.joints.damping.invalidate()

    def pose(self) -> Pose:
        """Return world_T_root, the pose of the root link's frame."""
        # The pose of a fixed base is stored, so Bullet need not be read.
        return self._root_pose if self.fixed_base else self.link_pose(self.description.root)

    def twist(self) -> Twist:
        """Return the twist of the root link's frame, in world axes."""
        return self.link_twist(self.description.root)

    def link_pose(self, name: str) -> Pose:
        """Return world_T_link, the pose of the link's URDF frame.

        A pose unpacks as position (x, y, z) and quaternion (x, y, z, w).

        Raises:
            WorldError: the model has no link of this name.
        """
        if self.joints.has_own_dynamics and name in self.body.links:
            return self.joints.space.link_pose(name)
        return self._read_com_pose(self.link_index(name)) @ self.body.inertial_poses[name].inverse()

    def link_twist(self, name: str) -> Twist:
        """Return the twist of a link's frame in world axes (m/s, rad/s)."""
        return self.link_state(name)[1]

    def link_state(self, name: str) -> tuple[Pose, Twist]:
        """Return the pose world_T_link of a link's frame, and its twist in world axes."""
        index = self.link_index(name)
        inertial = self.body.inertial_poses[name]
        if index == -1:
            com = self._read_com_pose(index)
            linear, angular = pybullet.getBaseVelocity(self.body_id, self.client)
        else:
            state = pybullet.getLinkState(self.body_id, index, True, True, self.client)
            com, linear, angular = Pose(state[0], state[1]), state[6], state[7]
        return _compute_frame_state(com, linear, angular, inertial)

    def link_states(self) -> dict[str, tuple[Pose, Twist]]:
        """Return the `link_state` of every link in the description's order; calls Bullet once."""
        names = [n for n in self.link_names if self.body.links[n] >= 0]
        indices = [self.body.links[n] for n in names]
        states = (pybullet.getLinkStates(self.body_id, indices, True, True, self.client) if names
                  else ())
        found = {
            n: _compute_frame_state(Pose(s[0], s[1]), s[6], s[7], self.body.inertial_poses[n])
            for n, s in zip(names, states, strict=True)
        }
        found[self.description.root] = self.link_state(self.description.root)
        return {n: found[n] for n in self.link_names}

    def read_link_frames(
        self, names: tuple[str, ...]
    ) -> tuple[Sequence[Vector3], Sequence[Quaternion]]:
        """Return positions and quaternions of several link frames at once.

        The root must not be among the links; `pose` returns its pose.
        """
        if self.joints.has_own_dynamics:
            return self.joints.space.link_frames(names)
        indices = [self.body.links[name] for name in names]
        states = pybullet.getLinkStates(self.body_id, indices, False, True, self.client)
        return [state[4] for state in states], [state[5] for state in states]

    @property
    def link_indices(self) -> Mapping[str, int]:
        """Bullet's index of each link by name; -1 is the root."""
        return MappingProxyType(self.body.links)

    def link_index(self, name: str) -> int:
        """Return Bullet's index of a link, -1 for the root; WorldError if it does not exist."""
        index = self.body.links.get(name)
        if index is None:
            raise UnknownLinkError(self.name, name, self.link_names)
        return index

    def find_body(self, link: str) -> Model | None:
        """Return the model or the separate part of it that has a link; None if there is none."""
        return next((body for body in self.bodies if link in body.body.links), None)

    def list_base_links(self) -> frozenset[int]:
        """Return Bullet's indices of the root and of all links that are fixed to it."""
        base = [self.description.root]
        for link in base:  # `base` grows during this loop
            base += [joint.child for joint in self.description.list_child_joints(link)
                     if not joint.is_movable]
        return frozenset(self.body.links[link] for link in base)

    def _read_com_pose(self, index: int) -> Pose:
        if index == -1:
            return Pose(*pybullet.getBasePositionAndOrientation(self.body_id, self.client))
        state = pybullet.getLinkState(self.body_id, index, False, True, self.client)
        return Pose(state[0], state[1])

    def set_pose(self, pose: Pose) -> None:
        """Move the whole model so that its root frame is at `pose`.

        The joint positions do not change.
        """
        if len(self.bodies) > 1:
            moved = pose @ self.pose().inverse()
            for part in self.bodies[1:]:
                part.set_pose(moved @ part.pose())
        self._release_base()
        self._root_pose = pose
        com = pose @ self.body.inertial_poses[self.description.root]
        pybullet.resetBasePositionAndOrientation(self.body_id, com.xyz, com.quat,
                                                 physicsClientId=self.client)
        if self.fixed_base:
            self.joints.set_root(pose)
        self._on_move(self, True)

    def set_twist(self, twist: Twist) -> None:
        """Set the twist of the root frame in world axes. All links move like one rigid body.

        Joint velocities become zero. A model with a fixed base is not moved.
        """
        for part in self.bodies[1:]:
            lever = subtract(part.pose().xyz, self.pose().xyz)
            part.set_twist(Twist(add(twist.linear, cross(twist.angular, lever)), twist.angular))
        self._release_base()
        self.joints.stop_joints()
        if self.fixed_base:
            return
        root = self.description.root
        arm = rotate(self.pose().quat, self.body.inertial_poses[root].xyz)
        linear = add(twist.linear, cross(twist.angular, arm))
        pybullet.resetBaseVelocity(self.body_id, linear, twist.angular,
                                   physicsClientId=self.client)
        self._on_move(self, False)

    def set_joint_positions(self, positions: dict[str, float]) -> None:
        """Set the positions (rad or m) of some joints, see ModelJoints.set_joint_positions."""
        self.joints.set_joint_positions(positions)
        self._on_move(self, False, True)

    def _release_base(self) -> None:
        if self.release is not None:
            self.release()

    def apply_force(self, link: str, force: Vector3, position: Vector3,
                    torque: Vector3 = (0.0, 0.0, 0.0)) -> None:
        """Apply a force (N) at a point and a torque (N m), all in the world, for one step."""
        self._apply_force(link, force, position, torque)
        self.applied_forces.append((link, force, position, torque))
        if not self.fixed_base:
            self._on_move(self, False)

    def _apply_force(self, link: str, force: Vector3, position: Vector3,
              torque: Vector3 = (0.0, 0.0, 0.0)) -> None:
        index = self.link_index(link)
        if self.release is not None and index in self.list_base_links():
            self._release_base()
        self.is_disturbed = True
        if self.joints.space is not None:
            self.joints.space.apply_force(link, force, position, torque)
        if self.joints.has_own_dynamics:
            return
        if any(force):
            pybullet.applyExternalForce(self.body_id, index, force, position,
                                        pybullet.WORLD_FRAME, physicsClientId=self.client)
        if any(torque):
            pybullet.applyExternalTorque(self.body_id, index, torque, pybullet.WORLD_FRAME,
                                         physicsClientId=self.client)


def _compute_frame_state(
    com: Pose, linear: tuple, angular: tuple, inertial: Pose
) -> tuple[Pose, Twist]:
    """Return pose and twist of a link frame in the world.

    Args:
        com: pose of the principal axes at the link's centre of mass in the world.
        linear, angular: velocity of the centre of mass, m/s, and angular velocity, rad/s.
        inertial: pose of the principal axes in the link frame.
    """
    pose = com @ inertial.inverse()
    lever = subtract(pose.xyz, com.xyz)
    return pose, Twist(add(linear, cross(angular, lever)), angular)
