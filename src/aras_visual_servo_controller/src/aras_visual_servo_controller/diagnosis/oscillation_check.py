"""Check whether the error oscillates without decaying."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit

from .vector_history import VectorHistory

# Largest probability with which white noise may be mistaken for an oscillation at one frequency.
MAX_CHANCE = 1e-8
# Lengths of the time spans in which an oscillation is searched for, s. A delay of 0.4 s causes
# oscillations with periods of 1.6 to 3 s.
SPANS = (2.0, 5.0, 12.0)
# number of images between two searches for an oscillation, for each of SPANS
CHECK_PERIODS = (1, 6, 12)
# smallest peak-to-peak height of an oscillation, in units of the tolerance; noise is smaller
MIN_HEIGHT = 6.0
MIN_REVERSALS = 5
# If no frequency can be determined, an error oscillates only if the mean number of images between
# two reversals of its direction is at least this.
MIN_IMAGES_PER_REVERSAL = 4.0


class OscillationCheck:
    """Detection of an oscillation: the error changes its direction regularly and does not decay.

    The changes must be large and have a dominant frequency; noise has none. As the period of an
    oscillation is unknown, time spans of different lengths (SPANS) are searched, the longer ones
    less often.
    """

    def __init__(self) -> None:
        self._errors, self._new_images = VectorHistory(SPANS[-1]), 0

    def add(self, stamp: float, error: np.ndarray) -> float | None:
        """Add the error (k,) of an image, in units of the tolerance.

        Return the frequency of its oscillation (Hz), or None if it does not oscillate.
        """
        self._errors.add(stamp, error)
        self._new_images += 1
        frequency = _find_frequency(self._errors.stamps, self._errors.rows, self._new_images)
        return frequency if frequency > 0.0 else None

    @property
    def is_oscillating(self) -> bool:
        """Return whether the error has oscillated recently.

        The oscillation may be too short for its frequency to be determined.
        """
        return len(self._find_turning_points(4)) == 4

    @property
    def is_growing(self) -> bool:
        """Return whether the amplitude of the oscillation has been growing until now."""
        latest = np.abs(self._find_turning_points(3))
        return len(latest) == 3 and bool((np.diff(latest) > 0.0).all())

    @property
    def has_overshot(self) -> bool:
        """Return whether an error component has been both clearly positive and clearly negative."""
        errors = self._errors.rows
        return bool(((errors > MIN_HEIGHT).any(0) & (errors < -MIN_HEIGHT).any(0)).any())

    def _find_turning_points(self, count: int) -> np.ndarray:
        """Return the latest turning points (count,) of the error component with the largest range.

        Return an empty array if the component has the same sign at two successive turning points,
        or if it reverses as often as noise.
        """
        errors = self._errors.rows
        if len(errors) < 3:
            return np.zeros(0)
        error = errors[:, _find_largest_error(errors)].copy()
        peaks = _find_peaks(error)[-count:]
        changes_sign = (np.diff(np.sign(error[peaks])) != 0.0).all()
        # Noise reverses its direction at about every second image, an oscillation less often.
        is_smooth = len(peaks) > 1 and np.diff(peaks).mean() >= MIN_IMAGES_PER_REVERSAL
        return error[peaks] if changes_sign and is_smooth else np.zeros(0)


@jit("f8[:], f8[:]", allocates=False)
def _dot(a, b):
    """Return the dot product of two vectors (m,)."""
    total = 0.0
    for n in range(len(a)):
        total += a[n] * b[n]
    return total


@jit("f8[:], f8[:], f8")
def _find_dominant_wave(stamps, error, near_frequency):
    """Fit the sum of a wave and a straight line to an error (m,).

    The frequency is searched for between 0.7 and 1.2 times `near_frequency`, the estimate from the
    reversals of the error. The amplitude of the wave may change linearly.

    Returns:
        The frequency, Hz, and the residual as a fraction of the squared error.
    """
    count = len(error)
    time, rest = np.empty(count), np.empty(count)
    middle, mean = stamps.mean(), error.mean()
    for n in range(count):
        time[n], rest[n] = stamps[n] - middle, error[n] - mean
    slope = _dot(rest, time) / _dot(time, time)
    for n in range(count):
        rest[n] -= slope * time[n]
    whole = _dot(rest, rest)
    frequency, min_residual = near_frequency, 1.0
    basis = np.empty((6, count))
    for step in range(41):
        candidate = (0.7 + 0.0125 * step) * near_frequency
        omega = 2.0 * np.pi * candidate
        for n in range(count):
            basis[0, n], basis[1, n] = 1.0, time[n]
            basis[2, n], basis[3, n] = np.cos(omega * time[n]), np.sin(omega * time[n])
            basis[4, n], basis[5, n] = time[n] * basis[2, n], time[n] * basis[3, n]
        residual = whole
        for i in range(6):
            row = basis[i]
            length = _dot(row, row)
            for k in range(i):
                part = _dot(row, basis[k])
                for n in range(count):
                    row[n] -= part * basis[k, n]
            square = _dot(row, row)
            is_independent = square > 1e-9 * length
            size = np.sqrt(square)
            for n in range(count):
                row[n] = row[n] / size if is_independent else 0.0
            if is_independent and i > 1:
                residual -= _dot(rest, row) ** 2
        if residual < min_residual * whole:
            frequency, min_residual = candidate, residual / whole
    return frequency, min_residual


@jit("f8[:,:]")
def _find_largest_error(errors):
    """Return the index of the component of errors (m, k) that varies most in the second half."""
    largest, largest_range = 0, -1.0
    for column in range(errors.shape[1]):
        late = errors[len(errors) // 2 :, column]
        if late.max() - late.min() > largest_range:
            largest, largest_range = column, late.max() - late.min()
    return largest


@jit("f8[:]")
def _find_peaks(error):
    """Return the indices of the turning points of an error (m,), including its ends.

    A turning point is confirmed when the error has changed back by more than MIN_HEIGHT.
    """
    peaks, found = np.zeros(len(error), np.int64), 1
    for i in range(1, len(error)):
        last = peaks[found - 1]
        direction = error[last] - error[peaks[found - 2]] if found > 1 else 0.0
        step = error[i] - error[last]
        if direction == 0.0 or step * direction < 0.0:
            if abs(step) >= MIN_HEIGHT:
                peaks[found] = i
                found += 1
        else:
            peaks[found - 1] = i
    return peaks[:found]


@jit("f8[:], f8[:,:]")
def _find_frequency_in_span(stamps, errors):
    """Return the frequency of the error component with the largest range, Hz.

    Return 0 if this component does not oscillate. See `_find_frequency` for the arguments.
    """
    count = len(stamps)
    error = errors[:, _find_largest_error(errors)].copy()
    peaks = _find_peaks(error)
    between, late, before = len(peaks) - 1, 0.0, 0.0
    for i in range(between):
        height = abs(error[peaks[i + 1]] - error[peaks[i]])
        if i >= between - 3:
            late = max(late, height)
        if i < between - 2:
            before = max(before, height)
    if between < MIN_REVERSALS or late < 0.5 * before:
        return 0.0
    since, until, half_periods = stamps[peaks[1]], stamps[peaks[-1]], len(peaks) - 2
    # An oscillation has ended, and is not reported, if the error had no peak during the last one
    # and a half periods.
    if until <= since or stamps[-1] - until > 1.5 * (until - since) / half_periods:
        return 0.0
    near_frequency = 0.5 * half_periods / (until - since)
    # All data are fitted first, then only the second half: in a loop that oscillates between joint
    # limits, only the last periods may be similar.
    for start in (0, count // 2):
        # Degrees of freedom: number of values minus the six parameters of the fitted line and wave.
        free = count - start - 6
        if free < 6:
            break
        frequency, rest = _find_dominant_wave(stamps[start:], error[start:].copy(), near_frequency)
        # An error oscillates if the residual of the fitted wave is at most half of the squared
        # error. The residual also has to be so small that white noise reaches it at a tested
        # frequency with a probability of at most MAX_CHANCE.
        if rest < min(0.5, MAX_CHANCE ** (2.0 / free)):
            return frequency
    return 0.0


@jit("f8[:], f8[:,:], i8")
def _find_frequency(stamps, errors, image_count):
    """Return the frequency at which the error oscillates, Hz; 0 if it does not oscillate now.

    Args:
        stamps: (m,) stamps of the images, s.
        errors: (m, k) errors, in units of the tolerance.
        image_count: number of images of the run, which determines the spans that are searched.
    """
    for n in range(len(SPANS)):
        if image_count % CHECK_PERIODS[n]:
            continue
        first = 0
        while stamps[first] < stamps[-1] - SPANS[n]:
            first += 1
        frequency = _find_frequency_in_span(stamps[first:], errors[first:])
        if frequency > 0.0:
            return frequency
    return 0.0
