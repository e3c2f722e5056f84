"""Trajectories, goals and results, as trajectory_msgs and control_msgs have them, without ROS."""

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


class TrajectoryError(ControllerError):
    """A trajectory that cannot be followed; `code` says why in the action's terms."""

    def __init__(self, code: ErrorCode, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True, slots=True)
class TrajectoryPoint:
    """A waypoint of all joints; empty sequences mean not given."""

    time_from_start_ns: int
    positions: Sequence[float]
    velocities: Sequence[float] = ()
    accelerations: Sequence[float] = ()


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Waypoints for named joints; `stamp_ns` 0 means from the next control cycle on."""

    joint_names: Sequence[str]
    points: Sequence[TrajectoryPoint]
    stamp_ns: int = 0


@dataclass(frozen=True, slots=True)
class JointTolerance:
    """Tolerance of one joint: above 0 sets it, below 0 removes it, 0 keeps the default."""

    name: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class TrajectoryGoal:
    """A goal of follow_joint_trajectory; `goal_time_tolerance` in s, signs as in JointTolerance."""

    trajectory: Trajectory
    path_tolerance: Sequence[JointTolerance] = ()
    goal_tolerance: Sequence[JointTolerance] = ()
    goal_time_tolerance: float = 0.0


@dataclass(frozen=True, slots=True)
class TrajectoryResult:
    """Why a goal ended."""

    error_code: ErrorCode
    error_string: str = ""


@dataclass(frozen=True, slots=True)
class StatePoint:
    """Positions and derivatives of all joints; `time_from_start` in s."""

    positions: list[float]
    velocities: list[float]
    accelerations: list[float]
    time_from_start: float = 0.0


@dataclass(frozen=True, slots=True)
class TrajectoryState:
    """One sample of a trajectory controller: its state topic and its action's feedback.

    `actual` and `error` carry no accelerations: none are measured. error = desired - actual, as
    an angle; its time_from_start is what has elapsed of the present segment.
    """

    stamp_ns: int
    joint_names: tuple[str, ...]
    desired: StatePoint
    actual: StatePoint
    error: StatePoint
