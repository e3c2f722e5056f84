"""History of joint states, which gives the joints at the exposure of an image.

Images and joint states arrive over different connections. Between two samples the joints are
interpolated; after the last sample they are extrapolated with its velocity. In lockstep, where the
simulation waits for the controller, runs must be repeatable bit for bit and must not depend on the
order in which messages arrive. There, an image waits until all joint states up to its exposure have
arrived, and later ones are not used.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from operator import sub
from statistics import median

import numpy as np

from ..kinematics.joint_sample import JointSample

# The joint positions at an instant are known only if a sample was taken within this time of it, s.
MAX_AGE = 0.1
# Joint positions are extrapolated by at most this number of sample periods, because one sample may
# still be in transit.
MAX_PERIODS = 1.5
# The sample period is the median over this number of periods, so that lost samples do not change
# it.
MEDIAN_PERIODS = 8
# stamps that differ by less than this, s, are equal; their rounding errors are smaller
ROUNDING = 1e-6


class SampleBuffer:
    """The latest joint samples or joint commands, as arrays in the order of arrival.

    Attributes:
        newest_stamp: stamp of the latest sample, s; None if there is none.
        newest_row: positions and velocities (2, n) of the latest sample.
    """

    def __init__(self, length: int = 64) -> None:
        """Create the buffer.

        Args:
            length: number of samples to store.
        """
        self._names: tuple[str, ...] = ()
        self._stamps: deque[float] = deque(maxlen=length)
        # each row (2, n): positions, velocities
        self._rows: deque[np.ndarray] = deque(maxlen=length)
        self.newest_stamp: float | None = None
        self.newest_row: np.ndarray | None = None

    def append(self, sample: JointSample) -> None:
        """Append one sample."""
        self._names, self.newest_stamp = sample.names, sample.stamp
        self._stamps.append(sample.stamp)
        self.newest_row = np.array((sample.positions, sample.velocities))
        self._rows.append(self.newest_row)

    def extend(self, names: tuple[str, ...], stamps: Sequence[float], rows: np.ndarray) -> None:
        """Append m samples.

        Args:
            names: names of the n joints.
            stamps: (m,) times of the samples, s, in ascending order; m > 0.
            rows: (m, 2, n) positions and velocities.
        """
        self._names, self.newest_stamp = names, stamps[-1]
        self._stamps.extend(stamps)
        self._rows.extend(rows)
        self.newest_row = rows[-1]

    def clear(self) -> None:
        """Remove all samples, for example after a reset of the clock."""
        self._stamps.clear()
        self._rows.clear()
        self.newest_stamp = self.newest_row = None

    def since(self, stamp: float) -> tuple[JointSample, ...]:
        """Return the samples from `stamp` (s) on."""
        if self.newest_stamp is None or self.newest_stamp < stamp:
            return ()
        first = len(self._stamps)
        while first and self._stamps[first - 1] >= stamp:
            first -= 1
        latest = range(first, len(self._stamps))
        return tuple(self._make_sample(self._stamps[k], self._rows[k]) for k in latest)

    @property
    def newest(self) -> JointSample | None:
        """Return the latest sample; None if there is none."""
        return self._make_sample(self._stamps[-1], self._rows[-1]) if self._stamps else None

    def _make_sample(
        self, stamp: float, row: np.ndarray, is_uncertain: bool = False
    ) -> JointSample:
        """Make a sample of positions and velocities (2, n), whose arrays become read-only."""
        row.setflags(write=False)
        return JointSample(float(stamp), self._names, row[0], row[1], is_uncertain)


class JointHistory(SampleBuffer):
    """The latest joint samples in the order of their stamps."""

    def add(self, sample: JointSample) -> bool:
        """Add a sample; return False and skip it if it is not newer than the last one."""
        if self._stamps and sample.stamp <= self._stamps[-1]:
            return False
        self.append(sample)
        return True

    def estimate_velocities(self, sample: JointSample) -> JointSample:
        """Return a sample of positions with velocities estimated from the newest stored sample.

        The velocities remain zero if the newest stored sample is missing or too old.
        """
        newest = self.newest
        if newest is None or not 0.0 < sample.stamp - newest.stamp <= MAX_AGE + ROUNDING:
            return sample
        displacement = sample.positions - newest.positions
        return JointSample.from_values(
            sample.stamp,
            sample.names,
            sample.positions,
            displacement / (sample.stamp - newest.stamp),
        )

    def is_complete_to(self, stamp: float) -> bool:
        """Return whether all samples up to `stamp` have arrived, according to the sample period.

        Return False if there are fewer than two samples, because their period is unknown.
        """
        if len(self._stamps) < 2:
            return False
        newest = self._stamps[-1]
        return newest == stamp or newest + self._estimate_period() > stamp + ROUNDING

    def interpolate(self, stamp: float, earlier_only: bool = False) -> JointSample | None:
        """Return the joints at an instant, or None if no sample is close enough.

        Args:
            stamp: time of the instant, s.
            earlier_only: whether to ignore later samples and extrapolate from the last sample at or
                before the stamp.
        """
        stamps, rows = self._stamps, self._rows
        before = len(stamps) - 1
        while before >= 0 and stamps[before] > stamp:
            before -= 1
        after = before + 1
        has_after = after < len(stamps) and not earlier_only
        if before < 0 and not has_after:
            return None
        if before >= 0 and stamps[before] == stamp:
            return self._make_sample(stamp, rows[before])
        if before >= 0 and has_after:
            since, until = stamp - stamps[before], stamps[after] - stamp
            part = since / (stamps[after] - stamps[before])
            row = rows[before] + part * (rows[after] - rows[before])
            distance = min(since, until)
        else:  # all samples are on one side: extrapolate from the nearest
            nearest = max(before, 0)
            dt, row = stamp - stamps[nearest], rows[nearest].copy()
            row[0] += dt * row[1]
            distance = abs(dt)
            if distance > MAX_AGE:
                return None
        # The period is unknown if there is only one sample.
        is_uncertain = len(stamps) > 1 and (
            distance > MAX_PERIODS * self._estimate_period() + ROUNDING
        )
        return self._make_sample(stamp, row, is_uncertain)

    def _estimate_period(self) -> float:
        """Return the median period of the latest samples, s; needs at least two samples."""
        latest = list(self._stamps)[-MEDIAN_PERIODS - 1 :]
        return median(map(sub, latest[1:], latest))
