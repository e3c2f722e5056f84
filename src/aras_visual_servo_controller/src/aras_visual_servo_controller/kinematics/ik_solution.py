"""Result of the differential inverse kinematics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .algebra import ROUNDING_TOLERANCE, svd


@dataclass(eq=False)
class IKSolution:
    """Joint velocities for a task, with the limits that affected them.

    Twists are those of the camera in its own frame, m/s and rad/s.

    Attributes:
        velocities: (n,) joint velocities, m/s or rad/s.
        primary: (n,) part of the velocities that serves the task, without secondary tasks.
        desired_twist: (6,) twist that the task and the held directions require.
        achieved_twist: (6,) twist that the velocities produce.
        infeasible_twist: (6,) part of the desired twist that the arm cannot produce in this
            configuration, before speed limits apply.
        scale: factor by which speed or acceleration limits slow the task; 1 if no limit applies.
        margins: (n,) distance to the nearer position limit, rad or m.
        stopped_joints: names of joints that were stopped at their limits.
        limiting_joint: name of the joint whose limit slowed the task; '' if there is none.
        reasons: limits that reduced the motion, as text; empty if there are none.
        L: (k, 6) interaction matrix of the task, SI units.
        jacobian: (6, n) Jacobian of the arm, SI units.
        modelled: (6,) whether the task controls each direction.
        reuse_time: time for which the velocities remain valid, s: REUSE_TIME if the arm moves
            slowly and reaches no limit within this time, otherwise 0.
        recorded_singular_values: singular values of L and of L J that a message contains; None to
            compute them from L and `jacobian`.
    """

    velocities: np.ndarray
    primary: np.ndarray
    desired_twist: np.ndarray
    achieved_twist: np.ndarray
    infeasible_twist: np.ndarray
    scale: float
    margins: np.ndarray
    stopped_joints: tuple[str, ...]
    limiting_joint: str
    reasons: tuple[str, ...]
    L: np.ndarray
    jacobian: np.ndarray
    modelled: np.ndarray
    reuse_time: float = 0.0
    recorded_singular_values: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def from_record(
        cls,
        velocities: np.ndarray,
        desired_twist: np.ndarray,
        achieved_twist: np.ndarray,
        singular_values: tuple[np.ndarray, np.ndarray],
        scale: float = 1.0,
    ) -> IKSolution:
        """Construct the solution from the fields of a message, which contains neither L nor J.

        Args:
            singular_values: singular values of L for the directions that the task controls, and
                singular values of L J, both in descending order.
        """
        none = np.full(len(velocities), np.nan)
        return cls(
            velocities, none, desired_twist, achieved_twist, np.full(6, np.nan), scale, none, (),
            "", (),
            np.zeros((0, 6)), np.zeros((6, len(velocities))), np.ones(6, bool),
            recorded_singular_values=singular_values,
        )  # fmt: skip

    @cached_property
    def _svd_L(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return svd(self.L[:, self.modelled])

    @cached_property
    def _svd_LJ(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return svd(self.L @ self.jacobian)

    @property
    def singular_values_L(self) -> np.ndarray:
        """Singular values of L in the directions that the task controls, in descending order."""
        return (
            self._svd_L[1]
            if self.recorded_singular_values is None
            else self.recorded_singular_values[0]
        )

    @property
    def singular_values(self) -> np.ndarray:
        """Singular values (min(k, n),) of L J in descending order."""
        return (
            self._svd_LJ[1]
            if self.recorded_singular_values is None
            else self.recorded_singular_values[1]
        )

    @property
    def rank(self) -> int:
        """Rank of L J: the number of features that the joints can move independently."""
        return rank(self.singular_values)

    @cached_property
    def manipulability(self) -> float:
        """Product of the singular values of L J, sqrt(det(L J J^T L^T))."""
        return float(np.prod(self.singular_values))

    @cached_property
    def null_direction(self) -> np.ndarray:
        """Joint motion (n,) of length 1 that moves the features least."""
        matrix = self.L @ self.jacobian
        return np.linalg.svd(matrix, full_matrices=True)[2][-1]


def rank(singular_values: np.ndarray) -> int:
    """Return the number of singular values that exceed the rounding error.

    The values are in descending order.
    """
    if not singular_values.size or singular_values[0] <= 0.0:
        return 0
    return int((singular_values > ROUNDING_TOLERANCE * singular_values[0]).sum())
