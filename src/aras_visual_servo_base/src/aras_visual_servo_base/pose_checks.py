"""Checks of vectors and poses that a client of the simulator sets."""

from __future__ import annotations

import math

from .names import Fault
from .poses import Pose, normalise


def check_vector(values: object, what: str, fault: Fault, count: int = 3) -> tuple[float, ...]:
    """Return a tuple of `count` finite floats.

    Args:
        values: sequence of numbers.
        what: name of the values, for messages.
        fault: class of the exception to raise.
        count: required number of values.

    Raises:
        fault: the values are not `count` finite numbers.
    """
    try:
        result = tuple(float(v) for v in values)
    except (TypeError, ValueError):
        raise fault(f"{what}: {values!r} is not a sequence of {count} numbers") from None
    if len(result) != count:
        raise fault(f"{what}: needs {count} numbers, got {len(result)}")
    if not math.isfinite(sum(abs(v) for v in result)):
        raise fault(f"{what}: {result} contains a number that is not finite; correct it")
    return result


def check_pose(pose: object, what: str, fault: Fault, zero_is_identity: bool = False) -> Pose:
    """Check a pose, and return it with a normalised quaternion.

    Args:
        pose: (xyz, quat).
        what: name of the pose, for messages.
        fault: class of the exception to raise.
        zero_is_identity: whether the quaternion (0, 0, 0, 0) is accepted as the identity. Unset
            fields of messages have this value.

    Raises:
        fault: a number is not finite, there are too many or too few numbers, or the norm of the
            quaternion is below 1e-6 or above 1e6.
    """
    try:
        xyz, quat = pose
    except (TypeError, ValueError):
        raise fault(f"{what}: {pose!r} is not (position, quaternion)") from None
    xyz = check_vector(xyz, f"{what}: position", fault)
    quat = check_vector(quat, f"{what}: orientation", fault, 4)
    norm = math.hypot(*quat)
    if zero_is_identity and norm == 0.0:
        return Pose(xyz)
    if not 1e-6 <= norm <= 1e6:
        raise fault(f"{what}: orientation {quat} is not a unit quaternion; use (0, 0, 0, 1) for "
                    "no rotation")  # fmt: skip
    return Pose(xyz, normalise(quat))
