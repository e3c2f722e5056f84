"""Elbows: joints at which an arm can be stretched.

The axes of the joint before and the joint after an elbow are parallel to its own axis. At a
stretched elbow, the camera cannot move along the arm to first order, because bending the elbow
moves it only to second order. The laboratory's arm works in such postures: at its desired poses, it
is stretched to within 0.1 mm of its full reach.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.names import suggest

from ..errors import ConfigurationError
from .arm import Arm

# Largest angle between two joint axes that are treated as parallel, rad, because robot descriptions
# write pi as 3.1416.
PARALLEL_TOLERANCE = 1e-4
MIN_LINK_LENGTH = 1e-3  # smallest length of the links on both sides of an elbow, m


@dataclass(frozen=True)
class Elbow:
    """An elbow and the joints before and after it.

    Attributes:
        joint: index of the elbow.
        straight_position: position of the elbow at which the arm is stretched, rad.
        bend_side: +1 or -1, the direction in which a straight elbow bends.
        joint_before, joint_after: indices of the neighbouring joints with parallel axes.
        share_before, share_after: rotations of those joints as fractions of a small bend of the
            elbow, such that the direction of the arm and the orientation of the camera do not
            change.
    """

    joint: int
    straight_position: float
    bend_side: float
    joint_before: int
    joint_after: int
    share_before: float
    share_after: float


def find_elbows(arm: Arm, sides: dict[str, float] | None = None) -> tuple[Elbow, ...]:
    """Return the elbows of an arm that can be stretched within the joint limits.

    Args:
        arm: arm to search.
        sides: +1 or -1 for each elbow, by name; the default is +1.

    Raises:
        ConfigurationError: `sides` names a joint that is not an elbow, or a side is not +1 or -1.
    """
    sides = sides or {}
    places, axes = arm.joint_frames(np.zeros(len(arm.names)))
    elbows = []
    for joint in range(1, len(arm.names) - 1):
        elbow = _make_elbow(arm, joint, places, axes, sides.get(arm.names[joint], 1.0))
        if elbow is not None:
            elbows.append(elbow)
    known = [arm.names[elbow.joint] for elbow in elbows]
    for name, side in sides.items():
        if name not in known:
            hint = suggest(name, known)
            raise ConfigurationError(f"joint {name} is not an elbow of this arm; {hint}")
        if side not in (-1, 1):
            raise ConfigurationError(f"side of the elbow {name} is {side!r}: use -1 or 1")
    return tuple(elbows)


def _make_elbow(
    arm: Arm, joint: int, origins: np.ndarray, axes: np.ndarray, side: float
) -> Elbow | None:
    before, after = joint - 1, joint + 1
    if arm.is_prismatic[[before, joint, after]].any():
        return None
    axis = axes[joint]
    parallel = [float(axis @ axes[other]) for other in (before, after)]
    if min(abs(cosine) for cosine in parallel) < np.cos(PARALLEL_TOLERANCE) - 1e-12:
        return None
    upper, fore = (
        step - axis * (axis @ step)
        for step in (origins[joint] - origins[before], origins[after] - origins[joint])
    )
    lengths: Sequence[float] = [float(np.linalg.norm(link)) for link in (upper, fore)]
    if min(lengths) < MIN_LINK_LENGTH:
        return None
    straight = -float(np.arctan2(axis @ np.cross(upper, fore), upper @ fore))
    if not arm.lower[joint] < straight < arm.upper[joint]:
        return None
    whole = sum(lengths)
    return Elbow(
        joint=joint,
        straight_position=straight,
        bend_side=float(side),
        joint_before=before,
        joint_after=after,
        share_before=-np.sign(parallel[0]) * lengths[1] / whole,
        share_after=-np.sign(parallel[1]) * lengths[0] / whole,
    )
