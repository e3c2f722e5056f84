"""Positions and velocities of an arm's joints at one instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import MeasurementError


@dataclass(eq=False)
class JointSample:
    """Measured or commanded positions and velocities of the joints, in the arm's order.

    Attributes:
        stamp: time of the sample, s.
        names: names of the n joints.
        positions: (n,) positions, rad or m, read-only.
        velocities: (n,) velocities, rad/s or m/s, read-only.
        is_uncertain: whether the actual positions can differ, because no joint state close to the
            stamp was received.
    """

    stamp: float
    names: tuple[str, ...]
    positions: np.ndarray
    velocities: np.ndarray
    is_uncertain: bool = False

    @classmethod
    def from_values(
        cls,
        stamp: float,
        names: Sequence[str],
        positions: ArrayLike,
        velocities: ArrayLike | None = None,
        is_uncertain: bool = False,
    ) -> JointSample:
        """Construct a sample from any sequences; by default the velocities are zero.

        Raises:
            MeasurementError: the numbers of names, positions and velocities differ.
        """
        names = tuple(names)
        positions = make_read_only_copy(positions)
        velocities = make_read_only_copy(np.zeros(len(names)) if velocities is None else velocities)
        if positions.shape != (len(names),) or velocities.shape != (len(names),):
            raise MeasurementError(
                f"{len(names)} joint names, but positions of shape {positions.shape} and "
                f"velocities of shape {velocities.shape}"
            )
        return cls(float(stamp), names, positions, velocities, is_uncertain)


def make_read_only_copy(values: ArrayLike) -> np.ndarray:
    """Return a read-only copy of an array as float64."""
    values = np.array(values, float)
    values.setflags(write=False)
    return values
