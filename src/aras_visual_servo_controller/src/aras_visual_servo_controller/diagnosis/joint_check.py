"""Whether the joints do what they are told: what was commanded beside what they measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..observation.recent_errors import RecentErrors


class JointCheck:
    """Looks at the last SPAN for joints that stay behind their commands, or swing by themselves.

    A joint stays behind where the loop waits for it: see `lead` and `lag` of the settings; or
    waits at times, and the joint has gone none of the way that was commanded.
    """

    SPAN = 1.5  # s
    MAX_WAITING_PART = 0.6  # part of the images at which the loop has to wait for a joint
    # Part of the images at which the loop waits for a joint that goes less than the second part of
    # its way.
    MIN_WAITING_PART, MIN_MOTION_PART = 0.1, 0.1
    SLOW_SPEED = 1e-3  # rad/s or m/s above which a joint that stays behind is slow, and not blocked
    # A joint swings by itself where its speed differs from the commanded one, rms, by more than
    # this, rad/s or m/s, and by more than so many times the commanded one.
    MIN_SPEED_ERROR, SPEED_ERROR_FACTOR = 0.5, 3.0
    CHECK_PERIOD = 5  # images from one look to the next
    MIN_SPAN = 0.3  # s after which a joint that swings is told; one that stays behind after SPAN

    def __init__(self, names: Sequence[str] = (), lengths: np.ndarray | float = 1.0) -> None:
        """`names`: of the n joints. `lengths`: (n,) of each, what counts as much as 1 rad or m."""
        self._names, self._lengths = tuple(names), np.asarray(lengths, float)
        self._samples = RecentErrors()
        self._new_images = 0
        self.joints, self.reason = "", ""
        self.is_slow = False  # whether those that stay behind do move to their commands, but slowly

    def add(
        self, stamp: float, late: np.ndarray, commanded: np.ndarray, measured: np.ndarray
    ) -> None:
        """Take in the joints at one image.

        Args:
            stamp: s. late: (n,) whether the loop waits for each joint.
            commanded, measured: (n,) velocities, rad/s or m/s.
        """
        seen = self._samples
        seen.add(stamp, np.concatenate([
            late, commanded / self._lengths, measured / self._lengths
        ]))  # fmt: skip
        self._new_images += 1
        if self._new_images >= self.CHECK_PERIOD:
            self._new_images = 0
            seen.drop_oldest(int(np.searchsorted(seen.stamps, stamp - self.SPAN)))
            self._judge(stamp - seen.stamps[0])

    def _judge(self, span: float) -> None:
        rows = self._samples.errors
        late, waits, gone, asked, other, fast = _sum_rows(rows)
        behind = late > 0.0
        if waits <= self.MAX_WAITING_PART:
            behind = (gone < self.MIN_MOTION_PART * asked) & (late > self.MIN_WAITING_PART)
        behind &= span >= 0.9 * self.SPAN
        swings = (
            (span > self.MIN_SPAN)
            & (other > self.MIN_SPEED_ERROR**2)
            & (other > self.SPEED_ERROR_FACTOR**2 * asked)
        )
        self.joints = self._format_names(swings if swings.any() else behind)
        self.is_slow = not swings.any() and bool((fast[behind] > self.SLOW_SPEED).all())
        self.reason = ""
        if swings.any():
            fastest = fast[swings].max()
            self.reason = f"{self.joints} moves at up to {fastest:.1f} rad/s or m/s on its own"
        elif behind.any():
            self.reason = f"{self.joints} stays behind its command"

    def _format_names(self, joints: np.ndarray) -> str:
        """The names of some joints, (n,) bool, in words."""
        names = [name for name, said in zip(self._names, joints, strict=True) if said]
        return join_names(names)


def join_names(names: Sequence[str]) -> str:
    """'a, b and c'."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def describe_foreign_nodes(nodes: Mapping[str, str]) -> str:
    """Report which other nodes command which joints, from {joint: node}; '' where none does."""
    joints = {node: [j for j, n in nodes.items() if n == node] for node in nodes.values()}
    return "; ".join(f"{node} commands {join_names(names)}" for node, names in joints.items())


@jit("f8[:,:]")
def _sum_rows(rows):
    """Of rows (m, 3 n), whether each joint was late, its commanded and measured velocities.

    Returns:
        (n,) parts of the rows in which a joint was late; the part in which one was; (n,) means of
        commanded times measured, commanded squared, their difference squared; (n,) greatest speeds.
    """
    count, n = rows.shape[0], rows.shape[1] // 3
    sums, fast, waits = np.zeros((4, n)), np.zeros(n), 0.0
    for row in rows:
        some = 0.0
        for i in range(n):
            asked, measured = row[n + i], row[2 * n + i]
            sums[0, i] += row[i]
            sums[1, i] += asked * measured
            sums[2, i] += asked * asked
            sums[3, i] += (measured - asked) ** 2
            fast[i] = max(fast[i], abs(measured))
            some = max(some, row[i])
        waits += some
    for k in range(4):
        for i in range(n):
            sums[k, i] /= count
    return sums[0], waits / count, sums[1], sums[2], sums[3], fast
