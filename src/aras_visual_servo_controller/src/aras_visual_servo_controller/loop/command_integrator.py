"""Joint commands between images.

The commands are integrated from velocities, limited, and stopped smoothly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..kinematics.joint_sample import JointSample
from ..records.state import JointCommand, ServoSettings

if TYPE_CHECKING:
    from ..kinematics.command_limits import CommandLimits


# A joint has jumped between two samples if it moved farther than JUMP times `lead` (the distance by
# which its command may be ahead), and also farther than JUMP_SPEEDS times the distance that its
# greater measured speed explains.
JUMP, JUMP_SPEEDS = 0.5, 4.0


class CommandIntegrator:
    """Integrator that turns joint velocities into a continuous joint command.

    Attributes:
        command: (n,) commanded positions, rad or m; None before `start_at`.
        velocity: (n,) latest velocity of the command, rad/s or m/s.
        is_late: (n,) whether each joint is so far behind its command that the command waits for it.
        lead: (n,) distance by which the command may be ahead of each joint, rad or m.
    """

    def __init__(
        self, names: Sequence[str], limits: CommandLimits, settings: ServoSettings
    ) -> None:
        self.names, self.limits, self.settings = tuple(names), limits, settings
        self.lead = np.full(len(self.names), settings.lead, float)
        self.reset()

    def reset(self) -> None:
        """Remove the command."""
        self.command: np.ndarray | None = None
        self.velocity = np.zeros(len(self.names))
        self.clear_late()
        self._braking: tuple[np.ndarray, float, float] | None = None

    def start_at(self, positions: np.ndarray) -> None:
        """Set the command to the joint positions (n,)."""
        self.reset()
        self.command = np.array(positions, float)

    def adopt_joints(self, positions: np.ndarray) -> None:
        """Set the command to the joint positions (n,) if the joints are no longer at the command.
        """
        arrived = np.asarray(self.settings.arrived, float)
        if self.command is not None and (np.abs(positions - self.command) > arrived).any():
            self.start_at(positions)

    def clear_late(self) -> None:
        """Mark no joint as too far behind its command, because no motion is commanded."""
        self.is_late = np.zeros(len(self.names), bool)

    def yield_to(self, is_late: Sequence[bool], dt: float) -> None:
        """Bring the command to rest while another node commands the joints.

        Args:
            is_late: (n,) values for the attribute `is_late`.
            dt: time step, s.
        """
        self.is_late = np.array(is_late)
        self.brake(dt)

    @property
    def is_at_rest(self) -> bool:
        """Return whether the command is at rest."""
        return not self.velocity.any()

    def integrate(self, velocities: np.ndarray, measured: np.ndarray, dt: float) -> str:
        """Integrate velocities (n,) over dt (s), given the measured joint positions (n,).

        If a joint does not follow because of friction or an obstacle, all joints wait for it: a
        motion of the others alone would move the camera off its path. With velocity output,
        `command` is not sent; once the command has stopped for a late joint, it is set to the
        measured positions.

        Returns:
            A description of what did not move as commanded; empty if everything did.
        """
        if dt <= 0.0:
            return ""
        after, speeds, stopped, late = integrate_command(
            self.command, self.velocity, velocities, measured, self.limits.lower,
            self.limits.upper, self.lead, self.settings.lag, dt,
        )  # fmt: skip
        if not late.any():
            self.set_command(after, speeds)
            return self.describe_stops(np.flatnonzero(stopped)) if stopped.any() else ""
        self.is_late = late
        self.brake(dt)
        if self.is_at_rest and self.settings.output == "velocity":
            self.command = np.array(measured, float)
        return "; ".join(
            f"waiting for {self.names[i]}, which is {abs(after[i] - measured[i]):.3f} behind "
            "its command"
            for i in np.flatnonzero(late)
        )

    def set_command(self, command: np.ndarray, velocity: np.ndarray) -> None:
        """Set the commanded positions (n,) and their velocities (n,), and clear `is_late`."""
        self.is_late = np.zeros(len(self.names), bool)
        self._braking, self.velocity, self.command = None, velocity, command

    def describe_stops(self, stopped: Sequence[int]) -> str:
        """Describe which joints stopped at their limits."""
        return "; ".join(
            f"{self.names[i]} stopped at its limit of {self.command[i]:.4f}" for i in stopped
        )

    def brake(self, dt: float) -> None:
        """Decelerate linearly to rest within the stop time.

        The deceleration takes longer if the acceleration limits require it.
        """
        if self.command is None or self.is_at_rest:
            self._braking = None
            return
        if self._braking is None:
            needed = np.abs(self.velocity) / np.asarray(self.limits.acceleration)
            duration = max(self.settings.stop_time, float(needed.max()))
            self._braking = (self.velocity.copy(), duration, 0.0)
        first, duration, elapsed = self._braking
        elapsed += dt
        self._braking = (first, duration, elapsed)
        velocity = first * max(0.0, 1.0 - elapsed / duration)
        after = self.command + velocity * dt
        bounded = np.clip(after, *self._compute_bounds())
        self.command, self.velocity = bounded, np.where(bounded == after, velocity, 0.0)

    def _compute_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and the upper bounds (n,) of the command.

        A joint beyond its limit may only move back.
        """
        low = np.minimum(self.limits.lower, self.command)
        return low, np.maximum(self.limits.upper, self.command)

    def make_command(
        self, t: float, measured: JointSample | None, effort: np.ndarray, reason: str, phase: str
    ) -> JointCommand:
        """Create the command for the joint controllers: positions, velocities or efforts.

        The command has no values before the joints are measured.

        Args:
            t: time of the command, s.
            measured: latest joint sample, or None.
            effort: (n,) largest efforts, N m or N.
            reason: what limits or stops the motion, as text.
            phase: phase of the loop.
        """
        if self.command is None or measured is None:
            return JointCommand(t, self.names, reason=reason, phase=phase)
        settings = self.settings
        if settings.output == "effort":
            values = np.asarray(settings.stiffness) * (self.command - measured.positions)
            values += np.asarray(settings.damping) * (self.velocity - measured.velocities)
            values = np.clip(values, -effort, effort)
        else:
            values = np.array(self.command if settings.output == "position" else self.velocity)
        return JointCommand(t, self.names, values, settings.output, reason, phase)

    def limit_velocities(self, velocities: np.ndarray, dt: float) -> tuple[np.ndarray, str]:
        """Scale the velocities (n,) that a JointController commands to the limits of the joints.

        Returns:
            The velocities, and a description of the limits that scaled them.
        """
        limits, reasons = self.limits, []
        ratio = np.abs(velocities) / np.asarray(limits.velocity)
        fastest = int(np.argmax(ratio))
        if ratio[fastest] > 1.0:
            velocities = velocities / ratio[fastest]
            reasons.append(
                f"velocity scaled to {100.0 / ratio[fastest]:.0f} % (speed limit of "
                f"{self.names[fastest]})"
            )
        if dt > 0.0:
            change = velocities - self.velocity
            ratio = np.abs(change) / (np.asarray(limits.acceleration) * dt)
            hardest = int(np.argmax(ratio))
            if ratio[hardest] > 1.0:
                velocities = self.velocity + change / ratio[hardest]
                reasons.append(f"at the acceleration limit of {self.names[hardest]}")
        return velocities, "; ".join(reasons)


@jit("f8[:], f8[:], f8[:], f8[:], f8[:], f8[:], f8[:], f8, f8")
def integrate_command(command, velocity, velocities, measured, lower, upper, lead, lag, dt):
    """Integrate the commanded positions (n,) over dt (s).

    Args:
        command, velocity: (n,) commanded positions, and their latest velocities.
        velocities: (n,) velocities to integrate.
        measured: (n,) measured positions.
        lower, upper: (n,) position limits. A command beyond a limit may only move back.
        lead, lag: the command of joint i may be ahead of the joint by lead[i] + lag |velocity[i]|.
        dt: time step, s.

    Returns:
        The new commanded positions (n,); their velocities (n,); whether each joint is stopped at a
        limit (n,); whether each joint is too far behind its command (n,).
    """
    after = np.empty(len(command))
    stopped, late = np.empty(len(command), np.bool_), np.empty(len(command), np.bool_)
    for i in range(len(command)):
        target = command[i] + velocities[i] * dt
        after[i] = min(max(target, min(lower[i], command[i])), max(upper[i], command[i]))
        stopped[i] = after[i] != target
        before, ahead = abs(command[i] - measured[i]), abs(after[i] - measured[i])
        # A joint that was close to its command before this step is not late, even if the step is
        # long. Otherwise a free-flying camera with a desired speed above 5 rad/s would never start
        # to move.
        is_lagging = before > 0.5 * lead[i]
        late[i] = is_lagging and ahead > lead[i] + lag * abs(velocity[i]) and ahead > before
    return after, (after - command) / dt, stopped, late


@jit("f8[:], f8[:], f8[:], f8[:], f8[:], f8")
def has_jumped(positions, before, velocities, velocities_before, lead, dt):
    """Return whether a joint moved farther in dt (s) than its speeds explain.

    Args:
        positions, before: (n,) present and previous positions.
        velocities, velocities_before: (n,) measured velocities at these positions.
        lead: one number or (n,) numbers, distance by which a command may be ahead of its joint; a
            motion below the fraction JUMP of it is no jump.
        dt: time between the two positions, s.
    """
    for i in range(len(positions)):
        distance = abs(positions[i] - before[i])
        speed = max(abs(velocities[i]), abs(velocities_before[i]))
        if distance > JUMP * lead[min(i, len(lead) - 1)] and distance > JUMP_SPEEDS * speed * dt:
            return True
    return False
