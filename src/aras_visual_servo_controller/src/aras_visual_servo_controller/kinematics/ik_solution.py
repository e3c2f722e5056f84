"""What the resolver answers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .algebra import ROUNDING_TOLERANCE, svd


@dataclass(frozen=True, eq=False)
class IKSolution:
    """Joint velocities for a task, and how well the arm can do it. Twists are the camera's own.

    Attributes:
        velocities: (n,) m/s and rad/s.
        primary: (n,) the part of them that serves the task, without the secondary tasks.
        asked: (6,) twist that the task and the held directions ask for.
        twist: (6,) that the velocities give.
        lost: (6,) of what was asked, before any slowing: what the arm does not have here.
        scale: 1, or the factor by which the task was slowed for limits of speed or acceleration.
        margins: (n,) distance to the nearer limit of position, rad or m.
        stopped: names of joints that were stopped at their limits.
        slowing: name of the joint whose limit slowed the task; '' when none did.
        reasons: what held the motion back, in words; empty when nothing did.
        lasts: s that the velocities may be kept: LASTING where the arm moves slowly, and nothing
            but the task and what is held shapes its motion, nor will before then; else 0.
        L: (k, 6) of the task; jacobian: (6, n) of the arm; both in SI units.
        modelled: (6,) bool, of the task.
        told: singular values of L and of L J where they were read back and not worked out.
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
        """What a message tells of a resolution; it holds neither L nor the arm's Jacobian.

        Args:
            singular_values: of L in its modelled directions, and of L J, largest first.
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
        """Of L in the directions that the task models, largest first."""
        return (
            self._svd_L[1]
            if self.recorded_singular_values is None
            else self.recorded_singular_values[0]
        )

    @property
    def singular_values(self) -> np.ndarray:
        """Of L J, largest first, (min(k, n),)."""
        return (
            self._svd_LJ[1]
            if self.recorded_singular_values is None
            else self.recorded_singular_values[1]
        )

    @property
    def rank(self) -> int:
        """Of L J: how many of the features the joints move independently."""
        return rank(self.singular_values)

    @cached_property
    def manipulability(self) -> float:
        """sqrt(det(L J J^T L^T)): the product of the singular values of L J."""
        return float(np.prod(self.singular_values))

    @cached_property
    def null_direction(self) -> np.ndarray:
        """Joint motion (n,), of length 1, that moves the features least."""
        matrix = self.L @ self.jacobian
        return np.linalg.svd(matrix, full_matrices=True)[2][-1]


def rank(singular_values: np.ndarray) -> int:
    """How many singular values, largest first, are more than noise."""
    if not singular_values.size or singular_values[0] <= 0.0:
        return 0
    return int((singular_values > ROUNDING_TOLERANCE * singular_values[0]).sum())
