"""Motion to the start pose, without images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..records.state import ServoSettings


class StartApproach:
    """Smoothstep path to the start pose, with an integral correction for friction at its end."""

    def __init__(
        self,
        names: Sequence[str],
        velocity: np.ndarray,
        settings: ServoSettings,
        acceleration: np.ndarray | float = np.inf,
        destination: str = "the start pose",
    ) -> None:
        """Create the path.

        Args:
            velocity: (n,) largest joint speeds, rad/s or m/s.
            acceleration: (n,) largest joint accelerations, rad/s² or m/s².
            destination: name of the end of the path, for messages.
        """
        n = len(names)
        self.names, self.settings, self._destination = tuple(names), settings, destination
        self.start = np.array(settings.start, float)
        self._speed = settings.approach_speed * np.minimum(np.asarray(velocity, float), 1e3)
        self._acceleration = np.broadcast_to(np.asarray(acceleration, float), (n,))
        self._tolerance = np.broadcast_to(np.asarray(settings.arrived, float), (n,))
        self._lead = np.broadcast_to(np.asarray(settings.lead, float), (n,))
        self.reset()

    def reset(self) -> None:
        """Restart the path at the next command."""
        self.is_done = False
        self.reason = ""
        # Initial joints (n,), start time (s) and duration (s) of the path.
        self._path: tuple[np.ndarray, float, float] | None = None
        self._push_offset = np.zeros(len(self.names))
        self._arrival_time: float | None = None

    def compute_command(self, t: float, dt: float, positions: np.ndarray) -> np.ndarray:
        """Return the positions (n,) to command.

        Args:
            t: time, s.
            dt: time since the last command, s.
            positions: (n,) measured joint positions.
        """
        if self._path is None:
            origin = np.array(positions, float)
            # The smoothstep s(x) = 3 x^2 - 2 x^3 has a peak speed of 1.5 times the mean speed, and
            # an acceleration of 6 distance / time^2 at both ends.
            distance = np.abs(self.start - origin)
            min_duration = np.maximum(
                1.5 * distance / self._speed, np.sqrt(6.0 * distance / self._acceleration)
            )
            self._path = origin, t, max(float(np.max(min_duration)), 1e-3)
        origin, start_time, duration = self._path
        part = (t - start_time) / duration
        if part < 1.0:
            blend = part * part * (3.0 - 2.0 * part)
            return origin + blend * (self.start - origin)
        offset = self.start - positions
        is_far = np.abs(offset) > self._tolerance
        push = np.where(np.abs(offset) < 0.5 * self._tolerance, 0.0, offset)
        push = np.clip(self.settings.push * push, -self._speed, self._speed)
        self._push_offset = np.clip(self._push_offset + push * dt, -self._lead, self._lead)
        self.reason = ""
        if is_far.any():
            self._arrival_time = None
            self.reason = f"waiting at {self._destination} for " + ", ".join(
                f"{self.names[i]} (at {positions[i]:.4f}, desired {self.start[i]:.4f})"
                for i in np.flatnonzero(is_far)
            )
        elif self._arrival_time is None:
            self._arrival_time = t
        elif t - self._arrival_time >= self.settings.settle:
            self.is_done = True
        return self.start + self._push_offset
