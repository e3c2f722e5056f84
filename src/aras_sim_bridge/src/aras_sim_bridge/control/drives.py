"""How a command reaches a simulated joint: one drive a way of driving (contract 2.5).

write(dt) is called every physics step. A drive never hands on a number that is not finite: it
falls back to the last command that was.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

from aras_sim_bridge import angles
from aras_sim_bridge.control.joints import JointBounds, JointHandle, Occurrence
from aras_sim_bridge.control.limits import EffortSaturation, LimitRule
from aras_sim_bridge.control.pid import Pid

_INF = float("inf")
# A saturated effort or velocity is ordinary during a step command; only a lasting one is news.
_PATIENCE = {"effort": 0.25, "velocity": 0.25, "position": 0.0}


class JointModel(Protocol):
    """The simulated robot as the hardware sees it; efforts in N m or N, names as in the URDF."""

    joint_names: tuple[str, ...]

    def read_joints(self) -> tuple[Sequence[float], Sequence[float], Sequence[float]]:
        """Positions, velocities and last applied efforts, in joint_names order."""

    def apply_effort(self, joint: str, effort: float) -> None:
        """Apply an effort during the next physics step."""

    def set_position(self, joint: str, position: float) -> float:
        """Put the joint at a position, or at its stop where that is beyond; returns where."""

    def set_velocity_motor(self, joint: str, velocity: float, max_effort: float) -> None:
        """Drive the joint at a velocity with at most this effort."""

    def bound_speed(self, joint: str, fastest: float) -> None:
        """Let nothing make the joint faster."""


class Drive:
    """Base: guards the command, applies the limit rule and reports what it changed."""

    quantity = ""

    def __init__(
        self,
        handle: JointHandle,
        limits: JointBounds | None,
        rule: LimitRule | None,
        model: JointModel,
        warn: Callable[[str], None],
        pid: Pid | None = None,
    ) -> None:
        self.handle = handle
        self.pid = pid
        self._held: float | None = None  # where an emergency stop holds a position
        # Bound once: they are called every physics step.
        self._enforce = None if rule is None else rule.enforce
        self._rule = rule
        self._apply_effort = model.apply_effort
        self._set_position = model.set_position
        self._set_velocity_motor = model.set_velocity_motor
        self._warn = warn
        self._good = 0.0
        self._limited = Occurrence(_PATIENCE[self.quantity])
        self._refused = Occurrence()
        limits = limits or JointBounds()
        self._max_effort = _INF if limits.max_effort is None else limits.max_effort
        self._max_velocity = _INF if limits.max_velocity is None else limits.max_velocity
        self._travel = (
            (limits.min_position, limits.max_position) if limits.has_position else None
        )

    def start(self) -> None:
        """Be as new, with a joint that stays where it is until it is commanded."""
        handle = self.handle
        handle.position_command = handle.position
        handle.velocity_command = handle.effort_command = 0.0
        self._good = handle.position if self.quantity == "position" else 0.0
        self._held = None
        self._limited.reset()
        self._refused.reset()
        if self._rule is not None:
            self._rule.reset()
        if self.pid is not None:
            self.pid.reset()

    def _refuse(self, command: float, time_ns: int) -> float:
        """Report a command that is not finite and return the one to use instead."""
        if self._refused.note(time_ns):
            self._warn(
                f"joint '{self.handle.name}': {self.quantity} command {command} is not finite; "
                f"keeping {self._good:g}. Look at the controller that commands it"
            )
        return self._good

    def _report(self, wanted: float, given: float, time_ns: int) -> None:
        """Say once an occurrence that the limits changed the command."""
        if self._limited.note(time_ns):
            self._warn(
                f"joint '{self.handle.name}': {self.quantity} command {wanted:g} is beyond what "
                f"its limits allow at position {self.handle.position:g} and velocity "
                f"{self.handle.velocity:g}; {given:g} is applied"
            )

    def _clamp_effort(self, effort: float) -> float:
        """The effort within its limit, and none that drives a joint on that is too fast."""
        limit, velocity = self._max_effort, self.handle.velocity
        low = 0.0 if velocity < -self._max_velocity else -limit
        high = 0.0 if velocity > self._max_velocity else limit
        return low if effort < low else high if effort > high else effort


class EffortDrive(Drive):
    """Applies the commanded effort."""

    quantity = "effort"

    def write(self, time_ns: int, dt: float, stopped: bool) -> None:
        """Limit the command and apply it; 0 in an emergency stop."""
        handle = self.handle
        wanted = handle.effort_command
        if not -_INF < wanted < _INF:
            wanted = handle.effort_command = self._refuse(wanted, time_ns)
        if self._enforce is not None:
            self._enforce(handle, dt)
            if handle.effort_command != wanted:
                self._report(wanted, handle.effort_command, time_ns)
        self._good = effort = handle.effort_command
        self._apply_effort(handle.name, 0.0 if stopped else effort)

    @property
    def saturation(self) -> tuple[float, float, float, float] | None:
        """Lower, upper, greatest speed and effort beyond which `write` would change a command;
        None where that depends on more."""
        if self._rule is None:
            return -_INF, _INF, _INF, _INF
        return self._rule.bounds if isinstance(self._rule, EffortSaturation) else None

    def written(self) -> None:
        """Be as after `write` of a command that it need not change."""
        self._good = self.handle.effort_command


class PositionDrive(Drive):
    """Puts the joint where the command says; holds the measured position when stopped."""

    quantity = "position"

    def write(self, time_ns: int, dt: float, stopped: bool) -> None:
        """Limit the command and set the joint's position."""
        command = self._command(time_ns, dt, stopped)
        reached = self._set_position(self.handle.name, command)
        if reached != command and self._limited.note(time_ns):
            self._warn(f"joint '{self.handle.name}': position command {command:g} is beyond its "
                       f"stop at {reached:g}, where it rests; lower the command, or joint_limits")

    def _command(self, time_ns: int, dt: float, stopped: bool) -> float:
        handle = self.handle
        if stopped:
            if self._held is None:
                self._held = handle.position
            handle.position_command = self._held
        else:
            self._held = None
        wanted = handle.position_command
        if not -_INF < wanted < _INF:
            wanted = handle.position_command = self._refuse(wanted, time_ns)
        if self._enforce is not None:
            self._enforce(handle, dt)
            # Slowed by the velocity limit is everyday travel; beyond the range is a mistake.
            travel = self._travel
            if travel is not None and not travel[0] <= wanted <= travel[1]:
                bound = travel[0] if wanted < travel[0] else travel[1]
                self._report(wanted, bound, time_ns)
        self._good = handle.position_command
        return self._good


class PositionPidDrive(PositionDrive):
    """Reaches the commanded position with an effort PID."""

    def write(self, time_ns: int, dt: float, stopped: bool) -> None:
        """Limit the command and apply the PID's effort towards it."""
        command = self._command(time_ns, dt, stopped)
        handle = self.handle
        if handle.kind == "revolute" and self._travel is not None:
            error = angles.towards(handle.position, command, *self._travel)
        elif handle.kind in ("revolute", "continuous"):
            error = angles.shortest(handle.position, command)
        else:
            error = command - handle.position
        effort = self._clamp_effort(self.pid.compute(error, dt))
        self._apply_effort(handle.name, effort)


class VelocityDrive(Drive):
    """Turns the joint at the commanded velocity with a motor of limited effort."""

    quantity = "velocity"

    def write(self, time_ns: int, dt: float, stopped: bool) -> None:
        """Limit the command and set the motor; 0 in an emergency stop."""
        velocity = self._command(time_ns, dt)
        self._set_velocity_motor(
            self.handle.name, 0.0 if stopped else velocity, self._max_effort
        )

    def _command(self, time_ns: int, dt: float) -> float:
        handle = self.handle
        wanted = handle.velocity_command
        if not -_INF < wanted < _INF:
            wanted = handle.velocity_command = self._refuse(wanted, time_ns)
        if self._enforce is not None:
            self._enforce(handle, dt)
            if handle.velocity_command != wanted:
                self._report(wanted, handle.velocity_command, time_ns)
        self._good = handle.velocity_command
        return self._good


class VelocityPidDrive(VelocityDrive):
    """Reaches the commanded velocity with an effort PID."""

    def write(self, time_ns: int, dt: float, stopped: bool) -> None:
        """Limit the command and apply the PID's effort towards it, or towards rest."""
        command = self._command(time_ns, dt)
        handle = self.handle
        error = (0.0 if stopped else command) - handle.velocity
        self._apply_effort(handle.name, self._clamp_effort(self.pid.compute(error, dt)))
