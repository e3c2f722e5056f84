"""Limit rules of ros_control's joint_limits_interface, which limit the commands of joints.

A rule modifies the command in the joint handle. The limited command therefore remains until the
controller writes a new command.
"""

from math import inf, isnan, nan

import numpy as np

from aras_sim_bridge.control.joints import (
    EFFORT,
    POSITION,
    Q_COMMAND,
    TAU_COMMAND,
    V_COMMAND,
    VELOCITY,
    JointBounds,
    JointHandle,
    Q,
    V,
)
from aras_sim_bridge.errors import HardwareError
from aras_visual_servo_base.compiled import column, jit

(NO_RULE, EFFORT_SATURATION, EFFORT_SOFT, POSITION_SATURATION, POSITION_SOFT, VELOCITY_SATURATION,
 VELOCITY_SOFT) = range(7)
# For each command interface, the kind of limit rule without soft limits, and the kind with soft
# limits.
_KINDS = {
    EFFORT: (EFFORT_SATURATION, EFFORT_SOFT),
    POSITION: (POSITION_SATURATION, POSITION_SOFT),
    VELOCITY: (VELOCITY_SATURATION, VELOCITY_SOFT),
}
# For each kind of limit rule, its name in messages and the limits that the rule needs.
_NEEDS = {
    EFFORT_SATURATION: ("effort saturation", "max_velocity", "max_effort"),
    EFFORT_SOFT: ("soft effort limit", "max_velocity", "max_effort"),
    POSITION_SATURATION: ("position saturation",),
    POSITION_SOFT: ("soft position limit", "max_velocity"),
    VELOCITY_SATURATION: ("velocity saturation", "max_velocity"),
    VELOCITY_SOFT: ("soft velocity limit", "max_velocity"),
}
# Columns of the array that stores the state of a LimitRule.
(
    (
        _KIND,  # kind of the limit rule, such as POSITION_SOFT
        _LOWER,  # lower position limit of the joint, rad or m
        _UPPER,  # upper position limit of the joint, rad or m
        _SPEED,  # largest speed of the joint, rad/s or m/s; NaN without a limit
        _ACCELERATION,  # largest acceleration of the joint, rad/s² or m/s²; NaN without a limit
        _EFFORT,  # largest effort of the joint, N m or N; NaN without a limit
        _SOFT_LOWER,  # lower soft position limit of the joint, rad or m
        _SOFT_UPPER,  # upper soft position limit of the joint, rad or m
        _K_POSITION,  # gain of the soft position limits (k_position of <safety_controller>), 1/s
        # Gain of the soft effort limits (k_velocity of <safety_controller>), N m s/rad or N s/m.
        _K_VELOCITY,
        _PREVIOUS,  # previous command, limited by the rule; NaN before the first command
    ),
    RULE_COLUMNS,
) = range(11), 11


class LimitRule:
    """One limit rule; its state is stored in `row`.

    The soft velocity bounds are a lower and an upper velocity, which decrease in magnitude towards
    the soft position limits. The rules are:

    - effort saturation: the effort is within ±max_effort. If the joint exceeds a position or
      velocity limit, the effort must not increase the violation.
    - soft effort limit: the bounds of the effort are proportional to the differences between the
      velocity and the soft velocity bounds.
    - position saturation: the position is within [min, max], and changes by at most max_velocity ·
      dt from the previous command.
    - soft position limit: like position saturation, but the change is within dt times the soft
      velocity bounds at the previous command.
    - velocity saturation: the velocity is within ±max_velocity, and changes by at most
      max_acceleration · dt from the previous command.
    - soft velocity limit: the velocity is within the soft velocity bounds at the measured position,
      and differs from the measured velocity by at most max_acceleration · dt.
    """

    kind = column(_KIND)

    def __init__(self, kind: int, limits: JointBounds, handle: JointHandle,
                 row: np.ndarray | None = None) -> None:
        """Store the state in `row` (11,), a slice of a drive's row; if None, in a new array.

        Raises:
            HardwareError: a limit that the rule needs is missing.
        """
        rule, *needs = _NEEDS[kind]
        for quantity in needs:
            if getattr(limits, quantity) is None:
                raise HardwareError(
                    f"joint '{handle.name}': {rule} needs {quantity}; give it in the URDF's "
                    f"<limit> or in joint_limits/{handle.name}"
                )
        self.row = row = np.zeros(RULE_COLUMNS) if row is None else row
        bounds = limits.min_position, limits.max_position
        row[: _EFFORT + 1] = (
            kind, *(bounds if limits.has_position else (-inf, inf)),
            *(nan if value is None else value
              for value in (limits.max_velocity, limits.max_acceleration, limits.max_effort)),
        )  # fmt: skip
        row[_SOFT_LOWER], row[_SOFT_UPPER] = -inf, inf
        soft = handle.soft_limits
        if soft is not None:
            row[_K_POSITION], row[_K_VELOCITY] = soft.k_position, soft.k_velocity
            # A missing soft position limit has no effect, whereas urdfdom's default of 0 would lock
            # the joint at 0.
            if limits.has_position and soft.lower is not None:
                row[_SOFT_LOWER] = soft.lower
            if limits.has_position and soft.upper is not None:
                row[_SOFT_UPPER] = soft.upper
        self.reset()

    def reset(self) -> None:
        """Discard the previous command.

        For the next command, the measured position replaces it, or a velocity of 0.
        """
        self.row[_PREVIOUS] = nan


def make_rule(handle: JointHandle, limits: JointBounds | None,
             row: np.ndarray | None = None) -> LimitRule | None:
    """Return the limit rule for the joint's interface, or None without limits.

    A joint with a <safety_controller> gets the rule with soft limits.
    """
    if limits is None:
        return None
    return LimitRule(_KINDS[handle.interface][handle.soft_limits is not None], limits, handle, row)


@jit("f8, f8, f8", allocates=False)
def _saturate(value, low, high):
    # The order of both tests matters if `low` exceeds `high`: the result is then `high`, as in
    # joint_limits_interface.
    value = low if value < low else value
    return high if value > high else value


@jit("f8[::1], f8", allocates=False)
def _find_soft_speeds(row, position):
    """Return the lower and upper soft velocity bounds at a position."""
    speed, gain = row[_SPEED], row[_K_POSITION]
    slowest, fastest = -speed, speed
    if row[_SOFT_LOWER] != -inf:
        slowest = _saturate(-gain * (position - row[_SOFT_LOWER]), -speed, speed)
    if row[_SOFT_UPPER] != inf:
        fastest = _saturate(-gain * (position - row[_SOFT_UPPER]), -speed, speed)
    return slowest, fastest


@jit("f8[::1], f8[::1], f8", allocates=False)
def enforce_limits(row, handle, dt):
    """Limit the command of a joint and return whether it was changed.

    Args:
        row: row of a LimitRule.
        handle: (6,), row of a JointHandle, whose command is modified.
        dt: time since the last call, s.
    """
    kind, position, velocity = int(row[_KIND]), handle[Q], handle[V]
    effort, speed, previous = row[_EFFORT], row[_SPEED], row[_PREVIOUS]
    target = Q_COMMAND
    low, high = row[_LOWER], row[_UPPER]
    if kind == EFFORT_SATURATION:
        target = TAU_COMMAND
        low = 0.0 if position < row[_LOWER] or velocity < -speed else -effort
        high = 0.0 if position > row[_UPPER] or velocity > speed else effort
    elif kind == EFFORT_SOFT:
        target = TAU_COMMAND
        slowest, fastest = _find_soft_speeds(row, position)
        gain = row[_K_VELOCITY]
        low = _saturate(-gain * (velocity - slowest), -effort, effort)
        high = _saturate(-gain * (velocity - fastest), -effort, effort)
    elif kind in (POSITION_SATURATION, POSITION_SOFT):
        if isnan(previous):
            previous = position
        slowest, fastest = -speed, speed
        if kind == POSITION_SOFT:
            slowest, fastest = _find_soft_speeds(row, previous)
        if not isnan(speed):
            low = max(previous + slowest * dt, low)
            high = min(previous + fastest * dt, high)
    else:
        target = V_COMMAND
        slowest, fastest, base = -speed, speed, 0.0 if isnan(previous) else previous
        if kind == VELOCITY_SOFT:
            slowest, fastest = _find_soft_speeds(row, position)
            base = velocity
        low, high = slowest, fastest
        if not isnan(row[_ACCELERATION]):
            step = row[_ACCELERATION] * dt
            low, high = max(base - step, low), min(base + step, high)
    desired = handle[target]
    handle[target] = row[_PREVIOUS] = _saturate(desired, low, high)
    return handle[target] != desired
