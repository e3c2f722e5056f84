"""What a scheme asks of the arm: a rate of its error, or a twist of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TaskError
from .algebra import ROUNDING_PART, least_squares, svd, task_finite

ALL_DIRECTIONS = (True,) * 6
DIRECTIONS = ("vx", "vy", "vz", "wx", "wy", "wz")


@dataclass(frozen=True, eq=False)
class Task:
    """L v = rate, v = (vx, vy, vz, wx, wy, wz) of the camera in its own optical frame.

    Attributes:
        L: (k, 6) interaction matrix, all six columns as they are, k <= 6; of more rows six are
            made with the same solution.
        rate: (k,) wanted, e_dot.
        modelled: (6,) bool; the camera's directions that the task speaks of. The others are held
            by the resolver, as constraints.
    """

    L: np.ndarray
    rate: np.ndarray
    modelled: np.ndarray

    def __post_init__(self) -> None:
        """Check it; one taller than six rows is reduced to six with the same solution.

        Raises:
            TaskError: a wrong shape, or a number that is not finite.
        """
        L, rate, modelled = _numbers(self.L), _numbers(self.rate), np.array(self.modelled, bool)
        if L.ndim != 2 or L.shape[1] != 6 or rate.shape != (len(L),) or len(L) == 0:
            raise TaskError(
                f"a task needs L of shape (k, 6) and a rate of shape (k,), got {L.shape} and "
                f"{rate.shape}"
            )
        if modelled.shape != (6,):
            raise TaskError(f"modelled directions: six are needed, got {modelled.shape}")
        if not task_finite(L, rate):
            raise TaskError("the interaction matrix or the wanted rate is not finite")
        if len(L) > 6:
            L, rate = _reduced(L, rate)
        for name, array in (("L", L), ("rate", rate), ("modelled", modelled)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def of(
        cls,
        L: ArrayLike,
        rate: ArrayLike,
        modelled: ArrayLike = ALL_DIRECTIONS,
        weights: ArrayLike | None = None,
    ) -> Task:
        """The task of L (k, 6), any k, and rate (k,); TaskError as above.

        Args:
            modelled: (6,) bool.
            weights: (k,) of the rows, >= 0: least squares weighted by their squares.
        """
        if weights is not None:
            L, rate, weights = _numbers(L), _numbers(rate), _numbers(weights)
            if weights.shape != rate.shape or L.ndim != 2 or not (weights >= 0.0).all():
                raise TaskError(
                    f"weights of shape {weights.shape} for {len(rate)} features; they must be >= 0"
                )
            L, rate = weights[:, None] * L, weights * rate
        return cls(L, rate, modelled)

    @classmethod
    def of_twist(cls, twist: ArrayLike, modelled: ArrayLike = ALL_DIRECTIONS) -> Task:
        """The twist (6,) itself; of it only the modelled directions are asked for."""
        twist, modelled = _numbers(twist), np.array(modelled, bool)
        if twist.shape != (6,):
            raise TaskError(f"a twist has shape (6,), got {twist.shape}")
        if modelled.shape != (6,):
            raise TaskError(f"modelled directions: six are needed, got {modelled.shape}")
        return cls.of(np.eye(6)[modelled], twist[modelled], modelled)

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Singular value decomposition of L in its modelled directions."""
        return svd(self.L[:, self.modelled])

    @property
    def singular_values(self) -> np.ndarray:
        """Of L in its modelled directions, largest first."""
        return self._factors[1]

    @property
    def rank(self) -> int:
        """Rank of L in its modelled directions."""
        s = self.singular_values
        return int((s > ROUNDING_PART * s[0]).sum()) if s.size and s[0] > 0.0 else 0

    @cached_property
    def twist(self) -> np.ndarray:
        """(6,) least-squares twist of a camera that moves in the modelled directions alone."""
        twist = np.zeros(6)
        twist[self.modelled] = least_squares(
            self.L[:, self.modelled], self.rate, ROUNDING_PART
        )
        return twist


def _numbers(values: ArrayLike) -> np.ndarray:
    try:
        return np.array(values, float)
    except (TypeError, ValueError) as error:
        raise TaskError(f"not an array of numbers: {error}") from error


def _reduced(L: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Six rows with the normal equations, and so the solutions and singular values, of L.

    With L^T L = V S^2 V^T they are S V^T and S^-1 V^T L^T rate. A matrix that fits the cache is
    orthogonalised instead, which keeps all digits.
    """
    if len(L) <= 512:
        Q, R = np.linalg.qr(L)
        return R, Q.T @ rate
    squares, V = np.linalg.eigh(L.T @ L)
    kept = squares > 1e-13 * max(squares[-1], 0.0)
    s = np.sqrt(np.where(kept, squares, 0.0))
    projected = V.T @ (L.T @ rate)
    return s[:, None] * V.T, np.divide(projected, s, out=np.zeros(6), where=kept & (s > 0.0))
