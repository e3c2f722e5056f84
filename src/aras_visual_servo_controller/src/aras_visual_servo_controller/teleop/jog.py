"""Jogging without ROS: joint commands from the speed of one joint or from a camera twist.

A requested speed is valid only for COMMAND_LIFETIME and must be repeated. Therefore the arm stops
when a key is released, a web page is closed or a gamepad loses its connection.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.names import describe_unknown

from ..errors import ConfigurationError
from ..kinematics import Arm, CommandLimits, DifferentialIK
from ..kinematics.task import Task

COMMAND_LIFETIME = 0.3  # time for which a requested speed is valid, s
RAMP_TIME = 0.25  # time from rest to the maximum speed, and from the maximum speed to rest, s
# Maximum speeds of the camera, in m/s and rad/s.
MAX_TWIST = (0.25,) * 3 + (1.0,) * 3
# Longest time step, s; a longer time between two commands is integrated as this step.
LONGEST_STEP = 0.1
# Largest distance between a command and the measured joint, rad or m. It limits the command if the
# joint is blocked.
MAX_LEAD = 0.05
DEFAULT_JOINT_SPEED = 1.0  # maximum speed of a joint without a speed limit, rad/s or m/s


class Jog:
    """Generator of joint commands (n,) while an operator moves the arm.

    Attributes:
        reason: why the arm does not follow the request, as text; '' if it does.
        velocity: (n,) velocities of the commands, rad/s or m/s.
        max_speeds: (n,) maximum joint speeds, rad/s or m/s.
    """

    def __init__(self, arm: Arm, limits: CommandLimits) -> None:
        """Create the generator for an arm and the joint limits of its commands."""
        self.arm, self.limits = arm, limits
        self._differential_ik = DifferentialIK(arm, limits)
        self.max_speeds = np.where(
            np.isfinite(limits.velocity), limits.velocity, DEFAULT_JOINT_SPEED
        )
        self.release()

    def release(self) -> None:
        """Cancel the request; the next command starts at the measured joint positions."""
        self.reason = ""
        self._is_camera_twist = False
        self._desired = np.zeros(0)  # requested camera twist (6,) or joint speeds (n,)
        self._ramped = np.zeros(0)  # requested twist or speeds after the acceleration ramp
        self._expiry_time = -np.inf
        self.velocity = np.zeros(len(self.arm.names))
        self._command: np.ndarray | None = None
        self._time: float | None = None

    def set_twist(self, twist: Sequence[float], t: float) -> None:
        """Request a camera twist (6,) in the camera frame, m/s and rad/s, at time t (s).

        Raises:
            ConfigurationError: the twist is not six finite numbers.
        """
        values = np.array(twist, float)
        if values.shape != (6,) or not np.isfinite(values).all():
            raise ConfigurationError(f"a twist must be six finite numbers, not {twist}")
        self._set_desired(values, True, t)

    def set_joint_speed(self, name: str, speed_fraction: float, t: float) -> None:
        """Request a speed of one joint at the time t (s).

        Args:
            name: name of the joint.
            speed_fraction: speed as a fraction of the joint's maximum speed, -1 to 1.
            t: time of the request, s.

        Raises:
            ConfigurationError: the joint is unknown, or the fraction is out of range.
        """
        if name not in self.arm.names:
            raise ConfigurationError(describe_unknown("joint", name, self.arm.names))
        if not -1.0 <= speed_fraction <= 1.0:
            raise ConfigurationError(
                f"the speed of {name} must be a fraction from -1 to 1, not {speed_fraction}"
            )
        row = self.arm.names.index(name)
        speeds = np.zeros(len(self.arm.names))
        speeds[row] = speed_fraction * self.max_speeds[row]
        self._set_desired(speeds, False, t)

    def _set_desired(self, values: np.ndarray, is_camera_twist: bool, t: float) -> None:
        if is_camera_twist != self._is_camera_twist or self._ramped.shape != values.shape:
            self._ramped = np.zeros_like(values)
        self._desired, self._is_camera_twist = values, is_camera_twist
        self._expiry_time = t + COMMAND_LIFETIME

    def update(self, t: float, positions: np.ndarray) -> np.ndarray | None:
        """Compute the command (n,) at the time t (s) from measured joint positions (n,).

        Return None if no command has to be sent.
        """
        is_requested = t < self._expiry_time
        if not is_requested and self._command is None:
            return None
        if self._command is None:
            self._command = np.array(positions, float)
            self._differential_ik.reset()
        dt = 0.0 if self._time is None else min(max(t - self._time, 0.0), LONGEST_STEP)
        self._time = t
        self._ramp(self._desired if is_requested else np.zeros_like(self._desired), dt)
        if not is_requested and not self._ramped.any():
            last = self._command
            self.release()
            return last
        self.velocity = self._compute_velocities(positions, dt)
        self._advance(positions, dt)
        return self._command.copy()

    def _ramp(self, desired: np.ndarray, dt: float) -> None:
        """Change `_ramped` towards the desired speeds or twist, limited by RAMP_TIME.

        All components change in proportion, so that a twist keeps its direction.
        """
        max_speeds = np.array(MAX_TWIST) if self._is_camera_twist else self.max_speeds
        difference = desired - self._ramped
        largest = float(np.max(np.abs(difference) / max_speeds))
        self._ramped = self._ramped + difference * (
            1.0 if largest * RAMP_TIME <= dt else dt / RAMP_TIME / largest
        )

    def _compute_velocities(self, positions: np.ndarray, dt: float) -> np.ndarray:
        """Compute the joint velocities (n,) for the present twist or joint speeds in `_ramped`."""
        self.reason = ""
        if not self._is_camera_twist:
            return self._ramped
        found = self._differential_ik.solve(
            positions, Task.from_twist(self._ramped), max(dt, 1e-3), self.velocity
        )
        self.reason = "; ".join(found.reasons)
        return found.velocities

    def _advance(self, positions: np.ndarray, dt: float) -> None:
        """Integrate the command over dt (s), within the limits and close to `positions`."""
        after = self._command + self.velocity * dt
        # A joint that is already outside its limits may return, but not move further out.
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
