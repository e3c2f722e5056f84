"""What the resolver answers."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .inversion import RANK_TOLERANCE, svd

DIRECTIONS = ("vx", "vy", "vz", "wx", "wy", "wz")
UNITS = ("m/s",) * 3 + ("rad/s",) * 3


@dataclass(frozen=True, eq=False)
class Resolution:
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
    """

    velocities: np.ndarray
    primary: np.ndarray
    asked: np.ndarray
    twist: np.ndarray
    lost: np.ndarray
    scale: float
    margins: np.ndarray
    stopped: tuple[str, ...]
    slowing: str
    reasons: tuple[str, ...]
    L: np.ndarray
    jacobian: np.ndarray
    modelled: np.ndarray
    lasts: float = 0.0

    @cached_property
    def _of_task(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return svd(self.L[:, self.modelled])

    @cached_property
    def _of_arm(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return svd(self.L @ self.jacobian)

    @property
    def singular_values_L(self) -> np.ndarray:
        """Of L in the directions that the task models, largest first."""
        return self._of_task[1]

    @property
    def singular_values(self) -> np.ndarray:
        """Of L J, largest first, (min(k, n),)."""
        return self._of_arm[1]

    @property
    def rank(self) -> int:
        """Of L J: how many of the features the joints move independently."""
        return rank(self.singular_values)

    @property
    def rank_L(self) -> int:
        """Of L in the directions that the task models."""
        return rank(self.singular_values_L)

    @cached_property
    def manipulability(self) -> float:
        """sqrt(det(L J J^T L^T)): the product of the singular values of L J."""
        return float(np.prod(self.singular_values))

    @cached_property
    def null_direction(self) -> np.ndarray:
        """Joint motion (n,), of length 1, that moves the features least."""
        matrix = self.L @ self.jacobian
        return np.linalg.svd(matrix, full_matrices=True)[2][-1]

    @cached_property
    def null_twist(self) -> np.ndarray:
        """Camera motion (6,), of length 1, that moves the features least, as far as modelled."""
        twist = np.zeros(6)
        columns = self.L[:, self.modelled]
        twist[self.modelled] = np.linalg.svd(columns, full_matrices=True)[2][-1]
        return twist


def rank(singular_values: np.ndarray) -> int:
    """How many singular values, largest first, are more than noise."""
    if not singular_values.size or singular_values[0] <= 0.0:
        return 0
    return int((singular_values > RANK_TOLERANCE * singular_values[0]).sum())
