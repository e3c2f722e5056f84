"""History of joint states, which gives the joints at the exposure of an image.

Images and joint states arrive over different connections. Between two samples the joints are
interpolated; after the last sample they are extrapolated with its velocity. In lockstep, runs have
to be bit-identical and must not depend on the order of arrival. Therefore the image waits until all
samples up to its exposure have arrived, and later samples are not used.
"""

from __future__ import annotations

from collections import deque
from itertools import islice, pairwise
from statistics import median

import numpy as np

from ..kinematics.joint_sample import JointSample

# The joints at an instant are known only if a sample within this time, s, exists.
MAX_AGE = 0.1
# Extrapolation is reliable up to this number of sample periods, because one sample may still be in
# transit.
MAX_PERIODS = 1.5
# The period is the median over this number of periods, so that lost samples do not change it.
MEDIAN_PERIODS = 8
# tolerance of stamps, s: above their rounding error and below any sample period
ROUNDING = 1e-6


class JointHistory:
    """The latest joint samples in the order of their stamps.

    Attributes:
        newest: latest sample; None if there is none.
    """

    def __init__(self, length: int = 64) -> None:
        """Create the history.

        Args:
            length: number of samples to store.
        """
        self._samples: deque[JointSample] = deque(maxlen=length)
        self.newest: JointSample | None = None

    def add(self, sample: JointSample) -> bool:
        """Add a sample; return False and skip it if it is not newer than the last one."""
        if self._samples and sample.stamp <= self._samples[-1].stamp:
            return False
        self._samples.append(sample)
        self.newest = sample
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

    def clear(self) -> None:
        """Remove all samples, for example after a reset of the clock."""
        self._samples.clear()
        self.newest = None

    def is_complete_to(self, stamp: float) -> bool:
        """Return whether all samples up to `stamp` have arrived, according to the sample period.

        Return False if there are fewer than two samples, because their period is unknown.
        """
        if len(self._samples) < 2:
            return False
        newest = self._samples[-1].stamp
        return newest == stamp or newest + self._estimate_period() > stamp + ROUNDING

    def interpolate(self, stamp: float, earlier_only: bool = False) -> JointSample | None:
        """Return the joints at an instant, or None if no sample is close enough.

        Args:
            stamp: time of the instant, s.
            earlier_only: whether to ignore later samples and extrapolate from the last sample at or
                before the stamp.
        """
        before = after = None
        for sample in reversed(self._samples):
            if sample.stamp <= stamp:
                before = sample
                break
            after = sample
        if earlier_only:
            after = None
        if before is None:
            is_near = after is not None and after.stamp - stamp <= MAX_AGE
            return self._extrapolate(after, stamp) if is_near else None
        if before.stamp == stamp:
            return before
        if after is None:
            return self._extrapolate(before, stamp) if stamp - before.stamp <= MAX_AGE else None
        part = (stamp - before.stamp) / (after.stamp - before.stamp)
        return JointSample.from_values(
            stamp,
            before.names,
            before.positions + part * (after.positions - before.positions),
            before.velocities + part * (after.velocities - before.velocities),
            self._is_far(min(stamp - before.stamp, after.stamp - stamp)),
        )

    def _extrapolate(self, sample: JointSample, stamp: float) -> JointSample:
        """Extrapolate a sample with its velocities."""
        dt = stamp - sample.stamp
        positions = sample.positions + dt * np.asarray(sample.velocities)
        return JointSample.from_values(
            stamp, sample.names, positions, sample.velocities, self._is_far(abs(dt))
        )

    def _is_far(self, distance: float) -> bool:
        """Return whether a time difference (s) to a sample is too large to extrapolate.

        Return False if there is only one sample, because the period is unknown.
        """
        return (
            len(self._samples) > 1 and distance > MAX_PERIODS * self._estimate_period() + ROUNDING
        )

    def _estimate_period(self) -> float:
        """Return the median period of the latest samples, s; needs at least two samples."""
        latest = [sample.stamp for sample in islice(reversed(self._samples), MEDIAN_PERIODS + 1)]
        return median(later - earlier for later, earlier in pairwise(latest))
