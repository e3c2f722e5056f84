"""The joints of a model: reading, efforts, placing them, motors."""

import math
from collections.abc import Sequence

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.poses import conjugate, rotate
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.damping import ViscousDamping
from aras_sim_bridge.world.model_loading import NO_LIMIT_FORCE, LoadedModel


class ModelJoints(LoadedModel):
    """The part of `Model` that reads and moves its joints."""

    def _load(self) -> None:
        super()._load()
        self.pending_efforts = [0.0] * len(self.joint_names)
        self._applied = [0.0] * len(self.joint_names)
        self._dirty = False
        self._joint_cache: tuple[Sequence[float], Sequence[float]] | None = None
        self._damping = ViscousDamping(self)

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

    def check_efforts(self) -> None:
        """WorldError when a pending effort is not finite; all of this model's are dropped then."""
        if not math.isfinite(sum(self.pending_efforts)):
            bad = [n for n, e in zip(self.joint_names, self.pending_efforts, strict=True)
                   if not math.isfinite(e)]
            self.pending_efforts = [0.0] * len(self.joint_names)
            raise WorldError(f"model '{self.name}', joint {bad}: the effort is not finite")

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

    def stop_joints(self) -> None:
        """Joint velocities to zero; positions stay."""
        positions, _, _ = self.read_joints()
        for index, position in zip(self._bullet_joint, positions, strict=True):
            pybullet.resetJointState(self.body_id, index, position, 0.0,
                                     physicsClientId=self.client)
        self._joint_cache = None

    def set_velocity_motor(self, joint: str, velocity: float, max_effort: float) -> None:
        """Drive `joint` at `velocity` with at most `max_effort`, from now on.

        It takes the place of the joint's Coulomb friction, as ODE's joint motor does in Gazebo.
        """
        slot = self._require(joint)
        if not (math.isfinite(velocity) and max_effort >= 0.0):
            raise WorldError(f"model '{self.name}', joint '{joint}': velocity {velocity} and "
                             f"effort {max_effort} need a finite and a non-negative number")
        self._motor(slot, velocity, min(max_effort, NO_LIMIT_FORCE))
        self.active_friction[slot] = 0.0

    def release_motor(self, joint: str) -> None:
        """Undo `set_velocity_motor`: back to Coulomb friction."""
        self.restore_friction(self._require(joint))

    def set_damping_motor(self, slot: int, share: float) -> None:
        """A motor that takes `share` of the velocity a step (see damping.py)."""
        self._motor(slot, 0.0, NO_LIMIT_FORCE, share)
        self.active_friction[slot] = 0.0

    def set_bullet_damping(self, slot: int, value: float) -> None:
        """Bullet's explicit damping of a joint (see damping.py)."""
        pybullet.changeDynamics(self.body_id, self._bullet_joint[slot], jointDamping=value,
                                physicsClientId=self.client)

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
