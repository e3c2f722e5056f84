"""Limits of position, speed and acceleration, applied to one step's velocities."""

import numpy as np

from aras_visual_servo_camera.compiled import FLAG, NUMBER, VECTOR, compiled

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
        limits = self.limits
        return _ranges(q, limits.lower, limits.upper, limits.acceleration, dt)

    def allow(self, q: np.ndarray, velocities: np.ndarray, dt: float) -> bool:
        """Whether the ranges allow these velocities (n,) for dt (s)."""
        low, high = self.positions(q, dt)
        return bool(((velocities >= low) & (velocities <= high)).all())

    def apply(
        self,
        primary: np.ndarray,
        secondary: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        dt: float,
        previous: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray, float, int | None]:
        """Velocities (n,), their part for the task (n,), its scale, and the joint that slowed it.

        Args:
            primary: velocities (n,) for the task.
            secondary: (n,) those that the task does not see.
            low, high: of `positions`.
            dt: s.
            previous: velocities (n,) commanded before, or None.
        """
        limits = self.limits
        limited = previous is not None and self._accelerates and dt > 0.0
        before = np.asarray(previous, float) if limited else primary
        total, task = (before, before) if self._total is None else (self._total, self._primary)
        total, task, scale, slowest = _within(
            primary, secondary, low, high, limits.velocity, limits.acceleration, dt, limited,
            before, total, task,
        )  # fmt: skip
        self._total, self._primary = total, task
        return total, task, scale, None if slowest < 0 else slowest


@compiled(NUMBER, NUMBER, NUMBER)
def _stoppable(room, acceleration, dt):
    """Greatest speed for dt (s) after which a joint still stops within its room.

    v dt + v^2 / 2a = room; so much later steps can always keep, however long they are.
    """
    if dt <= 0.0 or room == np.inf:
        return np.inf
    if acceleration == np.inf:
        return room / dt
    # room / (dt / 2 + sqrt(...) / 2), which does not cancel where the room is small
    return 2.0 * room / (dt + np.sqrt(dt * dt + 2.0 * room / acceleration))


@compiled(VECTOR, VECTOR, VECTOR, VECTOR, NUMBER)
def _ranges(q, lower, upper, acceleration, dt):
    """See Bounds.positions."""
    low, high = np.empty(len(q)), np.empty(len(q))
    for i in range(len(q)):
        low[i] = -_stoppable(max(q[i] - lower[i], 0.0), acceleration[i], dt)
        high[i] = _stoppable(max(upper[i] - q[i], 0.0), acceleration[i], dt)
    return low, high


@compiled(VECTOR, VECTOR)
def _part(wanted, room):
    """Greatest part, up to 1, of wanted (n,) that the rooms (n,) >= 0 allow; and who limits it."""
    part, joint = 1.0, 0
    for i in range(len(wanted)):
        size = abs(wanted[i])
        if size > room[i] and max(room[i], 0.0) / size < part:
            part, joint = max(room[i], 0.0) / size, i
    return part, joint


@compiled(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, NUMBER, FLAG, VECTOR, VECTOR, VECTOR)
def _within(
    wanted, secondary, low, high, fastest, acceleration, dt, limited, previous, total, task
):
    """See Bounds.apply; limited: by acceleration from the previous velocities (n,) on, of which
    `task` served the task if they are the total. Slowest: -1 for none."""
    part, slowest = _part(wanted, fastest)
    primary = part * wanted
    if part == 1.0:
        slowest = -1
    low, high = np.maximum(low, -fastest), np.minimum(high, fastest)
    others = np.zeros(len(wanted))
    if limited:
        before = task if np.abs(previous - total).max() < 1e-9 else previous
        others = previous - before
        change = acceleration * dt
        part, joint = _part(primary - before, change)
        if part < 1.0:
            slowest, primary = joint, before + part * (primary - before)
        # A joint that has to brake for its range, and cannot brake harder, does what it can.
        low = np.minimum(np.maximum(low, previous - change), previous + change)
        high = np.minimum(np.maximum(high, previous - change), previous + change)
    base = np.minimum(np.maximum(primary + others, low), high)
    # What the task leaves of the limits; the secondary tasks change as far as it goes.
    towards = secondary - others
    part, _ = _part(towards, np.where(towards > 0.0, high - base, base - low))
    scale = 1.0
    if slowest >= 0:
        scale = (primary * wanted).sum() / (wanted * wanted).sum()
    return base + part * towards, primary, scale, slowest
