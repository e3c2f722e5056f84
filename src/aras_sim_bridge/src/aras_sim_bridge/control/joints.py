"""Joint handles and joint limits.

As in ros_control, a joint handle contains the measured state of a joint and one command for each
interface. The hardware writes the state and reads the commands; controllers do the opposite.
Units: rad or m, rad/s or m/s, N m or N.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from aras_sim_bridge.errors import HardwareError
from aras_visual_servo_base.compiled import column, jit
from aras_visual_servo_base.settings import read
from aras_visual_servo_base.urdf import Joint, JointLimits, SoftLimits

log = logging.getLogger(__name__)

EFFORT = "EffortJointInterface"
POSITION = "PositionJointInterface"
VELOCITY = "VelocityJointInterface"
STATE = "JointStateInterface"
COMMAND_INTERFACES = (EFFORT, POSITION, VELOCITY)

_NS_PER_S = 1_000_000_000

# Columns of the array that stores a JointHandle: measured position, velocity and effort; commanded
# position, velocity and effort.
(Q, V, TAU, Q_COMMAND, V_COMMAND, TAU_COMMAND), HANDLE_COLUMNS = range(6), 6
# For each command interface, the column that contains its command.
COMMAND_COLUMNS = {EFFORT: TAU_COMMAND, POSITION: Q_COMMAND, VELOCITY: V_COMMAND}
# Columns of the array that stores a RateLimitedEvent: times of the first and of the last occurrence
# of the event, ns (NaN before the first one); whether the event was reported; and `patience` and
# `quiet`, ns.
(_FIRST, _LAST, _REPORTED, _PATIENCE, _QUIET), EVENT_COLUMNS = range(5), 5
# A command that exceeds a limit by less than this, in the command's unit, is within the limit up to
# rounding errors.
COMMAND_ROUNDING = 1e-6


@dataclass(slots=True, eq=False)
class JointHandle:
    """State and commands of one joint; the values are stored in `row`.

    Attributes:
        interface: command interface of the joint's transmission.
        limits, soft_limits: the URDF's `<limit>` and `<safety_controller>`, or None. As in
            ros_controllers, controllers use these and ignore the parameters in joint_limits.
        row: (6,) row of the robot's array; by default an array of its own.
    """

    name: str
    kind: str
    limits: JointLimits | None = None
    soft_limits: SoftLimits | None = None
    interface: str = STATE
    row: np.ndarray = field(default_factory=lambda: np.zeros(HANDLE_COLUMNS))

    position, velocity, effort = column(Q), column(V), column(TAU)
    position_command, velocity_command = column(Q_COMMAND), column(V_COMMAND)
    effort_command = column(TAU_COMMAND)

    @property
    def is_angular(self) -> bool:
        """Whether the joint is revolute or continuous."""
        return self.kind in ("revolute", "continuous")

    @property
    def position_limits(self) -> tuple[float, float] | None:
        """(lower, upper) limits in the URDF; None if the joint is not revolute or prismatic."""
        limits = self.limits
        if self.kind not in ("revolute", "prismatic") or limits is None:
            return None
        # A URDF <limit> without the attribute lower or upper has a limit of 0.
        return limits.lower or 0.0, limits.upper or 0.0


@dataclass(frozen=True, slots=True)
class JointBounds:
    """Limits of a joint, merged from URDF and parameters; a quantity with None is not limited."""

    min_position: float | None = None
    max_position: float | None = None
    max_velocity: float | None = None
    max_acceleration: float | None = None
    max_effort: float | None = None

    @property
    def has_position(self) -> bool:
        """Whether the position is limited."""
        return self.min_position is not None


# For each limited quantity, its parameters in joint_limits/<joint>.
_OVERRIDES = {
    "position": ("min_position", "max_position"),
    "velocity": ("max_velocity",),
    "acceleration": ("max_acceleration",),
    "effort": ("max_effort",),
}


def resolve_limits(joint: Joint, overrides: Mapping, where: str) -> JointBounds | None:
    """Merge the URDF's limits of `joint` with the parameters <ns>/joint_limits/<joint>.

    As in ros_control, a parameter such as max_velocity is ignored unless has_velocity_limits is
    true; in addition, a warning is logged.

    Args:
        where: full name of the parameter `overrides`.

    Returns:
        The limits, or None if neither the URDF nor the parameters limit the joint.

    Raises:
        HardwareError: a limit has a wrong type or is negative, or the lower position limit is above
            the upper limit.
    """
    values: dict[str, float] = {}
    if joint.limits is not None:
        values["max_velocity"] = joint.limits.velocity
        values["max_effort"] = joint.limits.effort
        if joint.kind in ("revolute", "prismatic"):
            values["min_position"] = joint.limits.lower or 0.0
            values["max_position"] = joint.limits.upper or 0.0
    if joint.limits is None and not overrides:
        return None
    for quantity, keys in _OVERRIDES.items():
        _override(values, overrides, quantity, keys, where)
    limits = JointBounds(**values)
    _check(limits, joint.name, where)
    return limits


def _override(
    values: dict[str, float],
    overrides: Mapping,
    quantity: str,
    keys: tuple[str, ...],
    where: str,
) -> None:
    switch = f"has_{quantity}_limits"
    enabled = read(overrides, switch, bool, where, HardwareError, None)
    given = [key for key in keys if key in overrides]
    if enabled is False:
        for key in keys:
            values.pop(key, None)
    elif enabled and len(given) == len(keys):
        for key in keys:
            values[key] = read(overrides, key, float, where, HardwareError)
    elif enabled:
        missing = [key for key in keys if key not in given]
        log.warning(f"{where}/{switch} has no effect without {' and '.join(missing)}: set "
                    f"{' and '.join(f'{where}/{key}' for key in missing)}")
    elif given:
        log.warning(f"{where}/{given[0]} is ignored: set {where}/{switch} to true to use it")


def _check(limits: JointBounds, joint: str, where: str) -> None:
    if limits.has_position and limits.min_position > limits.max_position:
        raise HardwareError(
            f"joint '{joint}': lower position limit {limits.min_position} is above the upper "
            f"{limits.max_position}; correct its <limit> or {where}"
        )
    for quantity in ("max_velocity", "max_acceleration", "max_effort"):
        value = getattr(limits, quantity)
        if value is not None and not value >= 0.0:
            raise HardwareError(
                f"joint '{joint}': {quantity} is {value}; it must not be negative; "
                f"correct its <limit> or {where}/{quantity}"
            )


class RateLimitedEvent:
    """Decides whether to log a condition that may persist over many cycles.

    An event ends when the condition has not occurred for `quiet` s. An event shorter than
    `patience` s, such as the derivative kick of a step command, is not reported. All times are
    simulated times.
    """

    def __init__(self, patience: float = 0.0, quiet: float = 1.0,
                 row: np.ndarray | None = None) -> None:
        """Store the state in `row` (5,), a slice of a larger array; if None, in a new array."""
        self.row = np.zeros(EVENT_COLUMNS) if row is None else row
        self.row[_PATIENCE], self.row[_QUIET] = patience * _NS_PER_S, quiet * _NS_PER_S
        self.reset()

    def reset(self) -> None:
        """Discard the current event, because the clock was reset."""
        self.row[_LAST] = np.nan

    def record(self, time_ns: int) -> bool:
        """Record that the condition is true at `time_ns`; return True once for each event."""
        return record_event(self.row, time_ns)


@jit("f8[::1], f8", allocates=False)
def record_event(row, time_ns):
    """Record in an event's row that the condition is true; return True once for each event."""
    if not 0.0 <= time_ns - row[_LAST] <= row[_QUIET]:
        row[_FIRST], row[_REPORTED] = time_ns, 0.0
    row[_LAST] = time_ns
    if row[_REPORTED] != 0.0 or time_ns - row[_FIRST] < row[_PATIENCE]:
        return False
    row[_REPORTED] = 1.0
    return True
