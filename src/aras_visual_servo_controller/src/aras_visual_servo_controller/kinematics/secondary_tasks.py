"""Secondary tasks, which use the redundancy of the arm.

Each task proposes joint velocities. Their sum is projected onto the motions that do not affect the
camera task.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np

from aras_visual_servo_base.names import suggest

from ..errors import ConfigurationError
from .arm import Arm
from .command_limits import CommandLimits


class SecondaryTask(ABC):
    """Base class of secondary tasks, which propose joint velocities."""

    @abstractmethod
    def velocity(self, q: np.ndarray) -> np.ndarray:
        """Compute the proposed velocities (n,), rad/s or m/s, at joints q (n,), before projection.
        """


class JointRangeTask(SecondaryTask):
    """Attraction of joints into ranges: velocity_i = gain_i (r_i - q_i).

    Here r_i is the position within the range of joint i that is nearest to q_i.

    Attributes:
        rows: (3, n) lower and upper ends of the ranges, rad or m, and gains, 1/s.
    """

    rows: np.ndarray

    def velocity(self, q: np.ndarray) -> np.ndarray:
        low, high, gains = self.rows
        return gains * (np.clip(q, low, high) - q)


class PostureTask(JointRangeTask):
    """Attraction of some joints to preferred positions: velocity = gain (preferred - q)."""

    def __init__(self, arm: Arm, preferred: Mapping[str, float], gain: float = 1.0) -> None:
        """Set the preferred positions.

        Args:
            arm: arm with the joints.
            preferred: positions by joint name, rad or m.
            gain: gain of the attraction, 1/s.

        Raises:
            ConfigurationError: a joint is unknown, or a position is outside its limits.
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
    """Repulsion of joints from their position limits.

    velocity_i = gain d_i, where d_i is the depth by which q_i has entered the margin at a limit.
    The velocity is directed away from the limit.
    """

    def __init__(self, limits: CommandLimits, margin: float = 0.2, gain: float = 2.0) -> None:
        """Set margin and gain.

        Args:
            limits: position limits of the joints.
            margin: width of the margin at each limit, rad or m, at most a quarter of a joint's
                range.
            gain: gain of the repulsion, 1/s.
        """
        margins = np.minimum(margin, 0.25 * (limits.upper - limits.lower))
        gains = np.full(len(margins), gain)
        self.rows = np.array([limits.lower + margins, limits.upper - margins, gains])


class SingularityAvoidance(SecondaryTask):
    """Gradient ascent of the manipulability w(q) = sqrt(det(J J^T)), active if w is small.

        velocity = gain (1 - w / bound) grad w / max(|grad w|, max_gradient)   for w < bound, else 0

    The manipulability w is computed from the chosen rows of the Jacobian J. The velocity is 0 at w
    = bound and at a maximum of w, where the gradient is 0. (The laboratory's controller takes steps
    of constant length and therefore oscillates about the maximum.)
    """

    def __init__(
        self,
        arm: Arm,
        directions: Sequence[int] = (0, 1, 2, 5),
        gain: float = 0.5,
        bound: float = 0.1,
        max_gradient: float = 0.1,
    ) -> None:
        """Set the directions and the strength of the task.

        Args:
            arm: arm whose Jacobian is used.
            directions: rows of the Jacobian that are used for the manipulability w: 0 for vx to 5
                for wz.
            gain: maximum speed, rad/s.
            bound: manipulability below which the task is active.
            max_gradient: norm of the gradient of w below which the velocity decreases with the
                gradient, so that it is 0 at a maximum of w.
        """
        self._arm = arm
        self._rows = np.array(directions)
        self.gain, self.bound, self.max_gradient = gain, bound, max_gradient

    def manipulability(self, q: np.ndarray) -> float:
        """Compute the manipulability w(q) from the chosen rows of the Jacobian at joints q (n,)."""
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
