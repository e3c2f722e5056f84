"""Secondary tasks: what the arm does with the freedom that the camera's motion leaves it.

Six joints serve five task degrees of freedom; the gantry and J1 both move the camera sideways.
A task proposes joint velocities; the resolver keeps only the part that does not move the camera.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from .kinematics import J1, JOINT_NAMES, Kinematics


@dataclass(frozen=True)
class JointLimits:
    """Limits of the six joints in the package's order: m and m/s for the gantry, rad and rad/s.

    The positions are the robot's; the URDF's 5 rad/s is what the motors stand, the speeds here are
    what a servo loop at 30 images/s should ask for.
    """

    lower: tuple[float, ...] = (-1.5, -2.0943, -2.0943, -2.0943, -2.0943, -3000.0)
    upper: tuple[float, ...] = (1.5, 2.0943, 2.0943, 2.0943, 2.0943, 3000.0)
    velocity: tuple[float, ...] = (1.0, 2.0, 2.0, 2.0, 2.0, 2.0)

    def __post_init__(self) -> None:
        for index, name in enumerate(JOINT_NAMES):
            if not self.lower[index] < self.upper[index]:
                raise ValueError(
                    f"limits of {name}: lower {self.lower[index]} must be below "
                    f"upper {self.upper[index]}"
                )
            if not self.velocity[index] > 0.0:
                raise ValueError(
                    f"limits of {name}: velocity {self.velocity[index]} must be positive"
                )


class Task(ABC):
    """Proposes joint velocities (6,), m/s and rad/s, for a posture q (6,)."""

    @abstractmethod
    def velocity(self, q: np.ndarray) -> np.ndarray:
        """Joint velocities this task would like, before projection."""


@dataclass(frozen=True)
class Posture(Task):
    """Draws one joint to a preferred value: velocity = gain (preferred - q), gain in 1/s."""

    joint: int = J1
    preferred: float = 0.0
    gain: float = 1.0

    def velocity(self, q: np.ndarray) -> np.ndarray:
        wanted = np.zeros(6)
        wanted[self.joint] = self.gain * (self.preferred - q[self.joint])
        return wanted


@dataclass(frozen=True)
class JointLimitAvoidance(Task):
    """Pushes joints out of a margin before their limits.

    velocity_i = gain * (depth of q_i inside the margin), away from the limit, gain in 1/s.
    """

    limits: JointLimits
    margin: float = 0.2
    gain: float = 2.0

    def velocity(self, q: np.ndarray) -> np.ndarray:
        below = np.maximum(np.asarray(self.limits.lower) + self.margin - q, 0.0)
        above = np.maximum(q - np.asarray(self.limits.upper) + self.margin, 0.0)
        return self.gain * (below - above)


class SingularityAvoidance(Task):
    """The laboratory's step up the gradient of manipulability, w(q) = sqrt(det(J J^T)).

    velocity = gain * grad w / |grad w| where w is below the bound, 0 elsewhere. On this arm it can
    only act through the redundancy, that is on J1: it turns the arm away from the gantry's line.
    The stretched elbow is not in its reach; the resolver's damping deals with that one.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        rows: np.ndarray | None = None,
        gain: float = 0.12,
        bound: float = 0.5,
    ) -> None:
        self._kinematics = kinematics
        self._rows = rows if rows is not None else np.array([0, 1, 2, 5])
        self.gain = gain
        self.bound = bound

    def manipulability(self, q: np.ndarray) -> float:
        """w(q) of the rows of the camera's Jacobian that the task looks at."""
        jacobian = self._kinematics.jacobian(q)[self._rows]
        return float(np.sqrt(max(np.linalg.det(jacobian @ jacobian.T), 0.0)))

    def velocity(self, q: np.ndarray) -> np.ndarray:
        if self.manipulability(q) >= self.bound:
            return np.zeros(6)
        step = 1e-5
        gradient = np.array(
            [
                self.manipulability(q + step * axis) - self.manipulability(q - step * axis)
                for axis in np.eye(6)
            ]
        ) / (2.0 * step)
        norm = np.linalg.norm(gradient)
        return np.zeros(6) if norm < 1e-9 else self.gain * gradient / norm
