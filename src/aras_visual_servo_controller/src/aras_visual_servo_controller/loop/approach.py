"""The way to the start pose, with the camera's eyes shut."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..records.state import ServoSettings


class Approach:
    """Smoothstep from where the joints are to the start; then pushes what hangs in friction."""

    def __init__(
        self,
        names: Sequence[str],
        velocity: np.ndarray,
        settings: ServoSettings,
        acceleration: np.ndarray | float = np.inf,
        where: str = "the start pose",
    ) -> None:
        """`velocity`, `acceleration`: (n,) greatest of the joints, rad/s or m/s, and per second;
        `where`: the path ends, for messages."""
        n = len(names)
        self.names, self.settings, self._where = tuple(names), settings, where
        self.start = np.array(settings.start, float)
        self._speed = settings.approach_speed * np.minimum(np.asarray(velocity, float), 1e3)
        self._acceleration = np.broadcast_to(np.asarray(acceleration, float), (n,))
        self._arrived = np.broadcast_to(np.asarray(settings.arrived, float), (n,))
        self._lead = np.broadcast_to(np.asarray(settings.lead, float), (n,))
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.done = False
        self.reason = ""
        # From where (n,), since when and for how long, s.
        self._way: tuple[np.ndarray, float, float] | None = None
        self._pushed = np.zeros(len(self.names))
        self._arrived_at: float | None = None

    def command(self, t: float, dt: float, positions: np.ndarray) -> np.ndarray:
        """Positions (n,) to command at t (s), dt after the last; measured positions (n,)."""
        if self._way is None:
            origin = np.array(positions, float)
            # Smoothstep peaks at 1.5 times its mean speed, and begins and ends at 6 way / time^2.
            way = np.abs(self.start - origin)
            least = np.maximum(1.5 * way / self._speed, np.sqrt(6.0 * way / self._acceleration))
            self._way = origin, t, max(float(np.max(least)), 1e-3)
        origin, since, duration = self._way
        part = (t - since) / duration
        if part < 1.0:
            blend = part * part * (3.0 - 2.0 * part)
            return origin + blend * (self.start - origin)
        missing = self.start - positions
        far = np.abs(missing) > self._arrived
        push = np.where(np.abs(missing) < 0.5 * self._arrived, 0.0, missing)
        push = np.clip(self.settings.push * push, -self._speed, self._speed)
        self._pushed = np.clip(self._pushed + push * dt, -self._lead, self._lead)
        self.reason = ""
        if far.any():
            self._arrived_at = None
            self.reason = f"waiting at {self._where} for " + ", ".join(
                f"{self.names[i]} ({positions[i]:.4f}, to be {self.start[i]:.4f})"
                for i in np.flatnonzero(far)
            )
        elif self._arrived_at is None:
            self._arrived_at = t
        elif t - self._arrived_at >= self.settings.settle:
            self.done = True
        return self.start + self._pushed
