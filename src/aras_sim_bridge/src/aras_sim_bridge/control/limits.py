"""Limit rules of ros_control's joint_limits_interface, applied to commands before writing.

A rule modifies the command in the handle. Without a new command, the limited value therefore
remains.
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
# Rules without and with soft limits, by interface.
_KINDS = {
    EFFORT: (EFFORT_SATURATION, EFFORT_SOFT),
    POSITION: (POSITION_SATURATION, POSITION_SOFT),
    VELOCITY: (VELOCITY_SATURATION, VELOCITY_SOFT),
}
# Name of each rule, and the limits that it needs.
_NEEDS = {
    EFFORT_SATURATION: ("effort saturation", "max_velocity", "max_effort"),
    EFFORT_SOFT: ("soft effort limit", "max_velocity", "max_effort"),
    POSITION_SATURATION: ("position saturation",),
    POSITION_SOFT: ("soft position limit", "max_velocity"),
    VELOCITY_SATURATION: ("velocity saturation", "max_velocity"),
    VELOCITY_SOFT: ("soft velocity limit", "max_velocity"),
}
# Columns of a rule's row: its kind; position limits; largest speed and acceleration (NaN: not
# limited) and effort; soft limits and their gains; previous command (NaN: none yet).
(_KIND, _LOWER, _UPPER, _SPEED, _ACCELERATION, _EFFORT, _SOFT_LOWER, _SOFT_UPPER, _K_POSITION,
 _K_VELOCITY, _PREVIOUS), RULE_COLUMNS = range(11), 11


class LimitRule:
    """One limit rule; its state is stored in `row`.

    effort saturation: effort within ±max_effort, and none that increases a violation of the
    position or velocity limit.
    soft effort limit: effort bounds proportional to the distance from the soft velocity bounds.
    position saturation: position within [min, max], and within max_velocity · dt of the previous
    command.
    soft position limit: in addition within the soft velocity bounds at the previous command.
    velocity saturation: velocity within ±max_velocity, changed at most by max_acceleration · dt.
    soft velocity limit: velocity within the soft bounds at the measured position, changed at most
    by max_acceleration · dt.
    Soft velocity bounds decrease towards the soft position limits.
    """

    __slots__ = ("row",)

    kind = column(_KIND)

    def __init__(self, kind: int, limits: JointBounds, handle: JointHandle,
                 row: np.ndarray | None = None) -> None:
        """Store the state in `row` (11,), a part of a drive's row; None creates a new row.

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
            # A missing soft limit does not limit; urdfdom's default of 0 would lock the joint at 0.
            if limits.has_position and soft.lower is not None:
                row[_SOFT_LOWER] = soft.lower
            if limits.has_position and soft.upper is not None:
                row[_SOFT_UPPER] = soft.upper
        self.reset()

    def reset(self) -> None:
        """Discard the previous command; the rule continues from the measured position or rest."""
        self.row[_PREVIOUS] = nan


def make_rule(handle: JointHandle, limits: JointBounds | None,
             row: np.ndarray | None = None) -> LimitRule | None:
    """Return the rule for the joint's interface, soft with a <safety_controller>; or None."""
    if limits is None:
        return None
    return LimitRule(_KINDS[handle.interface][handle.soft_limits is not None], limits, handle, row)


@jit("f8, f8, f8", allocates=False)
def _saturate(value, low, high):
    # If the bounds are crossed the upper one is used, as in min(max()) of joint_limits_interface.
    value = low if value < low else value
    return high if value > high else value


@jit("f8[::1], f8", allocates=False)
def _find_soft_speeds(row, position):
    """Return the lowest and highest velocity that the soft limits allow at a position."""
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
