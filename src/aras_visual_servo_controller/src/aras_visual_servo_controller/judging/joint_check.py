"""Whether the joints do what they are told: what was commanded beside what they measured."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np


class JointCheck:
    """Looks at the last SPAN for joints that stay behind their commands, or swing by themselves.

    A joint stays behind where the loop waits for it: see `lead` and `lag` of the settings; or
    waits at times, and the joint has gone none of the way that was commanded.
    """

    SPAN = 1.5  # s
    MOST = 0.6  # part of the images at which the loop has to wait for a joint
    # Part of the images at which the loop waits for a joint that goes less than the second part of
    # its way.
    AT_TIMES, GONE = 0.1, 0.1
    # A joint swings by itself where its speed differs from the commanded one, rms, by more than
    # this, rad/s or m/s, and by more than so many times the commanded one.
    FAST, TIMES = 0.5, 3.0
    EVERY = 5  # images from one look to the next
    SOON = 0.3  # s after which a joint that swings is told; one that stays behind after SPAN

    def __init__(self, names: Sequence[str] = ()) -> None:
        """`names`: of the n joints."""
        self._names = tuple(names)
        self._seen: deque[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = deque()
        self._new = 0
        self.joints, self.reason = "", ""

    def add(
        self, stamp: float, late: np.ndarray, commanded: np.ndarray, measured: np.ndarray
    ) -> None:
        """Take in the joints at one image.

        Args:
            stamp: s. late: (n,) whether the loop waits for each joint.
            commanded, measured: (n,) velocities, rad/s or m/s.
        """
        seen = self._seen
        seen.append((stamp, late, commanded, measured))
        while seen[0][0] < stamp - self.SPAN:
            seen.popleft()
        self._new += 1
        if self._new >= self.EVERY:
            self._new = 0
            self._judge(stamp - seen[0][0])

    def _judge(self, span: float) -> None:
        late, commanded, measured = (
            np.array([row[column] for row in self._seen]) for column in (1, 2, 3)
        )
        behind = late.mean(axis=0) > 0.0
        if late.any(axis=1).mean() <= self.MOST:
            gone = (measured * commanded).sum(axis=0)
            stands = gone < self.GONE * (commanded**2).sum(axis=0)
            behind = stands & (late.mean(axis=0) > self.AT_TIMES)
        behind &= span >= 0.9 * self.SPAN
        asked = np.sqrt((commanded**2).mean(axis=0))
        other = np.sqrt(((measured - commanded) ** 2).mean(axis=0))
        swings = (span > self.SOON) & (other > self.FAST) & (other > self.TIMES * asked)
        self.joints = self._named(swings if swings.any() else behind)
        self.reason = ""
        if swings.any():
            fastest = float(np.abs(measured[:, swings]).max())
            self.reason = f"{self.joints} moves at up to {fastest:.1f} rad/s or m/s on its own"
        elif behind.any():
            self.reason = f"{self.joints} stays behind its command"

    def _named(self, joints: np.ndarray) -> str:
        """The names of some joints, (n,) bool, in words."""
        names = [name for name, said in zip(self._names, joints, strict=True) if said]
        return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
