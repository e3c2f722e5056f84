"""The task of the camera: a desired rate of the error, or a desired twist."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InvalidTaskError
from .algebra import (
    ROUNDING_TOLERANCE,
    compute_uncertainty,
    is_finite,
    is_task_finite,
    reduce_equations,
    solve_least_squares,
    svd,
)

ALL_DIRECTIONS = (True,) * 6
DIRECTIONS = ("vx", "vy", "vz", "wx", "wy", "wz")
UNITS = ("m/s",) * 3 + ("rad/s",) * 3
# The camera is not moved along a direction in which its offset from the goal is more uncertain than
# this (see `Task.uncertainty`): a fraction of the depth for translations, rad for rotations. Noise
# moves the servoed camera by some tenths of the uncertainty.
MAX_UNCERTAINTY = 0.3
# For more rows than this, eigenvectors reduce L faster than a QR decomposition.
MANY_ROWS = 512
NO_COLUMNS = np.empty((6, 0))  # columns of an accuracy that is one number


@dataclass(eq=False)
class Task:
    """Camera task L v = desired_rate, where v is the camera twist in the optical frame.

    A scheme returns a task for each image. `DifferentialIK` finds the joint velocities q_dot that
    solve L J q_dot = desired_rate in the least-squares sense, with the arm's Jacobian J. v = (vx,
    vy, vz, wx, wy, wz) is in m/s and rad/s.

    Attributes:
        L: (k, 6) interaction matrix with all six columns, k <= 6. A matrix with more rows is
            reduced to six rows with the same solution.
        desired_rate: (k,) desired rate of the error, e_dot, in units of e per second.
        modelled: (6,) whether the task controls each direction of the camera. In the other
            directions, the camera is held at the goal.
        depth: depth of the target, m. A translation of the camera by this depth has the same weight
            as a rotation by 1 rad.
        accuracy: standard deviation of the measured error e, one number for all components; 0 if e
            is exact. Correlated components need an array (k, m): the effects on e of m independent
            causes, each by one standard deviation.
        rank_tolerance: singular values of L below this fraction of the largest one are treated as
            0.
        is_exact: whether `accuracy` is 0 and `rank_tolerance` has its default, so that no direction
            is uncertain.
    """

    L: np.ndarray
    desired_rate: np.ndarray
    modelled: np.ndarray
    depth: float = 1.0
    accuracy: np.ndarray | float = 0.0
    rank_tolerance: float = ROUNDING_TOLERANCE

    def __post_init__(self) -> None:
        """Check the arrays; if L has more than six rows, reduce it to six with the same solution.

        Raises:
            InvalidTaskError: a shape is wrong, or a value is not finite.
        """
        try:
            L, rate = np.asarray(self.L, float), np.asarray(self.desired_rate, float)
        except (TypeError, ValueError):
            L, rate = _read_array(self.L), _read_array(self.desired_rate)
        modelled, accuracy = np.array(self.modelled, bool), self.accuracy
        if L.ndim != 2 or L.shape[1] != 6 or rate.shape != L.shape[:1] or not L.size:
            raise InvalidTaskError(
                f"a task needs L of shape (k, 6) and a rate of shape (k,), got {L.shape} and "
                f"{rate.shape}"
            )
        if modelled.shape != (6,):
            raise InvalidTaskError(f"modelled must have the shape (6,), got {modelled.shape}")
        columns = own_columns = NO_COLUMNS
        if type(accuracy) is not float or not isfinite(accuracy):
            accuracy = _read_array(accuracy)
            fits = accuracy.ndim == 0 or accuracy.ndim == 2 and len(accuracy) == len(L)
            if not (fits and is_finite(accuracy.ravel())):
                raise InvalidTaskError(
                    f"accuracy must be finite, and one number or of shape ({len(L)}, m), got shape "
                    f"{accuracy.shape}"
                )
            if accuracy.ndim:
                columns, own_columns = accuracy, np.empty((min(len(L), 6), accuracy.shape[1]))
            accuracy = own_columns if accuracy.ndim else float(accuracy)
        if len(L) > MANY_ROWS and is_task_finite(L, rate):
            L, rate, columns = _reduce_rows(L, rate, columns)
        count = min(len(L), 6)
        own_L, own_rate = np.empty((count, 6)), np.empty(count)
        if not reduce_equations(L, rate, columns, own_L, own_rate, own_columns):
            raise InvalidTaskError(
                "the interaction matrix or the desired rate is not finite; check the "
                "scheme's features"
            )
        for array in (own_L, own_rate, modelled):
            array.setflags(write=False)
        self.L, self.desired_rate, self.modelled, self.accuracy = (
            own_L, own_rate, modelled, accuracy,
        )  # fmt: skip
        is_known = accuracy == 0.0 if type(accuracy) is float else not accuracy.any()
        self.is_exact = is_known and self.rank_tolerance == ROUNDING_TOLERANCE

    @classmethod
    def from_interaction(
        cls,
        L: ArrayLike,
        desired_rate: ArrayLike,
        modelled: ArrayLike = ALL_DIRECTIONS,
        weights: ArrayLike | None = None,
        depth: float = 1.0,
        accuracy: ArrayLike | float = 0.0,
        rank_tolerance: float = ROUNDING_TOLERANCE,
    ) -> Task:
        """Construct the task of L (k, 6), for any k, and desired_rate (k,).

        Args:
            L: (k, 6) interaction matrix.
            desired_rate: (k,) desired rate of the error.
            modelled: (6,) whether the task controls each direction.
            weights: (k,) weights of the rows, >= 0, which multiply the rows of L and the rates.
            depth, accuracy, rank_tolerance: attributes of the task.

        Raises:
            InvalidTaskError: a shape is wrong, or a value is not finite.
        """
        if weights is not None:
            L, desired_rate, weights = map(_read_array, (L, desired_rate, weights))
            if weights.shape != desired_rate.shape or L.ndim != 2 or not (weights >= 0.0).all():
                raise InvalidTaskError(
                    f"weights must be >= 0 and have the shape ({len(desired_rate)},), got "
                    f"{weights.shape}"
                )
            L, desired_rate = weights[:, None] * L, weights * desired_rate
            accuracy = np.diag(accuracy * weights) if np.ndim(accuracy) == 0 else (
                weights[:, None] * accuracy
            )
        return cls(L, desired_rate, modelled, depth, accuracy, rank_tolerance)

    @classmethod
    def from_twist(cls, twist: ArrayLike, modelled: ArrayLike = ALL_DIRECTIONS) -> Task:
        """Construct the task of a desired twist (6,).

        `modelled` (6,) states which components the task controls; the other components are ignored.
        """
        twist, modelled = _read_array(twist), np.array(modelled, bool)
        if twist.shape != (6,):
            raise InvalidTaskError(f"a twist must have the shape (6,), got {twist.shape}")
        if modelled.shape != (6,):
            raise InvalidTaskError(f"modelled must have the shape (6,), got {modelled.shape}")
        return cls.from_interaction(np.eye(6)[modelled], twist[modelled], modelled)

    @cached_property
    def singular_values(self) -> np.ndarray:
        """Singular values of L for the directions that the task controls, in descending order."""
        return svd(self.L[:, self.modelled])[1]

    @cached_property
    def _svd(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Singular value decomposition of L for the controlled directions; unit of length: `depth`.
        """
        return svd((self.L * self._scale)[:, self.modelled])

    @property
    def _scale(self) -> np.ndarray:
        """Factors (6,) that convert a twist with `depth` as unit of length to m and rad."""
        return np.array((self.depth, self.depth, self.depth, 1.0, 1.0, 1.0))

    @cached_property
    def uncertainty(self) -> np.ndarray:
        """Uncertainty (r,) of the camera's offset along each singular direction of L.

        It is the standard deviation of the offset that is computed from the error in one image: for
        translations, as a fraction of `depth`; for rotations, in rad. It is inf for a direction
        that no feature measures.
        """
        is_number = np.ndim(self.accuracy) == 0
        uncertainty = np.empty(6)
        count = compute_uncertainty(
            self.L, self.modelled, self.depth, float(self.accuracy) if is_number else 0.0,
            NO_COLUMNS if is_number else self.accuracy, self.rank_tolerance, uncertainty,
        )  # fmt: skip
        return uncertainty[:count]

    @property
    def rank(self) -> int:
        """Number of camera directions whose uncertainty is at most MAX_UNCERTAINTY."""
        return int((self.uncertainty <= MAX_UNCERTAINTY).sum())

    @cached_property
    def measurable_task(self) -> Task:
        """Task without the directions whose uncertainty exceeds MAX_UNCERTAINTY.

        If there are no such directions, it is the task itself.
        """
        if self.is_exact:
            return self
        if max(self.uncertainty.tolist(), default=0.0) <= MAX_UNCERTAINTY:
            return self
        u = self._svd[0][:, self.uncertainty <= MAX_UNCERTAINTY].T
        if not len(u):
            return Task(np.zeros((1, 6)), np.zeros(1), self.modelled, self.depth)
        return Task(u @ self.L, u @ self.desired_rate, self.modelled, self.depth)

    @property
    def dropped_reason(self) -> str:
        """Camera motion that is desired but too uncertain to be commanded, as text with the reason.

        The text is empty if there is no such motion.
        """
        measurable = self.measurable_task
        if measurable is self:
            return ""
        achieved = measurable.twist
        missing = np.abs((self.twist - achieved) / self._scale)
        main = np.flatnonzero(missing > 0.3 * missing.max())
        parts = ", ".join(
            f"{DIRECTIONS[i]} commanded {self.twist[i]:.3g}, achieved {achieved[i]:.3g} {UNITS[i]}"
            for i in main
        )
        count = int((self.uncertainty > MAX_UNCERTAINTY).sum())
        least = float(self.uncertainty[self.uncertainty > MAX_UNCERTAINTY].min())
        along = "along it" if count == 1 else "along them"
        known = f"no feature measures the camera's offset {along}" if least == np.inf else (
            f"one image determines the camera's offset {along} only to {100.0 * least:.0f} % of "
            f"the depth (limit {100.0 * MAX_UNCERTAINTY:.0f} %)"
        )
        return (
            f"{count} direction{'s' if count > 1 else ''} of the camera "
            f"{'are' if count > 1 else 'is'} not servoed ({parts}), because {known}"
        )

    @cached_property
    def twist(self) -> np.ndarray:
        """Least-squares twist (6,), with nonzero components in the controlled directions only."""
        twist = np.zeros(6)
        twist[self.modelled] = solve_least_squares(
            (self.L * self._scale)[:, self.modelled], self.desired_rate, ROUNDING_TOLERANCE
        )
        return self._scale * twist


def _read_array(values: ArrayLike) -> np.ndarray:
    try:
        return np.array(values, float)
    except (TypeError, ValueError) as error:
        raise InvalidTaskError(
            f"a value of the task is not an array of numbers: {error}"
        ) from error


def _reduce_rows(
    L: np.ndarray, desired_rate: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reduce L to six rows with the same normal equations, and so with the same solutions.

    With the eigenvectors V and the eigenvalues S^2 of L^T L, the new rows are S V^T, and the new
    rates are S^-1 V^T L^T rate. The columns (k, m) of an `accuracy` are reduced like the rates.
    """
    squares, V = np.linalg.eigh(L.T @ L)
    kept = squares > 1e-13 * max(squares[-1], 0.0)
    s = np.sqrt(np.where(kept, squares, 0.0))
    kept &= s > 0.0
    projected = V.T @ (L.T @ desired_rate)
    if columns is not NO_COLUMNS:
        columns = V.T @ (L.T @ columns)
        columns[kept] /= s[kept, None]
    return s[:, None] * V.T, np.divide(projected, s, out=np.zeros(6), where=kept), columns
