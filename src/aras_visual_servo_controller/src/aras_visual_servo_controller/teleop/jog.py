"""Driving by hand: joint commands from the speed of a joint, or from a twist of the camera.

What is asked counts for a moment only (`LASTS`): who wants to go on asks again, so that a key that
is let go, a closed page or a lost gamepad leave the arm standing. No ROS.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.names import describe_unknown

from ..errors import ConfigurationError
from ..kinematics import Arm, DifferentialIK, Limits
from ..kinematics.task import Task

COMMAND_LIFETIME = 0.3  # s for which a speed counts after it was asked for
RAMP_TIME = 0.25  # s in which a greatest speed is reached, and left again
# greatest speeds of the camera that RISE speaks of, m/s and rad/s
MAX_TWIST = (0.25,) * 3 + (1.0,) * 3
LONGEST_STEP = 0.1  # s; a longer pause between two ticks moves the arm no further than this
MAX_LEAD = 0.05  # rad or m by which a command may be ahead of its joint, which may be blocked
DEFAULT_JOINT_SPEED = 1.0  # rad/s or m/s of a joint without a limit of its own


class Jog:
    """Commands (n,) of one arm while a person drives it.

    Attributes:
        reason: why the arm does not do what is asked, in words; empty when it does.
        velocity: of the commands, (n,), rad/s or m/s.
        fastest: greatest speeds of the joints that may be asked for, (n,), rad/s or m/s.
    """

    def __init__(
        self, arm: Arm, limits: Limits, differential_ik: DifferentialIK | None = None
    ) -> None:
        """`differential_ik`: of the arm; None: one of its own, without secondary tasks."""
        self.arm, self.limits = arm, limits
        self._differential_ik = (
            differential_ik if differential_ik is not None else DifferentialIK(arm, limits)
        )
        self.max_speeds = np.where(
            np.isfinite(limits.velocity), limits.velocity, DEFAULT_JOINT_SPEED
        )
        self.release()

    def release(self) -> None:
        """Ask for nothing; the next command begins where the joints are."""
        self.reason = ""
        self._is_camera_twist = False
        self._desired = np.zeros(0)  # the twist (6,) or the joints' speeds (n,)
        self._ramped = np.zeros(0)  # of it what the arm is told now, for speed comes gradually
        self._expiry_time = -np.inf
        self.velocity = np.zeros(len(self.arm.names))
        self._command: np.ndarray | None = None
        self._time: float | None = None

    def set_twist(self, twist: Sequence[float], t: float) -> None:
        """Move the camera in its own frame, (6,) m/s and rad/s, from t (s) on.

        Raises:
            ConfigurationError: not six finite numbers.
        """
        values = np.array(twist, float)
        if values.shape != (6,) or not np.isfinite(values).all():
            raise ConfigurationError(f"a twist is six finite numbers, not {twist}")
        self._set_desired(values, True, t)

    def set_joint_speed(self, name: str, speed_fraction: float, t: float) -> None:
        """Move one joint with a part of its greatest speed, -1 to 1, from t (s) on.

        Raises:
            ConfigurationError: a joint that the arm has not, or no such part.
        """
        if name not in self.arm.names:
            raise ConfigurationError(describe_unknown("joint", name, self.arm.names))
        if not -1.0 <= speed_fraction <= 1.0:
            raise ConfigurationError(
                f"the speed of {name} is a part of -1 to 1, not {speed_fraction}"
            )
        row = self.arm.names.index(name)
        speeds = np.zeros(len(self.arm.names))
        speeds[row] = speed_fraction * self.max_speeds[row]
        self._set_desired(speeds, False, t)

    def _set_desired(self, values: np.ndarray, is_camera_twist: bool, t: float) -> None:
        if is_camera_twist != self._is_camera_twist or self._ramped.shape != values.shape:
            self._ramped = np.zeros_like(values)
        self._desired, self._is_camera_twist, self._expiry_time = (
            values,
            is_camera_twist,
            t + COMMAND_LIFETIME,
        )

    @property
    def is_moving(self) -> bool:
        """Whether commands are to be sent: something is asked for, or not all has come to rest."""
        return self._command is not None

    def update(self, t: float, positions: np.ndarray) -> np.ndarray | None:
        """The command (n,) at t (s), measured joints (n,); None: leave the joints alone."""
        asked = t < self._expiry_time
        if not asked and self._command is None:
            return None
        if self._command is None:
            self._command = np.array(positions, float)
            self._differential_ik.reset()
        dt = 0.0 if self._time is None else min(max(t - self._time, 0.0), LONGEST_STEP)
        self._time = t
        self._ramp(self._desired if asked else np.zeros_like(self._desired), dt)
        if not asked and not self._ramped.any():
            last = self._command
            self.release()
            return last
        self.velocity = self._compute_velocities(positions, dt)
        self._advance(positions, dt)
        return self._command.copy()

    def _ramp(self, desired: np.ndarray, dt: float) -> None:
        """What is given goes straight to what is wanted: a twist keeps its direction."""
        greatest = np.array(MAX_TWIST) if self._is_camera_twist else self.max_speeds
        way = desired - self._ramped
        longest = float(np.max(np.abs(way) / greatest))
        self._ramped = self._ramped + way * (
            1.0 if longest * RAMP_TIME <= dt else dt / RAMP_TIME / longest
        )

    def _compute_velocities(self, positions: np.ndarray, dt: float) -> np.ndarray:
        """Joint velocities (n,) for what is given."""
        self.reason = ""
        if not self._is_camera_twist:
            return self._ramped
        found = self._differential_ik.solve(
            positions, Task.from_twist(self._ramped), max(dt, 1e-3), self.velocity
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
        if not self._is_camera_twist:
            stopped = np.flatnonzero(inside != after)
            if stopped.size:
                self.reason = f"{self.arm.names[int(stopped[0])]} is at its limit"
        lead = MAX_LEAD + 0.15 * np.abs(self.velocity)
        self.velocity = np.where(inside == after, self.velocity, 0.0)
        self._command = np.clip(inside, positions - lead, positions + lead)
