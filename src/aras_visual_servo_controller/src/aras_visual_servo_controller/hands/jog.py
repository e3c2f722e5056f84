"""Driving by hand: joint commands from the speed of a joint, or from a twist of the camera.

What is asked counts for a moment only (`LASTS`): who wants to go on asks again, so that a key that
is let go, a closed page or a lost gamepad leave the arm standing. No ROS.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.names import unknown

from ..arm import Arm, Limits, Resolver
from ..arm.task import Task
from ..errors import ConfigurationError

LASTS = 0.3  # s for which a speed counts after it was asked for
RISE = 0.25  # s in which a greatest speed is reached, and left again
TWIST = (0.25,) * 3 + (1.0,) * 3  # greatest speeds of the camera that RISE speaks of, m/s and rad/s
LONGEST_STEP = 0.1  # s; a longer pause between two ticks moves the arm no further than this
LEAD = 0.05  # rad or m by which a command may be ahead of its joint, which may be blocked
JOINT_SPEED = 1.0  # rad/s or m/s of a joint without a limit of its own


class Jog:
    """Commands (n,) of one arm while a person drives it.

    Attributes:
        reason: why the arm does not do what is asked, in words; empty when it does.
        velocity: of the commands, (n,), rad/s or m/s.
        fastest: greatest speeds of the joints that may be asked for, (n,), rad/s or m/s.
    """

    def __init__(self, arm: Arm, limits: Limits, resolver: Resolver | None = None) -> None:
        """`resolver`: of the arm; None: one of its own, without secondary tasks."""
        self.arm, self.limits = arm, limits
        self._resolver = resolver if resolver is not None else Resolver(arm, limits)
        self.fastest = np.where(np.isfinite(limits.velocity), limits.velocity, JOINT_SPEED)
        self.release()

    def release(self) -> None:
        """Ask for nothing; the next command begins where the joints are."""
        self.reason = ""
        self._of_camera = False
        self._asked = np.zeros(0)  # the twist (6,) or the joints' speeds (n,)
        self._given = np.zeros(0)  # of it what the arm is told now, for speed comes gradually
        self._until = -np.inf
        self.velocity = np.zeros(len(self.arm.names))
        self._command: np.ndarray | None = None
        self._time: float | None = None

    def twist(self, twist: Sequence[float], t: float) -> None:
        """Move the camera in its own frame, (6,) m/s and rad/s, from t (s) on.

        Raises:
            ConfigurationError: not six finite numbers.
        """
        values = np.array(twist, float)
        if values.shape != (6,) or not np.isfinite(values).all():
            raise ConfigurationError(f"a twist is six finite numbers, not {twist}")
        self._ask(values, True, t)

    def joint(self, name: str, part: float, t: float) -> None:
        """Move one joint with a part of its greatest speed, -1 to 1, from t (s) on.

        Raises:
            ConfigurationError: a joint that the arm has not, or no such part.
        """
        if name not in self.arm.names:
            raise ConfigurationError(unknown("joint", name, self.arm.names))
        if not -1.0 <= part <= 1.0:
            raise ConfigurationError(f"the speed of {name} is a part of -1 to 1, not {part}")
        row = self.arm.names.index(name)
        speeds = np.zeros(len(self.arm.names))
        speeds[row] = part * self.fastest[row]
        self._ask(speeds, False, t)

    def _ask(self, values: np.ndarray, of_camera: bool, t: float) -> None:
        if of_camera != self._of_camera or self._given.shape != values.shape:
            self._given = np.zeros_like(values)
        self._asked, self._of_camera, self._until = values, of_camera, t + LASTS

    @property
    def moving(self) -> bool:
        """Whether commands are to be sent: something is asked for, or not all has come to rest."""
        return self._command is not None

    def tick(self, t: float, positions: np.ndarray) -> np.ndarray | None:
        """The command (n,) at t (s), measured joints (n,); None: leave the joints alone."""
        asked = t < self._until
        if not asked and self._command is None:
            return None
        if self._command is None:
            self._command = np.array(positions, float)
            self._resolver.reset()
        dt = 0.0 if self._time is None else min(max(t - self._time, 0.0), LONGEST_STEP)
        self._time = t
        self._rise(self._asked if asked else np.zeros_like(self._asked), dt)
        if not asked and not self._given.any():
            last = self._command
            self.release()
            return last
        self.velocity = self._velocities(positions, dt)
        self._advance(positions, dt)
        return self._command.copy()

    def _rise(self, wanted: np.ndarray, dt: float) -> None:
        """What is given goes straight to what is wanted: a twist keeps its direction."""
        greatest = np.array(TWIST) if self._of_camera else self.fastest
        way = wanted - self._given
        longest = float(np.max(np.abs(way) / greatest))
        self._given = self._given + way * (1.0 if longest * RISE <= dt else dt / RISE / longest)

    def _velocities(self, positions: np.ndarray, dt: float) -> np.ndarray:
        """Joint velocities (n,) for what is given."""
        self.reason = ""
        if not self._of_camera:
            return self._given
        found = self._resolver.resolve(
            positions, Task.of_twist(self._given), max(dt, 1e-3), self.velocity
        )
        self.reason = "; ".join(found.reasons)
        return found.velocities

    def _advance(self, positions: np.ndarray, dt: float) -> None:
        """On by dt, within the limits, and never far ahead of the joints."""
        after = self._command + self.velocity * dt
        # Where a joint stands outside its limits already it may come back, not go further.
        low = np.minimum(self.limits.lower, self._command)
        high = np.maximum(self.limits.upper, self._command)
        inside = np.clip(after, low, high)
        if not self._of_camera:
            stopped = np.flatnonzero(inside != after)
            if stopped.size:
                self.reason = f"{self.arm.names[int(stopped[0])]} is at its limit"
        lead = LEAD + 0.15 * np.abs(self.velocity)
        self.velocity = np.where(inside == after, self.velocity, 0.0)
        self._command = np.clip(inside, positions - lead, positions + lead)
