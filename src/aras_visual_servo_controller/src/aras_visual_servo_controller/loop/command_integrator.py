"""Joint commands between images: integrated from velocities, bounded, brought to rest smoothly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..kinematics.joint_sample import JointSample
from ..records.state import Command, ServoSettings

if TYPE_CHECKING:
    from ..kinematics.limits import Limits


# Two joint states are no motion where they differ by more than this part of `lead`, and by more
# than so many times the way at their greater speed.
JUMP, JUMP_SPEEDS = 0.5, 4.0


class CommandIntegrator:
    """The command, which only moves on from where it is, whatever is asked.

    Attributes:
        command: (n,) rad or m; None before `start_at`.
        velocity: (n,) at which it moved last.
        late: (n,) bool, of joints that the last `integrate` waited for.
        lead: (n,) see ServoSettings.
    """

    def __init__(self, names: Sequence[str], limits: Limits, settings: ServoSettings) -> None:
        self.names, self.limits, self.settings = tuple(names), limits, settings
        self.lead = np.full(len(self.names), settings.lead, float)
        self.reset()

    def reset(self) -> None:
        """Nothing is commanded."""
        self.command: np.ndarray | None = None
        self.velocity = np.zeros(len(self.names))
        self.clear_late()
        self._braking: tuple[np.ndarray, float, float] | None = None

    def start_at(self, positions: np.ndarray) -> None:
        """Command where the joints (n,) are."""
        self.reset()
        self.command = np.array(positions, float)

    def adopt_joints(self, positions: np.ndarray) -> None:
        """Begin at the joints (n,) if somebody else has moved them since they stood still."""
        arrived = np.asarray(self.settings.arrived, float)
        if self.command is not None and (np.abs(positions - self.command) > arrived).any():
            self.start_at(positions)

    def clear_late(self) -> None:
        """Nothing is asked of the joints: none of them is late."""
        self.is_late = np.zeros(len(self.names), bool)

    def yield_to(self, is_late: Sequence[bool], dt: float) -> None:
        """Come to rest while another node commands joints (n,), which are late meanwhile."""
        self.is_late = np.array(is_late)
        self.brake(dt)

    @property
    def is_at_rest(self) -> bool:
        """Whether the command stands still."""
        return not self.velocity.any()

    def integrate(self, velocities: np.ndarray, measured: np.ndarray, dt: float) -> str:
        """Move on with velocities (n,) for dt (s); measured joints (n,).

        Where a joint does not follow, held by friction or an obstacle, all of them wait for it:
        the others alone would take the camera elsewhere. Joints that are sent velocities never
        hear of the command: once at rest they go on from where they are.

        Returns:
            What did not move as asked, in words; empty when all did.
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
        """The command (n,) has moved on, at a velocity (n,), and waits for no joint."""
        self.is_late = np.zeros(len(self.names), bool)
        self._braking, self.velocity, self.command = None, velocity, command

    def describe_stops(self, stopped: Sequence[int]) -> str:
        """That these joints' limits stopped the command, in words."""
        return "; ".join(
            f"{self.names[i]} stopped at its limit of {self.command[i]:.4f}" for i in stopped
        )

    def brake(self, dt: float) -> None:
        """Come to rest: the speed falls in a straight line within the stop time, or as slowly as
        the acceleration limits ask."""
        if self.command is None or self.is_at_rest:
            self._braking = None
            return
        if self._braking is None:
            needed = np.abs(self.velocity) / np.asarray(self.limits.acceleration)
            duration = max(self.settings.stop_time, float(needed.max()))
            self._braking = (self.velocity.copy(), duration, 0.0)
        first, duration, gone = self._braking
        gone += dt
        self._braking = (first, duration, gone)
        velocity = first * max(0.0, 1.0 - gone / duration)
        after = self.command + velocity * dt
        bounded = np.clip(after, *self._compute_bounds())
        self.command, self.velocity = bounded, np.where(bounded == after, velocity, 0.0)

    def _compute_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the command may go (n,), (n,): from beyond a limit back, not on."""
        low = np.minimum(self.limits.lower, self.command)
        return low, np.maximum(self.limits.upper, self.command)

    def make_command(
        self, t: float, measured: JointSample | None, effort: np.ndarray, reason: str, phase: str
    ) -> Command:
        """What goes to the joints' controllers at t (s), in the chosen output; nothing before
        joints were measured. `effort`: (n,) greatest, N m or N."""
        if self.command is None or measured is None:
            return Command(t, self.names, reason=reason, phase=phase)
        settings = self.settings
        if settings.output == "effort":
            values = np.asarray(settings.stiffness) * (self.command - measured.positions)
            values += np.asarray(settings.damping) * (self.velocity - measured.velocities)
            values = np.clip(values, -effort, effort)
        else:
            values = np.array(self.command if settings.output == "position" else self.velocity)
        return Command(t, self.names, values, settings.output, reason, phase)

    def limit_velocities(self, velocities: np.ndarray, dt: float) -> tuple[np.ndarray, str]:
        """Velocities (n,) of a controller of its own, slowed as a whole to the joints' limits.

        Returns:
            The velocities, and what slowed them in words.
        """
        limits, reasons = self.limits, []
        ratio = np.abs(velocities) / np.asarray(limits.velocity)
        fastest = int(np.argmax(ratio))
        if ratio[fastest] > 1.0:
            velocities = velocities / ratio[fastest]
            reasons.append(
                f"slowed to {100.0 / ratio[fastest]:.0f} % for the speed limit of "
                f"{self.names[fastest]}"
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
    """One step of the command from its place (n,) and velocity (n,).

    Returns:
        Where it goes (n,), from beyond a limit back and not on; at which velocities (n,); (n,)
        which joints a limit stops; (n,) which do not follow.
    """
    after = np.empty(len(command))
    stopped, late = np.empty(len(command), np.bool_), np.empty(len(command), np.bool_)
    for i in range(len(command)):
        wanted = command[i] + velocities[i] * dt
        after[i] = min(max(wanted, min(lower[i], command[i])), max(upper[i], command[i]))
        stopped[i] = after[i] != wanted
        before, ahead = abs(command[i] - measured[i]), abs(after[i] - measured[i])
        # One that stands where it was told to is not late, however long the first step is: a
        # flying camera asked for more than 5 rad/s from rest never set out.
        known = before > 0.5 * lead[i]
        late[i] = known and ahead > lead[i] + lag * abs(velocity[i]) and ahead > before
    return after, (after - command) / dt, stopped, late


@jit("f8[:], f8[:], f8[:], f8[:], f8[:], f8")
def has_jumped(positions, before, velocities, velocities_before, lead, dt):
    """Whether a joint went further in `dt` s than any motion; lead: one or (n,)."""
    for i in range(len(positions)):
        way = abs(positions[i] - before[i])
        speed = max(abs(velocities[i]), abs(velocities_before[i]))
        if way > JUMP * lead[min(i, len(lead) - 1)] and way > JUMP_SPEEDS * speed * dt:
            return True
    return False
