"""Polynomial interpolation between two waypoints of one joint.

Positions alone give a straight line, positions and velocities a cubic polynomial, and additional
accelerations a quintic polynomial. The polynomial has the given values at both ends.
"""

from typing import NamedTuple

_NS_PER_S = 1e9


class Waypoint(NamedTuple):
    """Desired position (rad or m), velocity (per s) and acceleration (per s²).

    A velocity or acceleration of None is not specified.
    """

    position: float
    velocity: float | None = None
    acceleration: float | None = None


Coefficients = tuple[float, float, float, float, float, float]


def fit_spline(start: Waypoint, end: Waypoint, duration: float) -> Coefficients:
    """Return the coefficients c0..c5 of x(t) = sum c_k t^k on [0, duration], duration >= 0 in s.

    Velocities are used only if both waypoints have them. Accelerations are used only if both
    waypoints have velocities and accelerations. With a duration of 0 the polynomial starts at
    `end`.
    """
    cubic = start.velocity is not None and end.velocity is not None
    quintic = cubic and start.acceleration is not None and end.acceleration is not None
    x0, x1, T = start.position, end.position, duration
    v0, v1 = (start.velocity, end.velocity) if cubic else (0.0, 0.0)
    a0, a1 = (start.acceleration, end.acceleration) if quintic else (0.0, 0.0)
    if T == 0.0:
        return x1, v1, 0.5 * a1, 0.0, 0.0, 0.0
    step = x1 - x0
    if not cubic:
        return x0, step / T, 0.0, 0.0, 0.0, 0.0
    if not quintic:
        return (
            x0,
            v0,
            (3.0 * step - (2.0 * v0 + v1) * T) / T**2,
            (-2.0 * step + (v0 + v1) * T) / T**3,
            0.0,
            0.0,
        )
    return (
        x0,
        v0,
        0.5 * a0,
        (20.0 * step - (12.0 * v0 + 8.0 * v1) * T - (3.0 * a0 - a1) * T**2) / (2.0 * T**3),
        (-30.0 * step + (16.0 * v0 + 14.0 * v1) * T + (3.0 * a0 - 2.0 * a1) * T**2)
        / (2.0 * T**4),
        (12.0 * step - 6.0 * (v0 + v1) * T - (a0 - a1) * T**2) / (2.0 * T**5),
    )


class SplineSegment:
    """A spline that is valid from `start_ns` to `end_ns`.

    Attributes:
        time_from_start: start of the segment within its trajectory, s.
        goal: action goal to which the segment and its tolerances belong, or None.
    """

    def __init__(self, start_ns: int, start: Waypoint, end_ns: int, end: Waypoint) -> None:
        self.start_ns = start_ns
        self.end_ns = end_ns
        self.duration = (end_ns - start_ns) / _NS_PER_S
        self.coefficients = fit_spline(start, end, self.duration)
        self.time_from_start = 0.0
        self.goal: object | None = None
        self.path_tolerance = NO_TOLERANCE
        self.goal_tolerance = NO_TOLERANCE
        self.goal_time_ns = 0

    def sample(self, time_ns: int) -> tuple[float, float, float]:
        """Return position, velocity and acceleration at `time_ns`.

        Before the start and after the end of the segment, the joint rests at the nearer end.
        """
        t = (time_ns - self.start_ns) / _NS_PER_S
        c0, c1, c2, c3, c4, c5 = self.coefficients
        if t < 0.0:
            return c0, 0.0, 0.0
        if t > self.duration:
            t = self.duration
            return c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))), 0.0, 0.0
        return (
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
            2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        )


class StateTolerances(NamedTuple):
    """Largest allowed errors of one joint; an error whose tolerance is 0 is not checked."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0

    def is_met(self, position_error: float, velocity_error: float) -> bool:
        """Return whether both errors are within the tolerance.

        The acceleration is not checked, because it is not measured.
        """
        return not (
            0.0 < self.position < abs(position_error) or 0.0 < self.velocity < abs(velocity_error)
        )


NO_TOLERANCE = StateTolerances()
