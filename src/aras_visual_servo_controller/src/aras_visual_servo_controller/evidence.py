"""What the images say beyond the error: does it ring, is the camera as believed, is it the target.

Each collects what a few images or the whole run show and answers only when it is sure: a healthy
run must not be called ill.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from aras_visual_servo_camera.compiled import MATRIX, NUMBER, VECTOR, compiled
from aras_visual_servo_camera.degeneracy import anisotropy, gyration_radius
from aras_visual_servo_camera.moments import Moments

from .arm.poses import body_motion
from .goal import Goal
from .joint_sample import JointSample
from .observation import Observation
from .recent import RecentErrors
from .schemes.base import Decision

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


@compiled(VECTOR, VECTOR, NUMBER)
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


@compiled(VECTOR, MATRIX, NUMBER, NUMBER)
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


class ViewEvidence:
    """Whether a view in which every feature is the goal's is the goal's own: as many numbers as a
    camera has directions can be the same from several poses, the outline is then not.

    Compared are the central moments of second and third order, free of scale. Of converged runs
    with five cameras, noise among them, they differ by 0.2 % and 6e-5; of the nearest pose that
    was found wrong, 18 degrees off, by 0.6 % and 5e-4.
    """

    SECOND, THIRD = 0.02, 2.5e-4  # the first a part of the goal's greatest
    IMAGES = 3

    def __init__(self) -> None:
        self._strange = 0

    def add(self, observation: Observation, goal: Goal) -> bool:
        """Take in an image of a converged loop; answers whether it shows another view."""
        seen, wanted = observation.moments, goal.moments
        if seen is None or wanted is None or seen.kind != wanted.kind or wanted.m00 <= 0.0:
            return False
        second, third = (_shape(seen, order) - _shape(wanted, order) for order in (2, 3))
        strange = np.abs(second).max() > self.SECOND * np.abs(_shape(wanted, 2)).max()
        strange |= np.abs(third).max() > self.THIRD
        self._strange = self._strange + 1 if strange else 0
        return self._strange >= self.IMAGES


def _shape(moments: Moments, order: int) -> np.ndarray:
    """Central moments (order + 1,), free of scale."""
    scale = moments.m00 ** (1.0 + 0.5 * order)
    return np.array([moments.mu(order - j, j) for j in range(order + 1)]) / scale


class CameraEvidence:
    """Compares how the features moved with how L and the executed motion say they had to.

    A wrong depth makes all translations count too much or too little by one factor, and does no
    harm; a wrong focal length, mounting or distortion is no such factor. So each direction of the
    camera gets a scale, fitted over the whole run: with a camera as believed, those of the
    translations are alike and those of the rotations are 1.

    Measured on the simulated arm: healthy runs leave 0.06 % of the motion unexplained with moments
    and 1.6 % with points, their scales are at most 0.04 and 2 deviations off; a loaded machine's
    leave 2.7 %, 0.4 tolerances an image. A focal length of 0.85 times the true one has scales 0.11
    off at 20 deviations where the camera comes down and moves aside; where it does one of the two
    alone, that cannot be told from another depth.

    How the arm moved is known as well as its joints are at the exposures. Where their speeds at
    both ends do not explain their way (a loaded machine's late commands shake the arm between two
    joint states), the image weighs less, by how far the features may be off for it.
    """

    # Tolerances in one image: of slower motion noise and the joints' friction would be judged.
    LEAST = 3.0
    PATH = 40.0  # tolerances of predicted way before anything is judged
    # Part of the motion's square that one depth does not explain, and in tolerances of an image.
    MISFIT, LOUD = 0.04, 1.5
    # A scale counts as wrong when it is off by so much, and by so many standard deviations.
    OFF, DEVIATIONS = 0.06, 8.0
    KNOWN = 8.0  # tolerances that a direction alone moved the features, for its scale to be judged
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
            return
        parts, predicted, measured, wrapped = _compared(
            *before, error, L, body_motion(moved), tolerances
        )
        if wrapped or predicted < self.LEAST:
            return
        shaken = self._shaken(joints, observation.joints, L, tolerances)
        weight = 1.0 / (1.0 + self.TYPICAL * shaken)
        self._normal += weight**2 * (parts.T @ parts)
        self._right += weight**2 * (parts.T @ measured)
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
        depth, misfit, noise, worst, scale, expected = _scales(
            self._normal, self._right, self._square, self._rows,
            self.KNOWN, self.OFF, self.DEVIATIONS,
        )  # fmt: skip
        if depth <= 0.0:
            return (
                "the features move otherwise than L and the arm's motion say: against the "
                "camera's translation"
            )
        if misfit > self.MISFIT and noise > self.LOUD:
            return (
                f"the features move otherwise than L and the arm's motion say: "
                f"{100.0 * misfit:.0f} % of the motion is not explained"
            )
        if worst < 0:
            return ""
        return (
            f"along {DIRECTIONS[worst]} the features move {scale:.2f} times as far as L and "
            f"the arm's motion say, elsewhere {expected:.2f} times"
        )


@compiled(MATRIX)
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


@compiled(MATRIX, VECTOR, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER)
def _scales(normal, right, square, rows, known, off, deviations):
    """How far the features moved in each direction of the camera, beside what was expected.

    Args:
        normal, right, square: (6, 6), (6,) of the normal equations, and the motion's square.
        rows: how many numbers went into them.
        known, off, deviations: KNOWN, OFF and DEVIATIONS of CameraEvidence.

    Returns:
        The factor of the translations, with rotations as they are expected; what it leaves
        unexplained, as a part of the motion's square and in tolerances, rms; the direction whose
        scale is wrong, -1 where none is; its scale; what that should be.
    """
    moved = normal[:3, :3].sum()
    depth = (right[:3].sum() - normal[:3, 3:].sum()) / moved if moved > known**2 else 1.0
    expected = np.ones(6)
    expected[:3] = depth
    spread = _inverse(normal + np.eye(6))
    scale, left, misfit = np.zeros(6), square, square
    for i in range(6):
        for j in range(6):
            scale[i] += spread[i, j] * (right[j] + expected[j])
    for i in range(6):
        left -= 2.0 * right[i] * scale[i]
        misfit -= 2.0 * right[i] * expected[i]
        for j in range(6):
            left += scale[i] * normal[i, j] * scale[j]
            misfit += expected[i] * normal[i, j] * expected[j]
    noise, worst, most = np.sqrt(max(left, 0.0) / rows), -1, 0.0
    for i in range(6):
        unknown = np.sqrt(spread[i, i])
        # What is not explained may be the motion's own uncertainty, which makes scales too small.
        lowered = max(left, 0.0) * spread[i, i]
        over = abs(scale[i] - expected[i]) - lowered - max(off, deviations * noise * unknown)
        if unknown <= 1.0 / known and over > most:
            worst, most = i, over
    rest, named = np.sqrt(max(misfit, 0.0) / rows), max(worst, 0)
    return depth, misfit / square, rest, worst, scale[named], expected[named]


@compiled(VECTOR, MATRIX, VECTOR, MATRIX, VECTOR, VECTOR)
def _compared(error_before, L_before, error, L, motion, tolerances):
    """How errors (k,) moved between two images and how they had to, in tolerances (k,).

    Args:
        L_before, L: (k, 6) at the two images.
        motion: (6,) of the camera between them.

    Returns:
        What each direction of the camera should have done (k, 6); the greatest of the sums; what
        was done (k,); whether that is so much that an angle wrapped round.
    """
    count, widest = len(error), tolerances.max()
    parts, measured = np.empty((count, 6)), np.empty(count)
    greatest, wrapped = 0.0, False
    for i in range(count):
        predicted = 0.0
        for j in range(6):
            parts[i, j] = 0.5 * (L_before[i, j] + L[i, j]) * motion[j] / tolerances[i]
            predicted += parts[i, j]
        greatest = max(greatest, abs(predicted))
        measured[i] = (error[i] - error_before[i]) / tolerances[i]
        wrapped |= abs(measured[i]) > 1.0 / widest
    return parts, greatest, measured, wrapped
