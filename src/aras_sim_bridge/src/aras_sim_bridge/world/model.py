"""Model: one robot or object in the World, its joints and its link frames."""

import math
import os
import tempfile
from collections.abc import Sequence
from types import MappingProxyType

from aras_sim_bridge.bullet import pybullet
from aras_sim_bridge.description.model import RobotDescription
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world import bullet_file
from aras_sim_bridge.world.damping import ViscousDamping
from aras_sim_bridge.world.poses import (
    IDENTITY,
    Pose,
    Twist,
    add,
    conjugate,
    cross,
    rotate,
    subtract,
)

DEFAULT_FRICTION = 1.0  # Gazebo's mu; Bullet multiplies the two bodies' values
_UNBOUNDED_VELOCITY = 1e9  # Bullet would cut joint velocities at 100 rad/s
_NO_LIMIT_FORCE = 1e18


class Model:
    """A spawned description. Made by `World.spawn`; stays the same object over resets.

    joint_names: moving joints (mimicking ones too) in file order; every sequence of joint values
    is in this order. link_names: all links in file order, root first or not.
    Efforts are set for one step and gone after it, as a simulator's are.
    """

    def __init__(self, client: int, description: RobotDescription, name: str, pose: Pose,
                 joint_positions: dict[str, float], fixed_base: bool,
                 gravity: tuple[float, float, float] = (0.0, 0.0, -9.8)) -> None:
        self.client = client
        self.gravity = gravity
        self.name = name
        self.description = description
        self.spawn_pose = pose
        self.spawn_positions = joint_positions
        self.fixed_base = fixed_base
        self._describe(description)
        self.body_id = -1
        self._load()

    def _describe(self, description: RobotDescription) -> None:
        """Note what the description says about joints and masses."""
        self.description = description
        self.joint_names: tuple[str, ...] = (
            () if description.static else description.moving_joints()
        )
        self.link_names: tuple[str, ...] = tuple(description.links)
        self._slot = {joint: i for i, joint in enumerate(self.joint_names)}
        joints = [description.joints[j] for j in self.joint_names]
        self.damping = [j.damping for j in joints]
        self.friction = [j.friction for j in joints]
        self._limits = [
            (j.limits.lower, j.limits.upper)
            if j.limits is not None and j.limits.lower is not None else None for j in joints
        ]
        self._bodies = bullet_file.with_massive_root(description)
        self._inertial_poses = {
            link.name: IDENTITY if link.inertial is None
            else bullet_file.principal_inertial(link.inertial)[0]
            for link in self._bodies.links.values()
        }
        self._weightless = {
            link.name: link.inertial.mass for link in self._bodies.links.values()
            if not link.gravity and link.inertial is not None
        }

    # ------------------------------------------------------------------ loading

    def _load(self) -> None:
        """Bring the model into Bullet at its spawn pose and configuration, at rest."""
        text = bullet_file.to_urdf(self._bodies, self.fixed_base)
        handle, path = tempfile.mkstemp(prefix="aras_sim_bridge_", suffix=".urdf")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            self.body_id = pybullet.loadURDF(
                path, self.spawn_pose.xyz, self.spawn_pose.quat, useFixedBase=self.fixed_base,
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=self.client)
        except pybullet.error as error:
            raise WorldError(
                f"model '{self.name}': Bullet cannot load it ({error}); check its mesh files"
            ) from None
        finally:
            os.unlink(path)
        self._index_links()
        self._set_dynamics()
        for joint, position in self.spawn_positions.items():
            pybullet.resetJointState(self.body_id, self._bullet_joint[self._slot[joint]], position,
                                     0.0, physicsClientId=self.client)
        self._gears = self._make_gears()
        self.pending_efforts = [0.0] * len(self.joint_names)
        self._applied = [0.0] * len(self.joint_names)
        self._dirty = False
        self._joint_cache: tuple[Sequence[float], Sequence[float]] | None = None
        self._damping = ViscousDamping(self)

    def reload(self) -> None:
        """As `_load`, into a Bullet that was emptied; for `World.reset_simulation`."""
        self._load()

    def rebuild(self, description: RobotDescription) -> None:
        """Go on from the present state as `description`: the same links and joints, other numbers.

        Bullet cannot move a centre of mass; so the body is loaded anew, with a new body id.
        """
        states = [pybullet.getJointState(self.body_id, i, self.client)[:2]
                  for i in self._bullet_joint]
        pose, twist = self.link_state(self.description.root)
        self.remove()
        self._describe(description)
        self._load()
        self.set_pose(pose)
        if not self.fixed_base:
            self.set_twist(twist)
        for index, (position, velocity) in zip(self._bullet_joint, states, strict=True):
            pybullet.resetJointState(self.body_id, index, position, velocity,
                                     physicsClientId=self.client)
        self._joint_cache = None

    def remove(self) -> None:
        """Take the body and its constraints out of Bullet."""
        for gear in self._gears:
            pybullet.removeConstraint(gear, physicsClientId=self.client)
        pybullet.removeBody(self.body_id, physicsClientId=self.client)

    def _index_links(self) -> None:
        links: dict[str, int] = {self.description.root: -1}
        joints: dict[str, int] = {}
        dof: dict[str, int] = {}
        for index in range(pybullet.getNumJoints(self.body_id, physicsClientId=self.client)):
            info = pybullet.getJointInfo(self.body_id, index, physicsClientId=self.client)
            joints[info[1].decode()] = index
            links[info[12].decode()] = index
            if info[3] >= 0:
                dof[info[1].decode()] = len(dof)
        missing = set(self.link_names) - set(links)
        if missing:
            raise WorldError(f"model '{self.name}': Bullet lost the links {sorted(missing)}")
        self._links = links
        self._bullet_joint = [joints[name] for name in self.joint_names]
        self.dof_order = [dof[name] for name in self.joint_names]

    def _set_dynamics(self) -> None:
        """No hidden forces: Bullet's motors, damping and velocity bound off, ours on."""
        client, body = self.client, self.body_id
        for name, index in self._links.items():
            link = self._bodies.links[name]
            settings = {
                "linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0,
                "maxJointVelocity": _UNBOUNDED_VELOCITY,
                "lateralFriction": DEFAULT_FRICTION if link.mu is None else link.mu,
                "restitution": 0.0, "rollingFriction": 0.0, "spinningFriction": 0.0,
            }
            if link.inertial is not None and not (index == -1 and self.fixed_base):
                # Bullet zeroes tensors that break the triangle inequality: say it again.
                settings["localInertiaDiagonal"] = bullet_file.principal_inertial(link.inertial)[1]
            pybullet.changeDynamics(body, index, physicsClientId=client, **settings)
        for index in self._bullet_joint:
            pybullet.changeDynamics(body, index, jointLimitForce=_NO_LIMIT_FORCE,
                                    physicsClientId=client)
        self.active_friction = list(self.friction)
        for i in range(len(self.joint_names)):
            self.restore_friction(i)

    def _make_gears(self) -> list[int]:
        gears = []
        for i, name in enumerate(self.joint_names):
            mimic = self.description.joints[name].mimic
            if mimic is None:
                continue
            leader = self._bullet_joint[self._slot[mimic.joint]]
            gear = pybullet.createConstraint(
                self.body_id, self._bullet_joint[i], self.body_id, leader, pybullet.JOINT_GEAR,
                (0, 0, 1), (0, 0, 0), (0, 0, 0), physicsClientId=self.client)
            pybullet.changeConstraint(gear, gearRatio=-mimic.multiplier, maxForce=1e12, erp=0.2,
                                      relativePositionTarget=mimic.offset,
                                      physicsClientId=self.client)
            gears.append(gear)
        return gears

    # ------------------------------------------------------------------ joints

    def read_joints(self) -> tuple[Sequence[float], Sequence[float], Sequence[float]]:
        """(positions, velocities, efforts) in `joint_names` order: rad or m, per s, N m or N.

        Efforts are those applied in the last step. The sequences belong to the model: read, don't
        write.

        Raises:
            WorldError: the simulation diverged (a position is not finite).
        """
        cache = self._joint_cache
        if cache is None:
            cache = self._refresh()
        return cache[0], cache[1], self._applied

    def _refresh(self) -> tuple[Sequence[float], Sequence[float]]:
        if not self.joint_names:
            self._joint_cache = ((), ())
            return self._joint_cache
        states = pybullet.getJointStates(self.body_id, self._bullet_joint, self.client)
        positions, velocities, _, _ = zip(*states, strict=True)
        if not math.isfinite(sum(positions) + sum(velocities)):
            bad = next((n for n, p, v in zip(self.joint_names, positions, velocities, strict=True)
                        if not math.isfinite(p + v)), "?")
            raise WorldError(
                f"model '{self.name}', joint '{bad}': the simulation diverged; lower the gains or "
                "the time step, then call reset_simulation"
            )
        self._joint_cache = (positions, velocities)
        return self._joint_cache

    def apply_effort(self, joint: str, effort: float) -> None:
        """Add `effort` (N m or N) to what acts on `joint` in the next step.

        Raises:
            WorldError: unknown joint.
        """
        slot = self._slot.get(joint)
        self.pending_efforts[self._require(joint) if slot is None else slot] += effort
        self._dirty = True

    def apply_efforts(self, efforts: Sequence[float]) -> None:
        """Add one effort a joint, in `joint_names` order."""
        pending = self.pending_efforts
        for i, effort in enumerate(efforts):
            pending[i] += effort
        self._dirty = True

    def set_position(self, joint: str, position: float) -> None:
        """Put `joint` there at rest, kinematically, as Gazebo's Joint::SetPosition does.

        For drives that do so every step.

        Raises:
            WorldError: unknown joint or a number that is not finite; nothing is changed then.
        """
        self._place({joint: position})

    def set_joint_positions(self, positions: dict[str, float]) -> None:
        """Put joints at `positions` (rad or m), at rest; the others stay.

        Mimicking joints follow unless they are listed themselves.

        Raises:
            WorldError: unknown joint or a number that is not finite; nothing is changed then.
        """
        self._place(positions)
        self._damping.changed()

    def _place(self, positions: dict[str, float]) -> None:
        slots = {}
        for joint, position in positions.items():
            slots[self._require(joint)] = float(position)
            if not math.isfinite(position):
                raise WorldError(
                    f"model '{self.name}', joint '{joint}': position {position} is not finite"
                )
        for slot, value in self._with_followers(slots).items():
            pybullet.resetJointState(self.body_id, self._bullet_joint[slot], value, 0.0,
                                     physicsClientId=self.client)
        self._joint_cache = None

    def _with_followers(self, slots: dict[int, float]) -> dict[int, float]:
        if not self._gears:
            return slots
        result = dict(slots)
        for _ in self._gears:
            for i, name in enumerate(self.joint_names):
                mimic = self.description.joints[name].mimic
                if mimic is not None and i not in slots:
                    leader = self._slot[mimic.joint]
                    if leader in result:
                        result[i] = mimic.multiplier * result[leader] + mimic.offset
        return result

    def set_velocity_motor(self, joint: str, velocity: float, max_effort: float) -> None:
        """Drive `joint` at `velocity` with at most `max_effort`, from now on.

        It takes the place of the joint's Coulomb friction, as ODE's joint motor does in Gazebo.
        """
        slot = self._require(joint)
        if not (math.isfinite(velocity) and max_effort >= 0.0):
            raise WorldError(f"model '{self.name}', joint '{joint}': velocity {velocity} and "
                             f"effort {max_effort} need a finite and a non-negative number")
        self._motor(slot, velocity, min(max_effort, _NO_LIMIT_FORCE))
        self.active_friction[slot] = 0.0

    def release_motor(self, joint: str) -> None:
        """Undo `set_velocity_motor`: back to Coulomb friction."""
        self.restore_friction(self._require(joint))

    def restore_friction(self, slot: int) -> None:
        """Coulomb friction of a joint: a motor towards standstill of at most that effort."""
        self._motor(slot, 0.0, self.friction[slot])
        self.active_friction[slot] = self.friction[slot]

    def set_damping_motor(self, slot: int, share: float) -> None:
        """A motor that takes `share` of the velocity a step (see damping.py)."""
        self._motor(slot, 0.0, _NO_LIMIT_FORCE, share)
        self.active_friction[slot] = 0.0

    def set_bullet_damping(self, slot: int, value: float) -> None:
        """Bullet's explicit damping of a joint (see damping.py)."""
        pybullet.changeDynamics(self.body_id, self._bullet_joint[slot], jointDamping=value,
                                physicsClientId=self.client)

    def _motor(self, slot: int, velocity: float, force: float, gain: float = 1.0) -> None:
        pybullet.setJointMotorControl2(
            self.body_id, self._bullet_joint[slot], pybullet.VELOCITY_CONTROL,
            targetVelocity=velocity, force=force, velocityGain=gain, physicsClientId=self.client)

    def _require(self, joint: str) -> int:
        slot = self._slot.get(joint)
        if slot is None:
            known = ", ".join(self.joint_names) or "none"
            raise WorldError(f"model '{self.name}' has no moving joint '{joint}'; it has: {known}")
        return slot

    def bullet_positions(self) -> list[float]:
        """Joint positions in Bullet's order of degrees of freedom."""
        positions = self.read_joints()[0]
        ordered = [0.0] * len(positions)
        for index, value in zip(self.dof_order, positions, strict=True):
            ordered[index] = value
        return ordered

    def bias_efforts(self) -> list[float]:
        """Efforts that gravity, Coriolis and centrifugal forces ask of each joint, N m or N.

        In `joint_names` order: what would keep the joint velocities as they are without friction
        and damping. For models with a fixed base.
        """
        positions, velocities, _ = self.read_joints()
        count = len(positions)
        q, v = [0.0] * count, [0.0] * count
        for index, position, velocity in zip(self.dof_order, positions, velocities, strict=True):
            q[index], v[index] = position, velocity
        # Bullet's inverse dynamics takes the base's principal frame for the world's: gravity has
        # to be turned into it for the length of the call.
        base = pybullet.getBasePositionAndOrientation(self.body_id, self.client)[1]
        pybullet.setGravity(*rotate(conjugate(base), self.gravity), physicsClientId=self.client)
        try:
            bias = pybullet.calculateInverseDynamics(self.body_id, q, v, [0.0] * count,
                                                     physicsClientId=self.client)
        finally:
            pybullet.setGravity(*self.gravity, physicsClientId=self.client)
        return [bias[i] for i in self.dof_order]

    # ------------------------------------------------------------------ the step

    def check_efforts(self) -> None:
        """WorldError when a pending effort is not finite; all of this model's are dropped then."""
        if not math.isfinite(sum(self.pending_efforts)):
            bad = [n for n, e in zip(self.joint_names, self.pending_efforts, strict=True)
                   if not math.isfinite(e)]
            self.pending_efforts = [0.0] * len(self.joint_names)
            raise WorldError(f"model '{self.name}', joint {bad}: the effort is not finite")

    def before_step(self, dt: float) -> None:
        """Hand the pending efforts, which are finite, to Bullet; called by `World.step`."""
        if self.joint_names:
            efforts = self.pending_efforts
            torques = self._damping.before_step(dt)
            if self._dirty or torques is not None:
                total = efforts if torques is None else [
                    e + t for e, t in zip(efforts, torques.tolist(), strict=True)
                ]
                pybullet.setJointMotorControlArray(
                    self.body_id, self._bullet_joint, pybullet.TORQUE_CONTROL, forces=total,
                    physicsClientId=self.client)
            self._applied, self.pending_efforts = efforts, [0.0] * len(efforts)
            self._dirty = False
        if self._weightless:
            self._carry_weightless()

    @property
    def needs_steps(self) -> bool:
        """Whether `before_step` has anything to do, ever."""
        return bool(self.joint_names or self._weightless)

    def physics_changed(self) -> None:
        """Time step or gravity was changed; called by `World.set_physics`."""
        self._damping.changed()

    def after_step(self) -> None:
        """Forget what was read before the step; called by `World.step`."""
        self._joint_cache = None

    def _carry_weightless(self) -> None:
        for name, mass in self._weightless.items():
            centre = self.link_pose(name).apply(self._inertial_poses[name].xyz)
            self.apply_force(name, tuple(-mass * g for g in self.gravity), centre)

    # ------------------------------------------------------------------ frames

    def pose(self) -> Pose:
        """world_T_root: the frame of the root link."""
        return self.link_pose(self.description.root)

    def twist(self) -> Twist:
        """Twist of the root link's frame, in world axes."""
        return self.link_twist(self.description.root)

    def link_pose(self, name: str) -> Pose:
        """world_T_link of the link's own (URDF) frame, unpacks as (xyz, quat xyzw).

        Raises:
            WorldError: unknown link.
        """
        return self._com_pose(self._link_index(name)) @ self._inertial_poses[name].inverse()

    def link_twist(self, name: str) -> Twist:
        """Twist of the link's frame: velocity of its origin, in world axes (m/s, rad/s)."""
        return self.link_state(name)[1]

    def link_state(self, name: str) -> tuple[Pose, Twist]:
        """(world_T_link, twist of the link's origin in world axes)."""
        index = self._link_index(name)
        inertial = self._inertial_poses[name]
        if index == -1:
            com = self._com_pose(index)
            linear, angular = pybullet.getBaseVelocity(self.body_id, self.client)
        else:
            state = pybullet.getLinkState(self.body_id, index, 1, 1, self.client)
            com, linear, angular = Pose(state[0], state[1]), state[6], state[7]
        return _frame_state(com, linear, angular, inertial)

    def link_states(self) -> dict[str, tuple[Pose, Twist]]:
        """`link_state` of every link in file order, in one call to Bullet."""
        names = [n for n in self.link_names if self._links[n] >= 0]
        indices = [self._links[n] for n in names]
        states = pybullet.getLinkStates(self.body_id, indices, 1, 1, self.client) if names else ()
        found = {
            n: _frame_state(Pose(s[0], s[1]), s[6], s[7], self._inertial_poses[n])
            for n, s in zip(names, states, strict=True)
        }
        found[self.description.root] = self.link_state(self.description.root)
        return {n: found[n] for n in self.link_names}

    def _link_index(self, name: str) -> int:
        index = self._links.get(name)
        if index is None:
            raise WorldError(f"model '{self.name}' has no link '{name}'; "
                             f"it has: {', '.join(self.link_names)}")
        return index

    def link_index(self, name: str) -> int:
        """Bullet's index of a link, -1 for the root."""
        return self._link_index(name)

    def _com_pose(self, index: int) -> Pose:
        if index == -1:
            return Pose(*pybullet.getBasePositionAndOrientation(self.body_id, self.client))
        state = pybullet.getLinkState(self.body_id, index, 0, 1, self.client)
        return Pose(state[0], state[1])

    def set_pose(self, pose: Pose) -> None:
        """Move the whole model rigidly so that its root frame is at `pose`; joints keep angles."""
        com = pose @ self._inertial_poses[self.description.root]
        pybullet.resetBasePositionAndOrientation(self.body_id, com.xyz, com.quat,
                                                 physicsClientId=self.client)

    def set_twist(self, twist: Twist) -> None:
        """Give the model `twist` (of its root frame, world axes) as one rigid body.

        Joint velocities become zero. A model with a fixed base keeps still.
        """
        self.stop_joints()
        if self.fixed_base:
            return
        root = self.description.root
        arm = rotate(self.pose().quat, self._inertial_poses[root].xyz)
        linear = add(twist.linear, cross(twist.angular, arm))
        pybullet.resetBaseVelocity(self.body_id, linear, twist.angular,
                                   physicsClientId=self.client)

    def stop_joints(self) -> None:
        """Joint velocities to zero; positions stay."""
        positions, _, _ = self.read_joints()
        for index, position in zip(self._bullet_joint, positions, strict=True):
            pybullet.resetJointState(self.body_id, index, position, 0.0,
                                     physicsClientId=self.client)
        self._joint_cache = None

    def apply_force(self, link: str, force: tuple, position: tuple,
                    torque: tuple = (0.0, 0.0, 0.0)) -> None:
        """Force (N) at a world position and torque (N m), world axes, for the next step only."""
        index = self._link_index(link)
        if any(force):
            pybullet.applyExternalForce(self.body_id, index, force, position,
                                        pybullet.WORLD_FRAME, physicsClientId=self.client)
        if any(torque):
            pybullet.applyExternalTorque(self.body_id, index, torque, pybullet.WORLD_FRAME,
                                         physicsClientId=self.client)

    # ------------------------------------------------------------------ properties

    @property
    def link_indices(self) -> MappingProxyType:
        """Bullet's index of each link by name; -1 is the root."""
        return MappingProxyType(self._links)

    def paint(self, colours: dict[int, tuple], default: tuple) -> None:
        """Colours (rgba) in PyBullet's window by Bullet link index; the others get `default`."""
        shapes = pybullet.getVisualShapeData(self.body_id, physicsClientId=self.client)
        for index in {shape[1] for shape in shapes}:
            pybullet.changeVisualShape(self.body_id, index, rgbaColor=colours.get(index, default),
                                       physicsClientId=self.client)

    @property
    def materials(self) -> MappingProxyType:
        """Gazebo material by Bullet link index, for the renderer's table."""
        return MappingProxyType({
            self._links[link]: material for link, material in self.description.materials.items()
        })


def _frame_state(com: Pose, linear: tuple, angular: tuple, inertial: Pose) -> tuple[Pose, Twist]:
    """Pose and twist of a link frame from those of its centre of mass."""
    pose = com @ inertial.inverse()
    lever = subtract(pose.xyz, com.xyz)
    return pose, Twist(add(linear, cross(angular, lever)), angular)
