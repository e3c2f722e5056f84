"""Joint limits of the commands: those of the robot description, narrowed by parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.names import suggest

from ..errors import ConfigurationError
from .arm import Arm

# One number for all joints, a sequence with a number for each joint in the arm's order, or numbers
# by joint name.
JointValues = float | Sequence[float] | Mapping[str, float] | None


@dataclass(frozen=True, eq=False)
class CommandLimits:
    """Joint limits of the commands, in the arm's order.

    Attributes:
        names: (n,) names of the joints.
        lower, upper: (n,) position limits, rad or m; infinite if there is no limit.
        velocity, acceleration: (n,) largest velocities and accelerations, > 0, in rad/s or m/s and
            rad/s² or m/s²; infinite if there is no limit.
    """

    names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    @classmethod
    def for_arm(
        cls,
        arm: Arm,
        lower: JointValues = None,
        upper: JointValues = None,
        velocity: JointValues = None,
        acceleration: JointValues = None,
    ) -> "CommandLimits":
        """Return the arm's limits, replaced by the given ones.

        The given limits must not be wider than the arm's. Without `acceleration`, accelerations are
        not limited.

        Raises:
            ConfigurationError: a joint is unknown, a count is wrong, or a limit is not a number,
                leaves an empty range, or is wider than the robot's own limit.
        """
        own = {"lower": arm.lower, "upper": arm.upper, "velocity": arm.velocity}
        own["acceleration"] = np.full(len(arm.names), np.inf)
        given = {
            "lower": lower, "upper": upper, "velocity": velocity, "acceleration": acceleration
        }  # fmt: skip
        values = {key: _merge_limits(key, arm.names, own[key], given[key]) for key in own}
        for i, name in enumerate(arm.names):
            low, high = values["lower"][i], values["upper"][i]
            if not low < high:
                raise ConfigurationError(
                    f"limits of {name}: lower {low:g} must be below upper {high:g}"
                )
            for key in ("velocity", "acceleration"):
                if not values[key][i] > 0.0:
                    raise ConfigurationError(
                        f"limits of {name}: {key} {values[key][i]:g} must be positive "
                        f"(max_{key})"
                    )
            for key, wider in (
                ("lower", low < arm.lower[i] - 1e-9),
                ("upper", high > arm.upper[i] + 1e-9),
                # A velocity of 0 in a robot description means that the limit is unknown.
                ("velocity", 0.0 < arm.velocity[i] * (1.0 + 1e-9) < values["velocity"][i]),
            ):
                if wider:
                    raise ConfigurationError(
                        f"limits of {name}: {key} {values[key][i]:g} is beyond the robot's own "
                        f"limit {own[key][i]:g}"
                    )
        for array in values.values():
            array.setflags(write=False)
        return cls(arm.names, **values)

    def find_narrowed(self, arm: Arm) -> dict[str, list[str]]:
        """Return the joints whose position limits are narrower than the arm's own.

        They are grouped by the parameter that narrows the limits: 'lower' or 'upper'.
        """
        narrower = {"lower": self.lower > arm.lower, "upper": self.upper < arm.upper}
        return {
            key: [name for name, one in zip(self.names, which, strict=True) if one]
            for key, which in narrower.items()
        }

    def find_violations(self, q: np.ndarray) -> list[str]:
        """Return the names of the joints that are outside their limits at q (n,)."""
        return [name for name, margin in zip(self.names, self.margins(q), strict=True)
                if margin < 0.0]  # fmt: skip

    def margins(self, q: np.ndarray) -> np.ndarray:
        """Return the distance (n,) of joints q to their nearer limit, rad or m.

        The distance is negative if a joint is outside its limits.
        """
        return np.minimum(q - self.lower, self.upper - q)


def _merge_limits(
    key: str, names: Sequence[str], own: np.ndarray, override: JointValues
) -> np.ndarray:
    values = np.array(own, float)
    if override is None:
        return values
    try:
        if isinstance(override, Mapping):
            for name, value in override.items():
                if name not in names:
                    raise ConfigurationError(
                        f"limits: {key} has the unknown joint {name}; {suggest(name, names)}"
                    )
                values[names.index(name)] = float(value)
        elif np.ndim(override) == 0:
            values[:] = float(override)
        elif len(override) == len(names):
            values[:] = [float(value) for value in override]
        else:
            raise ConfigurationError(
                f"limits: {key} has {len(override)} values, must have one for each of "
                f"{', '.join(names)}"
            )
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"limits: {key} is {override!r}: {error}") from error
    if np.isnan(values).any():
        raise ConfigurationError(f"limits: {key} is {override!r}, must be a number")
    return values


def check_within_limits(q: np.ndarray, limits: CommandLimits | Arm, what: str) -> None:
    """Raise a ConfigurationError if joints q (n,) are outside the limits.

    `what` names the source of q in the message.
    """
    for i in np.flatnonzero(~((q >= limits.lower) & (q <= limits.upper))):
        raise ConfigurationError(
            f"{what} puts joint {limits.names[i]} at {q[i]:.4f}, outside the joint's limits "
            f"{limits.lower[i]:.4f} to {limits.upper[i]:.4f}"
        )


@jit("f8, f8, f8")
def compute_stopping_speed(room, acceleration, dt):
    """Compute the largest speed from which a joint can stop within the distance `room`.

    The joint keeps the speed v for dt (s) and then brakes, so v dt + v^2 / (2 acceleration) = room.
    """
    if dt <= 0.0 or room == np.inf:
        return np.inf
    if acceleration == np.inf:
        return room / dt
    # The solution of the quadratic equation is written in a form without cancellation for a small
    # room.
    return 2.0 * room / (dt + np.sqrt(dt * dt + 2.0 * room / acceleration))


@jit("f8[:], f8[:,:], f8")
def compute_velocity_ranges(q, limits, dt):
    """Compute the lowest and the highest velocities (n,) that keep the joints in range for dt (s).

    A joint outside its range may return, but not move further out.
    """
    lower, upper, acceleration = limits[0], limits[1], limits[3]
    low, high = np.empty(len(q)), np.empty(len(q))
    for i in range(len(q)):
        low[i] = -compute_stopping_speed(max(q[i] - lower[i], 0.0), acceleration[i], dt)
        high[i] = compute_stopping_speed(max(upper[i] - q[i], 0.0), acceleration[i], dt)
    return low, high


@jit("f8[:], f8[:]")
def _find_scale(desired, room):
    """Return the largest factor <= 1 for which |factor desired_i| <= room_i for all joints i.

    The second result is the index of the joint that limits the factor. Both arguments are arrays
    (n,).
    """
    part, joint = 1.0, 0
    for i in range(len(desired)):
        size = abs(desired[i])
        if size > room[i] and max(room[i], 0.0) / size < part:
            part, joint = max(room[i], 0.0) / size, i
    return part, joint


@jit("f8[:], f8[:], f8[:], f8[:], f8[:,:], f8, b1, f8[:], f8[:], f8[:]")
def limit_velocities(desired, secondary, low, high, limits, dt, is_limited, previous, total, task):
    """Limit velocities by the ranges of position, speed and acceleration.

    Args:
        desired: (n,) velocities for the task.
        secondary: (n,) velocities that do not affect the task.
        low, high: (n,) lowest and highest velocities that `compute_velocity_ranges` returns.
        limits: (5, n) see `solve_velocities`.
        dt: time for which the velocities are applied, s.
        is_limited: whether the acceleration is limited, starting from the velocities `previous`.
        previous: (n,) velocities that were commanded before.
        total, task: (n,) velocities of the last solution, and their part for the task. If
            `previous` equals `total`, the acceleration of the task part is measured from `task`,
            otherwise from `previous`.

    Returns:
        The velocities (n,); their part (n,) for the task; the factor by which limits scaled this
        part; the index of the joint whose limit reduced the factor, or -1.
    """
    count, fastest, acceleration = len(desired), limits[2], limits[3]
    part, slowest = _find_scale(desired, fastest)
    if part == 1.0:
        slowest = -1
    primary, others = np.empty(count), np.zeros(count)
    for i in range(count):
        primary[i] = part * desired[i]
    if is_limited:
        unchanged, change = True, np.empty(count)
        for i in range(count):
            unchanged &= abs(previous[i] - total[i]) < 1e-9
        before, steps = task if unchanged else previous, np.empty(count)
        for i in range(count):
            others[i] = previous[i] - before[i]
            steps[i] = primary[i] - before[i]
            change[i] = acceleration[i] * dt
        part, joint = _find_scale(steps, change)
        if part < 1.0:
            slowest = joint
            for i in range(count):
                primary[i] = before[i] + part * steps[i]
    towards, room, velocities = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        lowest, highest = max(low[i], -fastest[i]), min(high[i], fastest[i])
        if is_limited:
            # These bounds allow a joint to brake with at most its maximum acceleration, even if it
            # cannot stop before the end of its range.
            slower, faster = previous[i] - acceleration[i] * dt, previous[i] + acceleration[i] * dt
            lowest = min(max(lowest, slower), faster)
            highest = min(max(highest, slower), faster)
        velocities[i] = min(max(primary[i] + others[i], lowest), highest)
        # The secondary tasks get what the task leaves of the range of each joint's velocity.
        towards[i] = secondary[i] - others[i]
        room[i] = highest - velocities[i] if towards[i] > 0.0 else velocities[i] - lowest
    part, _ = _find_scale(towards, room)
    along, whole = 0.0, 0.0
    for i in range(count):
        velocities[i] += part * towards[i]
        along += primary[i] * desired[i]
        whole += desired[i] * desired[i]
    return velocities, primary, along / whole if slowest >= 0 else 1.0, slowest
