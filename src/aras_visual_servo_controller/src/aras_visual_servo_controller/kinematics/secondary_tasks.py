"""Secondary tasks: what the arm does with the freedom that the camera's task leaves it.

Each proposes joint velocities; they add up, and the resolver keeps only what the task does not see.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np

from aras_visual_servo_base.names import suggest

from ..errors import ConfigurationError
from .arm import Arm
from .limits import Limits


class SecondaryTask(ABC):
    """Proposes joint velocities (n,), rad/s or m/s, for a posture q (n,)."""

    @abstractmethod
    def velocity(self, q: np.ndarray) -> np.ndarray:
        """Joint velocities this task would like, before projection."""


class JointRangeTask(SecondaryTask):
    """Draws joints into ranges: velocity_i = gain_i (q_i within its range - q_i).

    Attributes:
        rows: (3, n) lowest and highest positions, rad or m, and gains, 1/s.
    """

    rows: np.ndarray

    def velocity(self, q: np.ndarray) -> np.ndarray:
        low, high, gains = self.rows
        return gains * (np.clip(q, low, high) - q)


class PostureTask(JointRangeTask):
    """Draws some joints to preferred values: velocity = gain (preferred - q)."""

    def __init__(self, arm: Arm, preferred: Mapping[str, float], gain: float = 1.0) -> None:
        """`preferred`: by name, rad or m; gain in 1/s.

        Raises:
            ConfigurationError: an unknown joint, or no position that it can have.
        """
        self.rows = np.zeros((3, len(arm.names)))
        for name, value in preferred.items():
            if name not in arm.names:
                raise ConfigurationError(
                    f"posture: unknown joint {name}; {suggest(name, arm.names)}"
                )
            joint = arm.names.index(name)
            number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not (number and arm.lower[joint] <= value <= arm.upper[joint]):
                raise ConfigurationError(
                    f"posture: {name} is {value!r}, must be a number within its limits "
                    f"{arm.lower[joint]:g} to {arm.upper[joint]:g}"
                )
            self.rows[:, joint] = value, value, gain


class JointLimitAvoidance(JointRangeTask):
    """Pushes joints out of a margin before their limits.

    velocity_i = gain (depth of q_i inside the margin), away from the limit.
    """

    def __init__(self, limits: Limits, margin: float = 0.2, gain: float = 2.0) -> None:
        """`margin`: rad or m, at most a quarter of a joint's range; gain in 1/s."""
        margins = np.minimum(margin, 0.25 * (limits.upper - limits.lower))
        gains = np.full(len(margins), gain)
        self.rows = np.array([limits.lower + margins, limits.upper - margins, gains])


class SingularityAvoidance(SecondaryTask):
    """A step up the gradient of manipulability, w(q) = sqrt(det(J J^T)), where that is small.

        velocity = gain (1 - w / bound) grad w / max(|grad w|, steep)      for w < bound, else 0

    It fades out towards the bound, and near an optimum, where the gradient vanishes, the step
    vanishes with it: the laboratory's, of constant length, crosses the optimum again and again.
    It acts through the redundancy alone; what a stretched elbow needs is the resolver's affair.
    """

    def __init__(
        self,
        arm: Arm,
        directions: Sequence[int] = (0, 1, 2, 5),
        gain: float = 0.5,
        bound: float = 0.1,
        max_gradient: float = 0.1,
    ) -> None:
        """Look at some of the camera's directions.

        Args:
            arm: any.
            directions: of (vx, vy, vz, wx, wy, wz), by index.
            gain: greatest speed, rad/s.
            bound: of w, where the task sets in.
            steep: slope of w from which the step has its full length.
        """
        self._arm = arm
        self._rows = np.array(directions)
        self.gain, self.bound, self.max_gradient = gain, bound, max_gradient

    def manipulability(self, q: np.ndarray) -> float:
        """w(q) of the directions that the task looks at."""
        rows = self._arm.pose_and_jacobian(q)[1][self._rows]
        return float(np.sqrt(max(np.linalg.det(rows @ rows.T), 0.0)))

    def velocity(self, q: np.ndarray) -> np.ndarray:
        here = self.manipulability(q)
        if here >= self.bound:
            return np.zeros(len(q))
        step = 1e-5
        gradient = np.array(
            [
                self.manipulability(q + step * axis) - self.manipulability(q - step * axis)
                for axis in np.eye(len(q))
            ]
        ) / (2.0 * step)
        slope = max(float(np.linalg.norm(gradient)), self.max_gradient)
        return self.gain * (1.0 - here / self.bound) / slope * gradient
