"""Joints of a model: their states, efforts, motors, and mimic constraints."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.errors import UnknownJointError, WorldError
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.bullet_body import BulletBody
from aras_sim_bridge.world.closed_chains import close_loop
from aras_sim_bridge.world.fixed_base_dynamics import FixedBaseDynamics
from aras_sim_bridge.world.joint_damping import JointDamping
from aras_sim_bridge.world.joint_dynamics import FASTEST_SPEED, NO_LIMIT_FORCE
from aras_sim_bridge.world.stops import JointStops
from aras_visual_servo_base.poses import Pose, Vector3


class ModelJoints:
    """Moving joints of a model, including joints that mimic others.

    All sequences of joint values are in the order of `names`. Efforts act for one step.

    Bullet steps the joints of a model with a free base, and keeps their state. The joints of a
    model with a fixed base are stepped by joint_dynamics.py while `has_own_dynamics` is True, and
    otherwise by Bullet. While joint_dynamics.py steps them, their state is in `space`;
    `update_bullet` copies it to Bullet before Bullet is queried.

    Attributes:
        names: names of the joints in the order of the description.
        has_own_dynamics: whether joint_dynamics.py steps the joints instead of Bullet.
        applied_efforts: efforts of the last step, N m or N.
    """

    def __init__(self, body: BulletBody, gravity: Vector3) -> None:
        self.body = body
        self.gravity = gravity
        self.has_own_dynamics = False
        self._is_bullet_current = True
        self.space: FixedBaseDynamics | None = None
        self.damping: JointDamping | None = None
        self._speed_bounds: dict[str, float] = {}

    def load(self, description: RobotDescription, positions: Mapping[str, float]) -> None:
        """Read the joints of a body that Bullet has just loaded, and place them at `positions`.

        The joints are at rest. Those that `positions` does not contain are at 0.
        """
        body = self.body
        self.has_own_dynamics, self._is_bullet_current = False, True
        self.names: tuple[str, ...] = () if description.static else description.list_moving_joints()
        joints = [description.joints[name] for name in self.names]
        self._mimics = [joint.mimic for joint in joints]
        self._slot = {name: slot for slot, name in enumerate(self.names)}
        self._indices = [body.joint_indices[name] for name in self.names]
        self._stops = [joint.stops for joint in joints]
        jointed = bool(self.names)
        space = FixedBaseDynamics(description, self.names) if jointed else None
        self.space, self._free_space = (space, None) if body.fixed_base else (None, space)
        self._bullet_stops = JointStops(body, self._indices, self._stops,
                                   space.return_speeds if jointed else ())
        for slot, joint in enumerate(joints):
            body.change_joint(self._indices[slot], jointLimitForce=NO_LIMIT_FORCE)
            # In Bullet, friction is a motor with target speed 0 and a limited effort.
            self._set_motor(slot, 0.0, joint.friction)
        # Apply the speed limits that were set before the model was loaded.
        if self.space is not None:
            for name, fastest in self._speed_bounds.items():
                self.space.bound_speed(self._slot[name], fastest)
        for name, position in positions.items():
            self._set_state(self._slot[name], position)
        self._gears = self._make_gears()
        self._loops = [made for loop in description.loops for made in close_loop(body, loop)]
        self.pending_efforts = [0.0] * len(self.names)
        self.applied_efforts = [0.0] * len(self.names)
        self._has_pending_efforts = False
        self._cache: tuple[Sequence[float], Sequence[float]] | None = None
        self.damping = None
        if jointed and not body.fixed_base:
            self.damping = JointDamping(body, self._indices, joints, self.inverse_inertia)

    def remove_constraints(self) -> None:
        """Remove the constraints of mimicking joints and of closed chains from Bullet."""
        for constraint in (*self._gears, *self._loops):
            pybullet.removeConstraint(constraint, physicsClientId=self.body.client)

    def _set_state(self, slot: int, position: float, velocity: float = 0.0) -> None:
        if self.has_own_dynamics:
            self.space.state[0, slot], self.space.state[1, slot] = position, velocity
            self._is_bullet_current = False
            return
        self.body.reset_joint(self._indices[slot], position, velocity)

    def set_own_dynamics(self, own: bool) -> None:
        """Choose joint_dynamics.py (`own`) or Bullet to step the joints, and transfer the state.

        joint_dynamics.py may only be used while no other body can touch the model.
        """
        if self.space is None or own == self.has_own_dynamics:
            return
        positions, velocities, _ = self.read()
        if own:
            self.space.state[0], self.space.state[1] = positions, velocities
            self.has_own_dynamics = True
            return
        self.update_bullet()
        self.has_own_dynamics = False
        for slot in range(len(self.names)):
            self.body.set_velocity_motor(self._indices[slot], *self.space.read_motor(slot))

    def update_bullet(self) -> None:
        """Write the joint states to Bullet if those in Bullet are out of date."""
        if self._is_bullet_current:
            return
        self._is_bullet_current = True
        for index, position, velocity in zip(self._indices, *self.read()[:2], strict=True):
            self.body.reset_joint(index, position, velocity)

    @property
    def moving_links(self) -> tuple[str, ...]:
        """Links of a fixed-base model that a joint moves."""
        return () if self.space is None else self.space.moving_links

    def set_root(self, root: Pose) -> None:
        """Set the pose of the root in the world, and apply the present gravity."""
        if self.space is not None:
            self.space.set_root(root, self.gravity)

    def read(self) -> tuple[Sequence[float], Sequence[float], Sequence[float]]:
        """Return the positions (rad or m), velocities (rad/s or m/s) and efforts (N m or N).

        The efforts are those of the last step. The caller must not modify the sequences.

        Raises:
            WorldError: the simulation diverged (a position is not finite, or a speed too high).
        """
        cache = self._cache
        if cache is None:
            cache = self._refresh()
        return cache[0], cache[1], self.applied_efforts

    def _refresh(self) -> tuple[Sequence[float], Sequence[float]]:
        if not self.names:
            self._cache = ((), ())
            return self._cache
        if self.has_own_dynamics:
            positions, velocities, _ = self.space.state.tolist()
            self._cache = (positions, velocities)
            return self._cache
        states = pybullet.getJointStates(self.body.body_id, self._indices, self.body.client)
        positions, velocities, _, _ = zip(*states, strict=True)
        if not max(max(velocities), -min(velocities)) + abs(sum(positions)) < FASTEST_SPEED:
            diverged = next(
                (
                    slot
                    for slot, (p, v) in enumerate(zip(positions, velocities, strict=True))
                    if not (abs(v) < FASTEST_SPEED and math.isfinite(p))
                ),
                None,
            )
            if diverged is not None:
                raise self._make_divergence_error(diverged)
        self._cache = (positions, velocities)
        return self._cache

    def _make_divergence_error(self, slot: int) -> WorldError:
        return WorldError(
            f"model '{self.body.name}', joint '{self.names[slot]}': the simulation diverged; lower "
            "the gains or the time step, then call reset_simulation and unpause_physics"
        )

    def apply_effort(self, joint: str, effort: float) -> None:
        """Add `effort` (N m or N) to the effort on `joint` in the next step.

        Raises:
            WorldError: the model has no joint of this name.
        """
        slot = self._slot.get(joint)
        self.pending_efforts[self._find_slot(joint) if slot is None else slot] += effort
        self._has_pending_efforts = True

    def check_efforts(self) -> None:
        """Raise WorldError, and discard all pending efforts, if one of them is not finite."""
        if not math.isfinite(sum(self.pending_efforts)):
            invalid = [n for n, e in zip(self.names, self.pending_efforts, strict=True)
                   if not math.isfinite(e)]
            self.pending_efforts = [0.0] * len(self.names)
            raise WorldError(f"model '{self.body.name}', joint {invalid}: the effort is not "
                             "finite; check its controller")

    def before_step(self, dt: float) -> None:
        """Pass the pending efforts to Bullet; they must be finite."""
        self._bullet_stops.before_step(self.read()[0], dt)
        efforts = total = self.pending_efforts
        if self.space is not None:
            self.read_bullet_state()
            self.space.state[2] = efforts
            total = [e + t for e, t in zip(efforts, self.space.compute_reactions(dt), strict=True)]
        else:
            self.damping.before_step(dt)
            total = self.damping.add_spring_efforts(efforts, *self.read()[:2], dt)
        if self._has_pending_efforts or total is not efforts:
            pybullet.setJointMotorControlArray(
                self.body.body_id, self._indices, pybullet.TORQUE_CONTROL, forces=total,
                physicsClientId=self.body.client)
        self.applied_efforts, self.pending_efforts = efforts, [0.0] * len(efforts)
        self._has_pending_efforts = False

    def read_bullet_state(self) -> None:
        """Copy Bullet's joint states to `space`, for a model that Bullet steps."""
        self.space.state[0], self.space.state[1], _ = self.read()

    def advance(self, dt: float) -> None:
        """Make a step of `dt` s with joint_dynamics.py. The pending efforts must be finite.

        Raises:
            WorldError: the simulation diverged.
        """
        self.space.state[2] = self.pending_efforts
        self.pending_efforts = [0.0] * len(self.names)
        self._has_pending_efforts = False
        self.finish_steps(self.space.advance(dt))

    def finish_steps(self, diverged_joint: int) -> None:
        """Update the efforts and the cached states after steps with joint_dynamics.py.

        The efforts of these steps are in space.state[2].

        Args:
            diverged_joint: result of the last `joint_dynamics.advance`; -1 if none diverged.

        Raises:
            WorldError: the simulation diverged.
        """
        self.applied_efforts = self.space.state[2].tolist()
        self._is_bullet_current = False
        self._cache = None
        if diverged_joint >= 0:
            raise self._make_divergence_error(diverged_joint)

    @property
    def is_calm(self) -> bool:
        """Whether joint_dynamics.py steps the model (not Bullet) and no effort is pending."""
        return self.has_own_dynamics and not self._has_pending_efforts

    def after_step(self) -> None:
        """Discard the joint states that were read before the step."""
        self._cache = None

    def read_states(self) -> list[tuple[float, float]]:
        """Return (position, velocity) of each joint, for `restore`."""
        return list(zip(*self.read()[:2], strict=True))

    def restore(self, states: Sequence[tuple[float, float]]) -> None:
        """Set the states of all joints."""
        for slot, (position, velocity) in enumerate(states):
            self._set_state(slot, position, velocity)
        self._cache = None

    def set_position(self, joint: str, position: float) -> float:
        """Set the position of a joint and stop it, as Gazebo's Joint::SetPosition does.

        The drive of a position-controlled joint calls this in every step.

        Returns:
            The position, limited to the range between the stops.

        Raises:
            WorldError: the joint is unknown or a number is not finite; nothing is changed.
        """
        self._set_positions({joint: position})
        return self._clamp_to_stops(self._slot[joint], position)

    def set_joint_positions(self, positions: dict[str, float]) -> None:
        """Set the positions (rad or m) of some joints, and stop these joints.

        The positions are limited to the range between the stops. Joints that mimic one of these
        joints follow, unless `positions` contains them, too. Other joints do not move.

        Raises:
            WorldError: a joint is unknown or a number is not finite; nothing is changed.
        """
        self._set_positions(positions)
        if self.damping is not None:
            self.damping.invalidate()

    def _set_positions(self, positions: dict[str, float]) -> None:
        slots = {}
        for joint, position in positions.items():
            slot = self._find_slot(joint)
            if not math.isfinite(position):
                raise WorldError(
                    f"model '{self.body.name}', joint '{joint}': position {position} is not "
                    "finite; give a finite number"
                )
            slots[slot] = self._clamp_to_stops(slot, float(position))
        for slot, value in self._add_followers(slots).items():
            self._set_state(slot, value)
        self._cache = None

    def _clamp_to_stops(self, slot: int, position: float) -> float:
        low, high = self._stops[slot]
        return min(max(position, low), high)

    def _add_followers(self, slots: dict[int, float]) -> dict[int, float]:
        if not self._gears:
            return slots
        result = dict(slots)
        for _ in self._gears:
            for i, mimic in enumerate(self._mimics):
                if mimic is not None and i not in slots:
                    leader = self._slot[mimic.joint]
                    if leader in result:
                        position = mimic.multiplier * result[leader] + mimic.offset
                        result[i] = self._clamp_to_stops(i, position)
        return result

    def stop_joints(self) -> None:
        """Set all joint velocities to zero without changing the positions."""
        positions, _, _ = self.read()
        for slot, position in enumerate(positions):
            self._set_state(slot, position)
        self._cache = None

    def set_velocity_motor(self, joint: str, velocity: float, max_effort: float) -> None:
        """Drive `joint` at `velocity` (rad/s or m/s) with at most `max_effort` (N m or N).

        The motor stays active until it is set again. It replaces the joint's Coulomb friction, as
        ODE's joint motor does in Gazebo.
        """
        slot = self._find_slot(joint)
        if not (math.isfinite(velocity) and max_effort >= 0.0):
            raise WorldError(f"model '{self.body.name}', joint '{joint}': velocity {velocity} must "
                             f"be finite, and max_effort {max_effort} must not be negative")
        self._set_motor(slot, velocity, min(max_effort, NO_LIMIT_FORCE))

    def bound_speed(self, joint: str, fastest: float) -> None:
        """Limit the speed of `joint` to `fastest` (rad/s or m/s), whatever forces act on it.

        Raises:
            WorldError: unknown joint, a limit that is not positive, or a model without a fixed
                base.
        """
        slot = self._find_slot(joint)
        if self.space is None:
            raise WorldError(f"model '{self.body.name}', joint '{joint}': hard velocity limits "
                             "need a model with a fixed base; fix it or disable the limits")
        if not fastest > 0.0:
            raise WorldError(f"model '{self.body.name}', joint '{joint}': a hard velocity limit of "
                             f"{fastest} would lock the joint; set <limit velocity> above 0")
        self._speed_bounds[joint] = fastest
        self.space.bound_speed(slot, fastest)

    def _find_slot(self, joint: str) -> int:
        slot = self._slot.get(joint)
        if slot is None:
            raise UnknownJointError(self.body.name, joint, self.names)
        return slot

    def bias_efforts(self) -> list[float]:
        """Return the efforts of gravity, Coriolis and centrifugal forces, N m or N.

        Without friction and damping, these efforts would keep the joint velocities constant. The
        model must have a fixed base.
        """
        if not self.has_own_dynamics:
            self.read_bullet_state()
        return self.space.bias_efforts()

    def inverse_inertia(self) -> np.ndarray:
        """Return the matrix (n, n) that maps joint efforts to accelerations, 1/(kg m²) or 1/kg."""
        if self.space is None:
            self._free_space.state[0] = self.read()[0]
            return np.linalg.inv(self._free_space.free_mass_matrix())[6:, 6:]
        if not self.has_own_dynamics:
            self.read_bullet_state()
        return np.linalg.inv(self.space.mass_matrix())

    def _make_gears(self) -> list[int]:
        gears = []
        for i, mimic in enumerate(self._mimics):
            if mimic is None:
                continue
            leader = self._indices[self._slot[mimic.joint]]
            gear = pybullet.createConstraint(
                self.body.body_id, self._indices[i], self.body.body_id, leader, pybullet.JOINT_GEAR,
                (0, 0, 1), (0, 0, 0), (0, 0, 0), physicsClientId=self.body.client)
            pybullet.changeConstraint(gear, gearRatio=-mimic.multiplier, maxForce=1e12, erp=0.2,
                                      relativePositionTarget=mimic.offset,
                                      physicsClientId=self.body.client)
            gears.append(gear)
        return gears

    def _set_motor(self, slot: int, velocity: float, force: float) -> None:
        if self.space is not None:
            self.space.set_motor(slot, velocity, force)
        if not self.has_own_dynamics:
            self.body.set_velocity_motor(self._indices[slot], velocity, force)
