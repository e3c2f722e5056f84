"""Check whether the joints follow their commanded velocities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from aras_visual_servo_base.compiled import jit

from .vector_history import VectorHistory

SPAN = 1.5  # duration over which joint states are evaluated, s
# If the loop waits for any joint in more than this fraction of the images, all joints for which
# it has waited count as lagging.
MAX_WAITING_PART = 0.6
# If the loop waits in a smaller fraction of the images than MAX_WAITING_PART, a joint lags
# under two conditions: the loop waits for the joint in more than MIN_WAITING_PART of the
# images, and the joint makes less than MIN_MOTION_PART of its commanded motion.
MIN_WAITING_PART = 0.1
MIN_MOTION_PART = 0.1
# Lagging joints are slow, and not blocked, if all of them move faster than this, in units of
# `lengths` per second (rad/s for joints that rotate).
SLOW_SPEED = 1e-3
# A joint oscillates if the rms difference between its measured and commanded velocities exceeds
# both MIN_SPEED_ERROR, in the same unit, and SPEED_ERROR_FACTOR times its rms commanded velocity.
MIN_SPEED_ERROR, SPEED_ERROR_FACTOR = 0.5, 3.0
CHECK_PERIOD = 5  # number of images between two evaluations of the joints
# Joint states that cover at least this duration (s) are needed to detect an oscillation of a
# joint.
MIN_SPAN = 0.3


class JointTrackingCheck:
    """Test for joints that lag behind their commands or oscillate, over the last SPAN seconds.

    A joint lags if the loop waits for it in most images (see the settings `lead` and `lag`), or if
    the loop waits in some images and the joint has moved only a small part of the commanded
    distance.
    """

    def __init__(self, names: Sequence[str] = (), lengths: np.ndarray | float = 1.0) -> None:
        """Create the check.

        Args:
            names: names of the n joints.
            lengths: (n,) motion of each joint (rad or m) that counts as one unit.
        """
        self._names, self._lengths = tuple(names), np.ones(len(names)) * lengths
        self._samples = VectorHistory(SPAN)
        # Stamp (s) and joints of each image after the last evaluation, see `add`.
        self._new_images: list[tuple[float, tuple[np.ndarray, ...]]] = []
        self.joints, self.reason = "", ""
        # Whether the lagging joints move towards their commands, but too slowly.
        self.is_slow = False

    def add(self, stamp: float, joints: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        """Add the joints at the image of this stamp, s, see `ImageRecord`."""
        self._new_images.append((stamp, joints))
        if len(self._new_images) == CHECK_PERIOD:
            self._judge()

    def _judge(self) -> None:
        stamps, rows = zip(*self._new_images, strict=True)
        self._new_images, samples = [], self._samples
        samples.add(stamps, np.array(rows, float).reshape(CHECK_PERIOD, -1))
        lags, oscillates, max_speed = _find_faulty_joints(
            samples.rows, self._lengths, stamps[-1] - samples.stamps[0]
        )
        self.joints, self.is_slow, self.reason = "", True, ""
        is_oscillating = any(oscillates.tolist())
        if not is_oscillating and not any(lags.tolist()):
            return
        self.joints = self._format_names(oscillates if is_oscillating else lags)
        self.is_slow = not is_oscillating and bool((max_speed[lags] > SLOW_SPEED).all())
        if is_oscillating:
            fastest = (max_speed * self._lengths)[oscillates].max()
            self.reason = (
                f"the motion of {self.joints} oscillates without a command, at up to "
                f"{fastest:.1f} rad/s or m/s"
            )
        else:
            self.reason = f"the motion of {self.joints} does not follow the command"

    def _format_names(self, joints: np.ndarray) -> str:
        """Return the names of the joints for which `joints` (n,) is True, as text."""
        names = [name for name, is_selected in zip(self._names, joints, strict=True) if is_selected]
        return join_names(names)


def join_names(names: Sequence[str]) -> str:
    """Join names as 'a, b and c'."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def describe_foreign_nodes(nodes: Mapping[str, str]) -> str:
    """Describe which other nodes command which joints; empty text if none does.

    Args:
        nodes: name of the commanding node, by joint name.
    """
    joints = {node: [j for j, n in nodes.items() if n == node] for node in nodes.values()}
    return "; ".join(f"{node} commands {join_names(names)}" for node, names in joints.items())


@jit("f8[:,:], f8[:], f8")
def _find_faulty_joints(rows, lengths, span):
    """Find the joints that lag behind their commands or oscillate.

    Args:
        rows: (m, 3 n) one row per image: whether the loop waits for each joint, commanded
            velocities, measured velocities.
        lengths: (n,) motion of each joint (rad or m) that counts as one unit.
        span: time that the images cover, s.

    Returns:
        Whether each joint lags (n,); whether it oscillates (n,); its largest measured speed
        (n,), in units of `lengths` per second.
    """
    count, n = rows.shape[0], rows.shape[1] // 3
    # Sums for each joint: images in which the loop waits for it, product of commanded and measured
    # velocity, squared commanded velocity, squared difference of both.
    sums, max_speed, waiting = np.zeros((4, n)), np.zeros(n), 0.0
    for row in rows:
        any_late = 0.0
        for i in range(n):
            commanded, measured = row[n + i] / lengths[i], row[2 * n + i] / lengths[i]
            sums[0, i] += row[i]
            sums[1, i] += commanded * measured
            sums[2, i] += commanded * commanded
            sums[3, i] += (measured - commanded) ** 2
            max_speed[i] = max(max_speed[i], abs(measured))
            any_late = max(any_late, row[i])
        waiting += any_late
    lags, oscillates = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for i in range(n):
        late, motion, commanded = sums[0, i] / count, sums[1, i] / count, sums[2, i] / count
        speed_error = sums[3, i] / count
        lags[i] = late > 0.0
        if waiting / count <= MAX_WAITING_PART:
            lags[i] = motion < MIN_MOTION_PART * commanded and late > MIN_WAITING_PART
        lags[i] &= span >= 0.9 * SPAN
        oscillates[i] = (
            span > MIN_SPAN
            and speed_error > MIN_SPEED_ERROR**2
            and speed_error > SPEED_ERROR_FACTOR**2 * commanded
        )
    return lags, oscillates, max_speed
