"""Conversion of a trajectory message into a list of spline segments for each joint."""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import fabs, isclose, isfinite, pi

from aras_sim_bridge import angles
from aras_sim_bridge.control.controllers.action_controller import GoalHandle
from aras_sim_bridge.control.controllers.splines import SplineSegment, StateTolerances, Waypoint
from aras_sim_bridge.control.controllers.trajectory_types import (
    ErrorCode,
    InvalidTrajectoryError,
    JointTolerance,
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
)
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read

_NS_PER_S = 1e9

JointSegments = list[SplineSegment]


@dataclass(frozen=True, slots=True)
class SegmentTolerances:
    """Path and goal tolerances of each joint, in the controller's order, and of the goal time (ns).
    """

    path: tuple[StateTolerances, ...]
    goal: tuple[StateTolerances, ...]
    goal_time_ns: int = 0

    @classmethod
    def from_parameters(
        cls, parameters: Mapping, where: str, joints: Sequence[str]
    ) -> "SegmentTolerances":
        """Read the parameter `constraints`. Raises ControllerError for a value of a wrong type."""
        given = partial(read, parameters, where=where, fault=ControllerError)
        stopped = given("stopped_velocity_tolerance", float, default=0.01)
        path, goal = [], []
        for joint in joints:
            limits = given(joint, Mapping, default={})
            place = f"{where}/{joint}"
            path.append(
                StateTolerances(read(limits, "trajectory", float, place, ControllerError, 0.0))
            )
            at_goal = read(limits, "goal", float, place, ControllerError, 0.0)
            goal.append(StateTolerances(at_goal, stopped))
        time = given("goal_time", float, default=0.0)
        return cls(tuple(path), tuple(goal), round(time * _NS_PER_S))

    def override(self, goal: TrajectoryGoal, joints: Sequence[str]) -> "SegmentTolerances":
        """Return a copy of these tolerances in which the tolerances of `goal` replace the defaults.

        Raises:
            InvalidTrajectoryError: a joint is unknown, or a tolerance is not finite.
        """
        path, at_goal = list(self.path), list(self.goal)
        for tolerances, overrides in ((path, goal.path_tolerance), (at_goal, goal.goal_tolerance)):
            for override in overrides:
                if override.name not in joints:
                    raise InvalidTrajectoryError(
                        f"the goal has a tolerance for '{override.name}', which is not a joint of "
                        f"the controller; the joints are {', '.join(joints)}",
                    )
                k = joints.index(override.name)
                tolerances[k] = _override_tolerance(tolerances[k], override)
        time_ns = self.goal_time_ns
        if not isfinite(goal.goal_time_tolerance):
            raise InvalidTrajectoryError("goal_time_tolerance is not finite")
        if goal.goal_time_tolerance != 0.0:
            time_ns = round(max(goal.goal_time_tolerance, 0.0) * _NS_PER_S)
        return SegmentTolerances(tuple(path), tuple(at_goal), time_ns)

    def apply_to(self, segment: SplineSegment, goal: GoalHandle, joint: int) -> None:
        """Assign a goal and its tolerances to a segment of the joint with index `joint`."""
        segment.goal = goal
        segment.path_tolerance = self.path[joint]
        segment.goal_tolerance = self.goal[joint]
        segment.goal_time_ns = self.goal_time_ns


def _override_tolerance(default: StateTolerances, override: JointTolerance) -> StateTolerances:
    values = []
    for field in StateTolerances._fields:
        tolerance = getattr(override, field)
        if not isfinite(tolerance):
            raise InvalidTrajectoryError(
                f"{field} tolerance of joint '{override.name}' is not finite; set a number",
            )
        values.append(getattr(default, field) if tolerance == 0.0 else max(tolerance, 0.0))
    return StateTolerances(*values)


def find_segment(segments: JointSegments, time_ns: int) -> int:
    """Return the index of the last segment that starts at or before `time_ns`, or -1."""
    return bisect_right(segments, time_ns, key=lambda segment: segment.start_ns) - 1


def find_joint_columns(
    names: Sequence[str], joints: Sequence[str], partial: bool
) -> list[int | None]:
    """Return the index in `names` of each of the controller's `joints`, or None if it is missing.

    `names` are the joints of a trajectory message. `partial` allows missing joints.

    Raises:
        InvalidTrajectoryError: the joints of message and controller do not match (INVALID_JOINTS).
    """
    unknown = [name for name in names if name not in joints]
    if unknown or len(set(names)) != len(names) or not names:
        what = f"unknown are {', '.join(map(repr, unknown))}" if unknown else "empty or repeated"
        raise InvalidTrajectoryError(
            f"joints of the trajectory are wrong ({what}); use those of the controller: "
            f"{', '.join(joints)}",
            ErrorCode.INVALID_JOINTS,
        )
    if len(names) != len(joints) and not partial:
        raise InvalidTrajectoryError(
            f"trajectory has {len(names)} of {len(joints)} joints and "
            f"allow_partial_joints_goal is false; name all joints or set the parameter to true",
            ErrorCode.INVALID_JOINTS,
        )
    return [list(names).index(joint) if joint in names else None for joint in joints]


def check_points(trajectory: Trajectory) -> None:
    """Check sizes, times and numbers of a trajectory's points.

    As in ros_controllers, the lists of a point may be longer than the number of joints if all have
    the same length; additional values are ignored.

    Raises:
        InvalidTrajectoryError: sizes differ, times do not increase or a number is not finite
            (INVALID_GOAL).
    """
    size = len(trajectory.joint_names)
    previous: int | None = None
    for k, point in enumerate(trajectory.points):
        for field in ("positions", "velocities", "accelerations"):
            values = getattr(point, field)
            expected_count = max(size, len(point.positions))
            if len(values) != expected_count and (len(values) or field == "positions"):
                raise InvalidTrajectoryError(
                    f"trajectory point {k} has {len(values)} {field} for {size} joints; give one "
                    "for each joint",
                )
            if not all(map(isfinite, values)):
                raise InvalidTrajectoryError(
                    f"trajectory point {k} has {field} that are not finite; correct them",
                )
        if previous is not None and point.time_from_start_ns <= previous:
            raise InvalidTrajectoryError(
                "time_from_start must strictly increase from point to point; correct "
                f"trajectory point {k}, which is not later than the point before",
            )
        previous = point.time_from_start_ns


def plan_segments(
    trajectory: Trajectory,
    columns: Sequence[int | None],
    current: Sequence[JointSegments],
    wraps: Sequence[bool],
    next_ns: int,
    start_ns: int,
    goal: GoalHandle | None = None,
    tolerances: SegmentTolerances | None = None,
) -> tuple[list[JointSegments], int]:
    """Plan the segments of all joints for a new trajectory.

    The joints follow the current trajectory until `start_ns`, or until `next_ns` if `start_ns` is
    in the past. From then on, a connecting segment leads to the first new point that is not in the
    past. Joints that are not in the new trajectory keep their current segments, which then belong
    to the new goal.

    Args:
        trajectory: new trajectory.
        columns: index of each joint of the controller in the trajectory's points; None if the
            trajectory does not contain the joint.
        current: current segments of each joint.
        wraps: whether each joint is continuous; the new points of a continuous joint are shifted by
            full turns so that the connecting segment rotates in the shorter direction.
        next_ns: time of the next control cycle, ns. Points up to this time are in the past.
        start_ns: time, ns, from which the new points' time_from_start counts.
        goal, tolerances: action goal of the new trajectory and its tolerances, or None.

    Returns:
        The segments of each joint, and the number of points that were dropped because they are in
        the past.

    Raises:
        InvalidTrajectoryError: all points are in the past.
    """
    points = [p for p in trajectory.points if start_ns + p.time_from_start_ns > next_ns]
    dropped = len(trajectory.points) - len(points)
    if not points:
        late = (next_ns - start_ns - trajectory.points[-1].time_from_start_ns) / _NS_PER_S
        raise InvalidTrajectoryError(
            f"all {dropped} trajectory points are in the past, the last one by {late:.3f} s; check "
            f"the header stamp and time_from_start",
        )
    bridge_ns = max(start_ns, next_ns)
    result = []
    for joint, column in enumerate(columns):
        present = current[joint]
        first = find_segment(present, next_ns)
        # The trajectory does not contain this joint: as in ros_controllers, the joint's remaining
        # segments belong to the new goal.
        if column is None:
            for segment in present[max(first, 0) :]:
                segment.goal = goal
            result.append(present)
            continue
        last = find_segment(present, bridge_ns)
        remaining = present[max(first, 0) : last + 1] if start_ns > next_ns else []
        new = _plan_joint(
            points, column, Waypoint(*present[max(last, 0)].sample(bridge_ns)), wraps[joint],
            start_ns, bridge_ns,
        )
        if goal is not None and tolerances is not None:
            for segment in new:
                tolerances.apply_to(segment, goal, joint)
        result.append([*remaining, *new])
    return result, dropped


def _plan_joint(
    points: Sequence[TrajectoryPoint],
    column: int,
    start: Waypoint,
    wraps: bool,
    start_ns: int,
    bridge_ns: int,
) -> JointSegments:
    """Return the segments of one joint: from `start` to the first point, and between the points.

    The joint is at `start` at the time `bridge_ns`; the points' times count from `start_ns`.
    `column` is the joint's index in the points, and `wraps` is True if the joint is continuous.
    """
    shift = _count_turns(start.position, points[0].positions[column]) if wraps else 0.0
    waypoints = [_make_waypoint(point, column, shift) for point in points]
    times = [start_ns + point.time_from_start_ns for point in points]
    segments = [SplineSegment(bridge_ns, start, times[0], waypoints[0])]
    segments[0].time_from_start = (bridge_ns - start_ns) / _NS_PER_S
    for k in range(1, len(points)):
        segment = SplineSegment(times[k - 1], waypoints[k - 1], times[k], waypoints[k])
        segment.time_from_start = points[k - 1].time_from_start_ns / _NS_PER_S
        segments.append(segment)
    return segments


def _make_waypoint(point: TrajectoryPoint, column: int, shift: float) -> Waypoint:
    return Waypoint(
        point.positions[column] + shift,
        point.velocities[column] if len(point.velocities) else None,
        point.accelerations[column] if len(point.accelerations) else None,
    )


def _count_turns(present: float, desired: float) -> float:
    """Return the multiple of 2π that, added to `desired`, brings it within π of `present`."""
    distance = angles.shortest_angular_distance(present, desired)
    # If both directions are half a turn long, rotate in the direction of the sign of `desired` -
    # `present`.
    if isclose(fabs(distance), pi, rel_tol=0.0, abs_tol=1e-9):
        distance = fabs(distance) if desired > present else -fabs(distance)
    return round((present + distance - desired) / (2.0 * pi)) * 2.0 * pi
