"""Trajectories, goals and results of trajectory_msgs and control_msgs, without ROS."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from aras_sim_bridge.errors import ControllerError


class ErrorCode(IntEnum):
    """Result codes of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class InvalidTrajectoryError(ControllerError):
    """A trajectory cannot be followed; `code` is the error code of the action."""

    def __init__(self, text: str, code: ErrorCode = ErrorCode.INVALID_GOAL) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True, slots=True)
class TrajectoryPoint:
    """A waypoint of all joints; an empty sequence means that the quantity is not specified."""

    time_from_start_ns: int
    positions: Sequence[float]
    velocities: Sequence[float] = ()
    accelerations: Sequence[float] = ()


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Waypoints of named joints; with a `stamp_ns` of 0 it starts in the next control cycle."""

    joint_names: Sequence[str]
    points: Sequence[TrajectoryPoint]
    stamp_ns: int = 0


@dataclass(frozen=True, slots=True)
class JointTolerance:
    """Tolerance of one joint; a negative value removes the tolerance, and 0 keeps the default."""

    name: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class TrajectoryGoal:
    """A goal of follow_joint_trajectory.

    Attributes:
        goal_time_tolerance: tolerance of the goal time, s; a negative value removes the tolerance,
            and 0 keeps the default.
    """

    trajectory: Trajectory
    path_tolerance: Sequence[JointTolerance] = ()
    goal_tolerance: Sequence[JointTolerance] = ()
    goal_time_tolerance: float = 0.0


@dataclass(frozen=True, slots=True)
class TrajectoryResult:
    """Error code and text with which a goal ended."""

    error_code: ErrorCode
    error_string: str = ""


@dataclass(frozen=True, slots=True)
class StatePoint:
    """Positions of all joints and their derivatives at `time_from_start`, s."""

    positions: list[float]
    velocities: list[float]
    accelerations: list[float]
    time_from_start: float = 0.0


@dataclass(frozen=True, slots=True)
class TrajectoryControllerState:
    """State of a trajectory controller, for its state topic and its action's feedback.

    `actual` and `error` have no accelerations, because accelerations are not measured. `error` is
    the desired minus the actual state, with position errors in (-pi, pi]; its time_from_start is
    the elapsed time of the current segment.
    """

    stamp_ns: int
    joint_names: tuple[str, ...]
    desired: StatePoint
    actual: StatePoint
    error: StatePoint
