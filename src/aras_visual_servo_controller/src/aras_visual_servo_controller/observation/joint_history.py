"""Joints by stamp, so that an image meets the joints of its own instant.

Images and joint states come over different connections. Between two samples the joints are
interpolated; after the last one they go on at its velocity. Where runs have to repeat bit by bit
(lockstep) only samples up to the exposure count, and the image waits until none of those can still
be on its way: then what arrived first does not matter.
"""

from __future__ import annotations

from collections import deque
from itertools import islice, pairwise
from statistics import median

import numpy as np

from ..kinematics.joint_sample import JointSample

# Further than this from the nearest sample nothing is known of the joints, s.
MAX_AGE = 0.1
# Periods from the nearest sample up to which the speeds tell where the joints are: one sample may
# still be on its way.
MAX_PERIODS = 1.5
MEDIAN_PERIODS = 8  # periods whose median counts: samples that were lost do not change it
ROUNDING = 1e-6  # s, more than what stamps in s are rounded to, less than any period of samples


class JointHistory:
    """The last few samples, stamps rising.

    Attributes:
        newest: the last sample; None where there is none.
    """

    def __init__(self, length: int = 64) -> None:
        """`length`: samples to keep."""
        self._samples: deque[JointSample] = deque(maxlen=length)
        self.newest: JointSample | None = None

    def add(self, sample: JointSample) -> bool:
        """Note a sample; False for one that is not newer than the last, which is left out."""
        if self._samples and sample.stamp <= self._samples[-1].stamp:
            return False
        self._samples.append(sample)
        self.newest = sample
        return True

    def estimate_velocities(self, sample: JointSample) -> JointSample:
        """A sample of which positions alone are known, with the velocities at which the joints
        came from the newest one here; at rest where that is too old, or none."""
        newest = self.newest
        if newest is None or not 0.0 < sample.stamp - newest.stamp <= MAX_AGE + ROUNDING:
            return sample
        way = sample.positions - newest.positions
        return JointSample.from_values(
            sample.stamp, sample.names, sample.positions, way / (sample.stamp - newest.stamp)
        )

    def clear(self) -> None:
        """Forget all, as after a reset of the clock."""
        self._samples.clear()
        self.newest = None

    def is_complete_to(self, stamp: float) -> bool:
        """Whether no sample up to `stamp` can still be on its way, going by the samples' period.

        False with fewer than two samples, which tell no period.
        """
        if len(self._samples) < 2:
            return False
        newest = self._samples[-1].stamp
        return newest == stamp or newest + self._estimate_period() > stamp + ROUNDING

    def interpolate(self, stamp: float, earlier_only: bool = False) -> JointSample | None:
        """The joints at an instant; None where no sample is near enough.

        Args:
            stamp: s.
            earlier_only: go on from the last sample at or before it, whatever came later.
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
            near = after is not None and after.stamp - stamp <= MAX_AGE
            return self._extrapolate(after, stamp) if near else None
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
        """The sample, gone on at its velocities."""
        away = stamp - sample.stamp
        positions = sample.positions + away * np.asarray(sample.velocities)
        return JointSample.from_values(
            stamp, sample.names, positions, sample.velocities, self._is_far(abs(away))
        )

    def _is_far(self, distance: float) -> bool:
        """Whether that is far from a sample, s; of one alone, which tells no period, it is not."""
        return (
            len(self._samples) > 1 and distance > MAX_PERIODS * self._estimate_period() + ROUNDING
        )

    def _estimate_period(self) -> float:
        """Of the latest samples, of which there are two at least, s."""
        latest = [sample.stamp for sample in islice(reversed(self._samples), MEDIAN_PERIODS + 1)]
        return median(later - earlier for later, earlier in pairwise(latest))
