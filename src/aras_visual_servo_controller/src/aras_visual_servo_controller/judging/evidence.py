"""What the images say beyond the error: does it ring, is the camera as believed, is it the target.

Each collects what a few images or the whole run show and answers only when it is sure: a healthy
run must not be called ill.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from aras_visual_servo_base.compiled import compiled
from aras_visual_servo_base.poses import logarithm
from aras_visual_servo_camera.degeneracy import anisotropy, gyration_radius

from ..goals.goal import Goal
from ..schemes.base import Decision
from ..seeing.joint_sample import JointSample
from ..seeing.observation import Observation
from ..seeing.ring_buffer import RecentErrors

_CHANCE = 1e-8  # that noise passes for a wave, at one of the frequencies that are tried
DIRECTIONS = ("vx", "vy", "vz", "wx", "wy", "wz")


class Oscillation:
    """Reversals of the error that are larger than tolerances explain and do not die away, at a
    frequency that stands out: noise reverses as often, but at all frequencies alike.
    """

    SPAN = 2.0  # s that are looked at
    LEAST = 6.0  # tolerances from peak to peak: noise has less
    REVERSALS = 5

    def __init__(self) -> None:
        self._seen = RecentErrors()

    def add(self, stamp: float, error: np.ndarray) -> float | None:
        """Frequency (Hz) of an error (k,), in tolerances, that rings; None where it does not."""
        seen = self._seen
        seen.add(stamp, error)
        seen.drop(int(np.searchsorted(seen.stamps, stamp - self.SPAN)))
        if len(seen) < self.REVERSALS + 2:
            return None
        frequency = _ringing(seen.stamps, seen.errors, self.LEAST, self.REVERSALS)
        return frequency if frequency > 0.0 else None


@compiled("f8[:], f8[:], f8")
def _standing_out(stamps, error, about):
    """The wave in an error (m,) beside a straight line: its frequency (Hz), near the one at which
    the error reverses, and the part of the error's square that it leaves. Its height may grow or
    fall in a straight line."""
    count = len(error)
    time = stamps - stamps.mean()
    rest = error - error.mean()
    rest -= (rest * time).sum() / (time * time).sum() * time
    whole = (rest * rest).sum()
    frequency, least = about, 1.0
    basis = np.empty((6, count))
    for step in range(41):
        tried = (0.7 + 0.0125 * step) * about
        phase = 2.0 * np.pi * tried * time
        basis[0], basis[1] = 1.0, time
        basis[2], basis[3] = np.cos(phase), np.sin(phase)
        basis[4], basis[5] = time * basis[2], time * basis[3]
        left = whole
        for i in range(6):
            length = (basis[i] * basis[i]).sum()
            for k in range(i):
                basis[i] -= (basis[i] * basis[k]).sum() * basis[k]
            square = (basis[i] * basis[i]).sum()
            if square > 1e-9 * length:
                basis[i] /= np.sqrt(square)
                if i > 1:
                    left -= (rest * basis[i]).sum() ** 2
            else:
                basis[i] = 0.0
        if left < least * whole:
            frequency, least = tried, left / whole
    return frequency, least


@compiled("f8[:], f8[:,:], f8, f8")
def _ringing(stamps, errors, least, reversals):
    """Hz at which the loudest of the errors (m, k) rings, stamps (m,) in s; 0 where it does not."""
    count = len(stamps)
    loudest, range_of = 0, -1.0
    for column in range(errors.shape[1]):
        late = errors[count // 2 :, column]
        if late.max() - late.min() > range_of:
            loudest, range_of = column, late.max() - late.min()
    error = errors[:, loudest]
    peaks, found = np.zeros(count, np.int64), 1
    for i in range(1, count):
        # A peak is where the way back has become longer than noise.
        last = peaks[found - 1]
        going = error[last] - error[peaks[found - 2]] if found > 1 else 0.0
        step = error[i] - error[last]
        if going == 0.0 or step * going < 0.0:
            if abs(step) >= least:
                peaks[found] = i
                found += 1
        else:
            peaks[found - 1] = i
    heights = np.abs(np.diff(error[peaks[:found]]))
    if len(heights) < reversals or heights[-3:].max() < 0.5 * heights[:-2].max():
        return 0.0
    first, last = stamps[peaks[1]], stamps[peaks[found - 1]]
    if last <= first:
        return 0.0
    about = 0.5 * (found - 2) / (last - first)
    # Of a loop that swings from stop to stop only the last swings may be alike.
    for begin in (0, count // 2):
        free = count - begin - 6  # numbers less those of line and wave
        if free < 6:
            break
        frequency, rest = _standing_out(stamps[begin:], error[begin:].copy(), about)
        # At most half, and less than white noise leaves of itself at one frequency by chance.
        if rest < min(0.5, _CHANCE ** (2.0 / free)):
            return frequency
    return 0.0


class ShapeEvidence:
    """Whether what is seen can be the goal's target, by two numbers that distance, place and turn
    leave alone: how spread out it is, and how long."""

    COMPACTNESS = 1.25  # ratio beyond which a tilt of 40 degrees is no excuse
    ANISOTROPY = 0.3
    IMAGES = 3

    def __init__(self) -> None:
        self._strange = 0

    def add(self, observation: Observation, goal: Goal) -> str:
        """Why it cannot be the target, in words; empty where it can."""
        seen, wanted = observation.moments, goal.moments
        if seen is None or wanted is None or seen.kind != wanted.kind:
            return ""
        ratio = (gyration_radius(seen) / gyration_radius(wanted)) ** 2 * wanted.m00 / seen.m00
        longer = abs(anisotropy(seen) - anisotropy(wanted))
        strange = not 1.0 / self.COMPACTNESS < ratio < self.COMPACTNESS
        strange |= longer > self.ANISOTROPY
        self._strange = self._strange + 1 if strange else 0
        if self._strange < self.IMAGES:
            return ""
        return (
            f"what is seen is not the goal's target: {ratio:.2f} times as spread out, its "
            f"length differs by {longer:.2f}"
        )


class CameraEvidence:
    """Compares how the features moved with how L and the executed motion say they had to.

    A wrong depth makes all translations count too much or too little by one factor, and does no
    harm; a wrong focal length, mounting or distortion is no such factor. So each direction of the
    camera gets a scale, fitted over the whole run: with a camera as believed, those of the
    translations are alike and those of the rotations are 1. Translations are compared with each
    other, two and two. What moves slowly is added up over some images.

    Measured on the simulated arm: healthy runs leave 0.06 % of the motion unexplained with moments
    and 1.6 % with points, and no two of their scales differ by more than 0.04 and 2.4 deviations at
    once; a loaded machine's leave 2.7 %, 0.4 tolerances an image. A focal length of 0.9 times the
    true one has scales 0.10 apart at 11 deviations where the camera comes down by a centimetre and
    moves aside; where it does one of the two alone, that cannot be told from another depth.

    How the arm moved is known as well as its joints are at the exposures. Where their speeds at
    both ends do not explain their way (a loaded machine's late commands shake the arm between two
    joint states), the image weighs less, by how far the features may be off for it.
    """

    # Tolerances from one row to the next: of less, noise and the joints' friction would be judged.
    LEAST = 3.0
    TOGETHER = 4  # images that are one row at most: what is slower may be the target's own motion
    PATH = 40.0  # tolerances of predicted way before anything is judged
    # Part of the motion's square that one depth does not explain, and in tolerances of an image.
    MISFIT, LOUD = 0.04, 1.5
    # A scale counts as wrong when it is off by so much, and so many standard deviations more.
    OFF, DEVIATIONS = 0.04, 4.0
    # Tolerances that a direction alone moved the features, for its scale to be judged: of a
    # translation beside another, of a rotation (joints that shake tilt the camera unseen).
    KNOWN, TURNED = 3.0, 8.0
    QUIET = 0.05  # tolerances of noise that there are at least
    TYPICAL = 0.3  # part of the most that shaken features are off, in a recorded run, in rms
    LATE = 0.25  # part of an image period for which joints went on at a speed that had changed

    def __init__(self, jacobian: Callable[[np.ndarray], np.ndarray] | None = None) -> None:
        """`jacobian`: (6, n) of the arm at joints (n,); None: its motion is taken as it is."""
        self._jacobian = jacobian
        self._joints: JointSample | None = None
        self._before: tuple[np.ndarray, np.ndarray] | None = None
        self._normal, self._right = np.zeros((6, 6)), np.zeros(6)
        self._square = self._path = 0.0
        self._rows = 0
        self._found: str | None = ""

    def interrupt(self) -> None:
        """An image without measurement: the next one has no predecessor."""
        self._before = self._joints = None

    def add(self, decision: Decision, observation: Observation, tolerances: np.ndarray) -> None:
        """Take in one image."""
        L, error = decision.L, decision.error
        moved = observation.previous_T_camera
        before, self._before = self._before, None
        joints, self._joints = self._joints, observation.joints
        if L is None or np.shape(L) != (len(error), 6):
            return
        L = np.asarray(L, float)
        self._before = (error, L)
        if before is None or moved is None or len(before[0]) != len(error):
            self._begin(error)
            return
        self._parts, predicted, wrapped = _advanced(
            *before, error, L, logarithm(moved), tolerances, self._parts
        )
        if wrapped:
            self._begin(error)
            return
        self._images += 1
        self._shaking = max(
            self._shaking, self._shaken(joints, observation.joints, L, tolerances)
        )
        if predicted >= self.LEAST:
            self._row(predicted, (error - self._from) / tolerances)
        if predicted >= self.LEAST or self._images >= self.TOGETHER:
            self._begin(error)

    def _begin(self, error: np.ndarray) -> None:
        """A row from this image on, where the error is (k,)."""
        self._from, self._parts = error, np.zeros((len(error), 6))
        self._images, self._shaking = 0, 0.0

    def _row(self, predicted: float, measured: np.ndarray) -> None:
        """Take in how far the features moved (k,), and had to at most, in tolerances."""
        weight = 1.0 / (1.0 + self.TYPICAL * self._shaking)
        self._normal += weight**2 * (self._parts.T @ self._parts)
        self._right += weight**2 * (self._parts.T @ measured)
        self._square += weight**2 * float(measured @ measured)
        self._path += weight * predicted
        self._rows += len(measured)
        self._found = None

    def _shaken(
        self,
        before: JointSample | None,
        now: JointSample | None,
        L: np.ndarray,
        tolerances: np.ndarray,
    ) -> float:
        """How far at most the features moved otherwise than the joints tell, in tolerances."""
        if self._jacobian is None or before is None or now is None:
            return 0.0
        dt, change = now.stamp - before.stamp, now.velocities - before.velocities
        told = (before.velocities + 0.5 * change) * dt
        unexplained = np.abs(now.positions - before.positions - told) + self.LATE * dt * abs(change)
        moved = L @ (self._jacobian(now.positions) * unexplained)
        return float(np.abs(moved / tolerances[:, None]).max())

    def fault(self) -> str:
        """What cannot be with the camera as believed, in words; empty where all can."""
        if self._found is None:
            self._found = self._judged() if self._path > self.PATH else ""
        return self._found

    def _judged(self) -> str:
        depth, misfit, rest, one, other, scale, beside = _scales(
            self._normal, self._right, self._square, self._rows,
            self.KNOWN, self.TURNED, self.OFF, self.DEVIATIONS, self.QUIET,
        )  # fmt: skip
        words = "the features move otherwise than L and the arm's motion say"
        if depth <= 0.0:
            return f"{words}: against the camera's translation"
        if misfit > self.MISFIT and rest > self.LOUD:
            return f"{words}: {100.0 * misfit:.0f} % of the motion is not explained"
        if one < 0:
            return ""
        elsewhere = "elsewhere" if one == other else f"along {DIRECTIONS[other]}"
        return (
            f"along {DIRECTIONS[one]} the features move {scale:.2f} times as far as L and "
            f"the arm's motion say, {elsewhere} {beside:.2f} times"
        )


@compiled("f8[:,:]")
def _inverse(matrix):
    """Of a symmetric positive definite one (n, n), which needs no pivots; by Gauss and Jordan."""
    left, right = matrix.copy(), np.eye(len(matrix))
    for i in range(len(left)):
        pivot = left[i, i]
        left[i], right[i] = left[i] / pivot, right[i] / pivot
        for k in range(len(left)):
            if k != i:
                factor = left[k, i]
                left[k], right[k] = left[k] - factor * left[i], right[k] - factor * right[i]
    return right


@compiled("f8[:,:], f8[:], f8, f8, f8, f8, f8, f8, f8")
def _scales(normal, right, square, rows, known, turned, off, deviations, quiet):
    """How far the features moved in each direction of the camera, beside what was expected.

    Two translations are compared with each other, a rotation with 1.

    Args:
        normal, right, square: (6, 6), (6,) of the normal equations, and the motion's square.
        rows: how many numbers went into them.
        known, turned, off, deviations, quiet: as CameraEvidence has them.

    Returns:
        The factor of the translations, with rotations as they are expected; what it leaves
        unexplained, as a part of the motion's square and in tolerances, rms; the direction whose
        scale is wrong, and the one beside it, itself for a rotation, -1 where none is; its scale;
        the other's, 1 for a rotation.
    """
    moved = normal[:3, :3].sum()
    depth = (right[:3].sum() - normal[:3, 3:].sum()) / moved if moved > known**2 else 1.0
    expected = np.ones(6)
    expected[:3] = depth
    # Where nothing was seen, it is as expected.
    spread = _inverse(normal + 0.1 * np.eye(6))
    scale, left, misfit = np.zeros(6), square, square
    for i in range(6):
        for j in range(6):
            scale[i] += spread[i, j] * (right[j] + 0.1 * expected[j])
    for i in range(6):
        left -= 2.0 * right[i] * scale[i]
        misfit -= 2.0 * right[i] * expected[i]
        for j in range(6):
            left += scale[i] * normal[i, j] * scale[j]
            misfit += expected[i] * normal[i, j] * expected[j]
    noise = max(np.sqrt(max(left, 0.0) / max(rows - 6.0, 1.0)), quiet)
    one, other, most = -1, -1, 0.0
    for i in range(6):
        for j in range(i if i < 3 else 1):
            turns = i > 2
            away = scale[i] - (1.0 if turns else scale[j])
            variance = spread[i, i]
            if not turns:
                variance += spread[j, j] - 2.0 * spread[i, j]
            unknown, unit = np.sqrt(variance), 1.0 if turns else abs(depth)
            # What is not explained may be the motion's own uncertainty, which makes scales small.
            lowered = max(left, 0.0) * variance
            over = (abs(away) - deviations * noise * unknown) / unit - lowered - off
            if unknown <= 1.0 / (turned if turns else known) and over > most:
                one, other, most = i, i if turns else j, over
    if one != other and abs(scale[one] - 1.0) < abs(scale[other] - 1.0):
        one, other = other, one
    beside = 1.0 if one == other else scale[other]
    rest = np.sqrt(max(misfit, 0.0) / rows)
    return depth, misfit / square, rest, one, other, scale[max(one, 0)], beside


@compiled("f8[:], f8[:,:], f8[:], f8[:,:], f8[:], f8[:], f8[:,:]")
def _advanced(error_before, L_before, error, L, motion, tolerances, before):
    """What each direction of the camera should have done to the features up to this image.

    Args:
        error_before, error: (k,); L_before, L: (k, 6) at the two last images.
        motion: (6,) of the camera between them.
        tolerances: (k,), the unit of all that is answered.
        before: (k, 6) what they should have done up to the image before.

    Returns:
        That up to this one (k, 6); the greatest of its sums; whether an error moved so far that
        an angle wrapped round.
    """
    parts = before.copy()
    widest, greatest, wrapped = tolerances.max(), 0.0, False
    for i in range(len(error)):
        predicted = 0.0
        for j in range(6):
            parts[i, j] += 0.5 * (L_before[i, j] + L[i, j]) * motion[j] / tolerances[i]
            predicted += parts[i, j]
        greatest = max(greatest, abs(predicted))
        wrapped |= abs(error[i] - error_before[i]) / tolerances[i] > 1.0 / widest
    return parts, greatest, wrapped
