"""Limits of position, speed and acceleration, applied to one step's velocities."""

import numpy as np

from .limits import Limits


class Bounds:
    """Keeps velocities such that no limit is passed, now or by what must follow.

    A joint may run towards its limit only so fast that its greatest deceleration still stops it
    there, in steps of dt.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._accelerates = bool(np.isfinite(limits.acceleration).any())
        self.reset()

    def reset(self) -> None:
        """Forget the last velocities."""
        self._total: np.ndarray | None = None
        self._primary: np.ndarray | None = None

    def positions(self, q: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest velocities (n,) that the ranges of the joints allow.

        A joint outside its range may come back, and not go further.
        """
        if dt <= 0.0:
            return np.full(len(q), -np.inf), np.full(len(q), np.inf)
        limits = self.limits
        below = np.maximum(q - limits.lower, 0.0)
        above = np.maximum(limits.upper - q, 0.0)
        if not self._accelerates:
            return -below / dt, above / dt
        return -_stoppable(below, limits.acceleration, dt), _stoppable(
            above, limits.acceleration, dt
        )

    def apply(
        self,
        q: np.ndarray,
        primary: np.ndarray,
        secondary: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        dt: float,
        previous: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray, float, int | None]:
        """Velocities (n,), their part for the task (n,), its scale, and the joint that slowed it.

        Args:
            q: joints (n,).
            primary: velocities (n,) for the task.
            secondary: (n,) those that the task does not see.
            low, high: of `positions`.
            dt: s.
            previous: velocities (n,) commanded before, or None.
        """
        fastest = self.limits.velocity
        ratio = np.abs(primary) / fastest
        joint, slowest, wanted = int(ratio.argmax()), None, primary
        if ratio[joint] > 1.0:
            slowest, primary = joint, primary / ratio[joint]
        low, high = np.maximum(low, -fastest), np.minimum(high, fastest)
        others = np.zeros(len(primary))
        if previous is not None and self._accelerates and dt > 0.0:
            previous = np.asarray(previous, float)
            before = self._before(previous)
            others = previous - before
            change = self.limits.acceleration * dt
            part, joint = _part(primary - before, change)
            if part < 1.0:
                slowest, primary = joint, before + part * (primary - before)
            # A joint that has to brake for its range, and cannot brake harder, does what it can.
            low = np.clip(low, previous - change, previous + change)
            high = np.clip(high, previous - change, previous + change)
        base = np.minimum(np.maximum(primary + others, low), high)
        # What the task leaves of the limits; the secondary tasks change as far as it goes.
        towards = secondary - others
        part, _ = _part(towards, np.where(towards > 0.0, high - base, base - low))
        total = base + part * towards
        self._total, self._primary = total, primary
        scale = 1.0 if slowest is None else float(primary @ wanted / (wanted @ wanted))
        return total, primary, scale, slowest

    def _before(self, previous: np.ndarray) -> np.ndarray:
        """The part of the last velocities that served the task, as far as they are ours."""
        if self._total is not None and np.abs(previous - self._total).max() < 1e-9:
            return self._primary
        return previous


def _part(wanted: np.ndarray, room: np.ndarray) -> tuple[float, int]:
    """Greatest part, up to 1, of wanted (n,) that the rooms (n,) >= 0 allow; and who limits it."""
    size = np.abs(wanted)
    beyond = size > room
    if not any(beyond.tolist()):
        return 1.0, 0
    parts = np.where(beyond, np.maximum(room, 0.0) / np.where(beyond, size, 1.0), 1.0)
    joint = int(parts.argmin())
    return float(parts[joint]), joint


def _stoppable(room: np.ndarray, acceleration: np.ndarray, dt: float) -> np.ndarray:
    """Greatest speed (n,) for dt (s) after which a joint still stops within its room (n,).

    v dt + v^2 / 2a = room; so much later steps can always keep, however long they are.
    """
    finite = np.where(np.isfinite(acceleration), acceleration, 1.0)
    near = np.where(np.isfinite(room), room, 0.0)
    # room / (dt / 2 + sqrt(...) / 2), which does not cancel where the room is small
    speed = 2.0 * near / (dt + np.sqrt(dt * dt + 2.0 * near / finite))
    speed = np.where(np.isfinite(acceleration), speed, room / dt)
    return np.where(np.isfinite(room), speed, np.inf)
