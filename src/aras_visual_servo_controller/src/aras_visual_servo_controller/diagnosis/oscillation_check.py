"""Whether the error swings about its goal and does not die away."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..observation.recent_errors import RecentErrors

# Probability that white noise passes for a wave, at one of the frequencies that are tried.
MAX_CHANCE = 1e-8


class OscillationCheck:
    """Reversals of the error that are larger than tolerances explain and do not die away, at a
    frequency that stands out: noise reverses as often, but at all frequencies alike.

    A swing of unknown period is looked for within each of SPANS, the longer ones less often.
    """

    SPANS = (2.0, 5.0, 12.0)  # s; a delay of 0.4 s makes swings of 1.6 to 3 s
    CHECK_PERIODS = (1, 6, 12)  # images from one look to the next
    MIN_HEIGHT = 6.0  # tolerances from peak to peak: noise has less
    MIN_REVERSALS = 5
    # images from peak to peak, at least, for a swing that is told without a wave
    MIN_IMAGES_PER_REVERSAL = 4.0

    def __init__(self) -> None:
        self._errors, self._new_images = RecentErrors(), 0

    def add(self, stamp: float, error: np.ndarray) -> float | None:
        """Frequency (Hz) of an error (k,), in tolerances, that swings; None where it does not."""
        seen = self._errors
        seen.add(stamp, error)
        seen.drop_oldest(int(np.searchsorted(seen.stamps, stamp - self.SPANS[-1])))
        self._new_images += 1
        for span, every in zip(self.SPANS, self.CHECK_PERIODS, strict=True):
            if self._new_images % every:
                continue
            first = int(np.searchsorted(seen.stamps, stamp - span))
            frequency = _find_frequency(
                seen.stamps[first:], seen.errors[first:], self.MIN_HEIGHT, self.MIN_REVERSALS
            )
            if frequency > 0.0:
                return frequency
        return None

    @property
    def is_oscillating(self) -> bool:
        """Whether the error has gone to and fro lately, be it too seldom to tell a frequency."""
        return len(self._find_turning_points(4)) == 4

    @property
    def is_growing(self) -> bool:
        """Whether it does so farther each time, up to now."""
        latest = np.abs(self._find_turning_points(3))
        return len(latest) == 3 and bool((np.diff(latest) > 0.0).all())

    @property
    def has_overshot(self) -> bool:
        """Whether a component of the error has been on both sides of its goal."""
        errors = self._errors.errors
        return bool(((errors > self.MIN_HEIGHT).any(0) & (errors < -self.MIN_HEIGHT).any(0)).any())

    def _find_turning_points(self, count: int) -> np.ndarray:
        """The latest turning points (count,) of the loudest error, if it passed its goal between
        each two; else none."""
        errors = self._errors.errors
        if len(errors) < 3:
            return np.zeros(0)
        error = errors[:, _find_largest_error(errors)].copy()
        peaks = _find_peaks(error, self.MIN_HEIGHT)[-count:]
        passed = (np.diff(np.sign(error[peaks])) != 0.0).all()
        # Noise turns round at every second image.
        smooth = len(peaks) > 1 and np.diff(peaks).mean() >= self.MIN_IMAGES_PER_REVERSAL
        return error[peaks] if passed and smooth else np.zeros(0)


@jit("f8[:], f8[:]", allocates=False)
def _dot(a, b):
    """a @ b, of (m,) each."""
    total = 0.0
    for n in range(len(a)):
        total += a[n] * b[n]
    return total


@jit("f8[:], f8[:], f8")
def _find_dominant_wave(stamps, error, near_frequency):
    """The wave in an error (m,) beside a straight line: its frequency (Hz), near the one at which
    the error reverses, and the part of the error's square that it leaves. Its height may grow or
    fall in a straight line."""
    count = len(error)
    time, rest = np.empty(count), np.empty(count)
    middle, mean = stamps.mean(), error.mean()
    for n in range(count):
        time[n], rest[n] = stamps[n] - middle, error[n] - mean
    slope = _dot(rest, time) / _dot(time, time)
    for n in range(count):
        rest[n] -= slope * time[n]
    whole = _dot(rest, rest)
    frequency, least = near_frequency, 1.0
    basis = np.empty((6, count))
    for step in range(41):
        tried = (0.7 + 0.0125 * step) * near_frequency
        turn = 2.0 * np.pi * tried
        for n in range(count):
            basis[0, n], basis[1, n] = 1.0, time[n]
            basis[2, n], basis[3, n] = np.cos(turn * time[n]), np.sin(turn * time[n])
            basis[4, n], basis[5, n] = time[n] * basis[2, n], time[n] * basis[3, n]
        left = whole
        for i in range(6):
            row = basis[i]
            length = _dot(row, row)
            for k in range(i):
                part = _dot(row, basis[k])
                for n in range(count):
                    row[n] -= part * basis[k, n]
            square = _dot(row, row)
            seen = square > 1e-9 * length
            size = np.sqrt(square)
            for n in range(count):
                row[n] = row[n] / size if seen else 0.0
            if seen and i > 1:
                left -= _dot(rest, row) ** 2
        if left < least * whole:
            frequency, least = tried, left / whole
    return frequency, least


@jit("f8[:,:]")
def _find_largest_error(errors):
    """Index of the column of errors (m, k) that has the greatest range in its later half."""
    loudest, range_of = 0, -1.0
    for column in range(errors.shape[1]):
        late = errors[len(errors) // 2 :, column]
        if late.max() - late.min() > range_of:
            loudest, range_of = column, late.max() - late.min()
    return loudest


@jit("f8[:], f8")
def _find_peaks(error, min_height):
    """Indices of the turning points of an error (m,), with its ends: a peak is where the way back
    has become longer than `min_height`."""
    peaks, found = np.zeros(len(error), np.int64), 1
    for i in range(1, len(error)):
        last = peaks[found - 1]
        going = error[last] - error[peaks[found - 2]] if found > 1 else 0.0
        step = error[i] - error[last]
        if going == 0.0 or step * going < 0.0:
            if abs(step) >= min_height:
                peaks[found] = i
                found += 1
        else:
            peaks[found - 1] = i
    return peaks[:found]


@jit("f8[:], f8[:,:], f8, f8")
def _find_frequency(stamps, errors, min_height, reversals):
    """Hz at which the loudest of the errors (m, k) swings, stamps (m,) in s; 0: it does not."""
    count = len(stamps)
    error = errors[:, _find_largest_error(errors)].copy()
    peaks = _find_peaks(error, min_height)
    between, late, before = len(peaks) - 1, 0.0, 0.0
    for i in range(between):
        height = abs(error[peaks[i + 1]] - error[peaks[i]])
        if i >= between - 3:
            late = max(late, height)
        if i < between - 2:
            before = max(before, height)
    if between < reversals or late < 0.5 * before:
        return 0.0
    since, until, swings = stamps[peaks[1]], stamps[peaks[-1]], len(peaks) - 2
    # It has to go on until now: one and a half swings without a peak have ended it.
    if until <= since or stamps[-1] - until > 1.5 * (until - since) / swings:
        return 0.0
    about = 0.5 * swings / (until - since)
    # Of a loop that swings from stop to stop only the last swings may be alike.
    for begin in (0, count // 2):
        free = count - begin - 6  # numbers less those of line and wave
        if free < 6:
            break
        frequency, rest = _find_dominant_wave(stamps[begin:], error[begin:].copy(), about)
        # At most half, and less than white noise leaves of itself at one frequency by chance.
        if rest < min(0.5, MAX_CHANCE ** (2.0 / free)):
            return frequency
    return 0.0
