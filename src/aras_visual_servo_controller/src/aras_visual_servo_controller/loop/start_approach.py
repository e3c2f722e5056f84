"""The way to the start pose, with the camera's eyes shut."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..records.state import ServoSettings


class StartApproach:
    """Smoothstep from where the joints are to the start; then pushes what hangs in friction."""

    def __init__(
        self,
        names: Sequence[str],
        velocity: np.ndarray,
        settings: ServoSettings,
        acceleration: np.ndarray | float = np.inf,
        destination: str = "the start pose",
    ) -> None:
        """`velocity`, `acceleration`: (n,) greatest of the joints, rad/s or m/s, and per second;
        `destination`: the path ends, for messages."""
        n = len(names)
        self.names, self.settings, self._destination = tuple(names), settings, destination
        self.start = np.array(settings.start, float)
        self._speed = settings.approach_speed * np.minimum(np.asarray(velocity, float), 1e3)
        self._acceleration = np.broadcast_to(np.asarray(acceleration, float), (n,))
        self._tolerance = np.broadcast_to(np.asarray(settings.arrived, float), (n,))
        self._lead = np.broadcast_to(np.asarray(settings.lead, float), (n,))
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.is_done = False
        self.reason = ""
        # From where (n,), since when and for how long, s.
        self._path: tuple[np.ndarray, float, float] | None = None
        self._push_offset = np.zeros(len(self.names))
        self._arrival_time: float | None = None

    def compute_command(self, t: float, dt: float, positions: np.ndarray) -> np.ndarray:
        """Positions (n,) to command at t (s), dt after the last; measured positions (n,)."""
        if self._path is None:
            origin = np.array(positions, float)
            # Smoothstep peaks at 1.5 times its mean speed, and begins and ends at 6 way / time^2.
            way = np.abs(self.start - origin)
            least = np.maximum(1.5 * way / self._speed, np.sqrt(6.0 * way / self._acceleration))
            self._path = origin, t, max(float(np.max(least)), 1e-3)
        origin, since, duration = self._path
        part = (t - since) / duration
        if part < 1.0:
            blend = part * part * (3.0 - 2.0 * part)
            return origin + blend * (self.start - origin)
        missing = self.start - positions
        far = np.abs(missing) > self._tolerance
        push = np.where(np.abs(missing) < 0.5 * self._tolerance, 0.0, missing)
        push = np.clip(self.settings.push * push, -self._speed, self._speed)
        self._push_offset = np.clip(self._push_offset + push * dt, -self._lead, self._lead)
        self.reason = ""
        if far.any():
            self._arrival_time = None
            self.reason = f"waiting at {self._destination} for " + ", ".join(
                f"{self.names[i]} ({positions[i]:.4f}, to be {self.start[i]:.4f})"
                for i in np.flatnonzero(far)
            )
        elif self._arrival_time is None:
            self._arrival_time = t
        elif t - self._arrival_time >= self.settings.settle:
            self.is_done = True
        return self.start + self._push_offset
