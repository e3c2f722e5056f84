"""Positions and velocities of an arm's joints at one instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import MeasurementError


@dataclass(frozen=True, eq=False)
class JointSample:
    """Measured or commanded joints, in the arm's order.

    Attributes:
        stamp: instant, s.
        names: n names.
        positions: (n,) rad or m, read-only.
        velocities: (n,) rad/s or m/s, read-only.
        guessed: whether no sample came from near its stamp, so that the joints may be elsewhere.
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
        """From any sequences; velocities that are not known count as zero.

        Raises:
            MeasurementError: as many positions and velocities as names are needed.
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
    """A read-only copy in float64."""
    values = np.array(values, float)
    values.setflags(write=False)
    return values
