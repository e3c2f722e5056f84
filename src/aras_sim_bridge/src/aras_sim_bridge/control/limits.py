"""What ros_control's joint_limits_interface does to a command before it is written.

One class a rule; enforce(handle, dt) rewrites the command in the handle, so that a command that
nobody renews stays at its limited value. dt is the write period in s.
"""

from math import isnan, nan

from aras_sim_bridge.control.joints import EFFORT, POSITION, JointBounds, JointHandle
from aras_sim_bridge.errors import HardwareError
from aras_visual_servo_base.urdf import SoftLimits

_INF = float("inf")


def _saturate(value: float, low: float, high: float) -> float:
    # The upper bound wins where the two cross, as in the original's min(max()).
    value = low if value < low else value
    return high if value > high else value


def _need(limits: JointBounds, handle: JointHandle, rule: str, *quantities: str) -> None:
    for quantity in quantities:
        if getattr(limits, quantity) is None:
            raise HardwareError(
                f"joint '{handle.name}': {rule} needs {quantity}; give it in the URDF's <limit> "
                f"or in joint_limits/{handle.name}"
            )


class _Rule:
    """What all have in common; only some remember the last command."""

    __slots__ = ()

    def reset(self) -> None:
        """Forget the command before."""


class EffortSaturation(_Rule):
    """Clamp to +-max_effort; no push further out beyond a position or velocity limit."""

    __slots__ = ("_lower", "_upper", "_velocity", "_effort")

    def __init__(self, limits: JointBounds, handle: JointHandle) -> None:
        _need(limits, handle, "effort saturation", "max_velocity", "max_effort")
        self._lower = limits.min_position if limits.has_position else -_INF
        self._upper = limits.max_position if limits.has_position else _INF
        self._velocity = limits.max_velocity
        self._effort = limits.max_effort

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Lower and upper position, speed, effort."""
        return self._lower, self._upper, self._velocity, self._effort

    def enforce(self, handle: JointHandle, dt: float) -> None:
        """Rewrite handle.effort_command."""
        high = self._effort
        low = -high
        if handle.position < self._lower:
            low = 0.0
        elif handle.position > self._upper:
            high = 0.0
        velocity = handle.velocity
        if velocity < -self._velocity:
            low = 0.0
        elif velocity > self._velocity:
            high = 0.0
        command = handle.effort_command
        if command < low:
            command = low
        handle.effort_command = high if command > high else command


class _SoftBounds:
    """Velocity bounds that shrink towards the soft position limits."""

    __slots__ = ("_limited", "_lower", "_upper", "_gain", "_velocity")

    def __init__(self, limits: JointBounds, soft: SoftLimits) -> None:
        # A soft limit that the URDF does not give is none, not urdfdom's default of 0, which
        # would freeze the joint at 0.
        self._limited = limits.has_position
        self._lower = -_INF if soft.lower is None else soft.lower
        self._upper = _INF if soft.upper is None else soft.upper
        self._gain = soft.k_position
        self._velocity = limits.max_velocity

    def at(self, position: float) -> tuple[float, float]:
        velocity = self._velocity
        if not self._limited:
            return -velocity, velocity
        gain, lower, upper = self._gain, self._lower, self._upper
        return (
            -velocity if lower == -_INF else _saturate(-gain * (position - lower),
                                                       -velocity, velocity),
            velocity if upper == _INF else _saturate(-gain * (position - upper),
                                                     -velocity, velocity),
        )


class EffortSoft(_Rule):
    """Effort bounds proportional to the distance from the soft velocity bounds."""

    __slots__ = ("_bounds", "_gain", "_effort")

    def __init__(self, limits: JointBounds, handle: JointHandle) -> None:
        _need(limits, handle, "soft effort limit", "max_velocity", "max_effort")
        self._bounds = _SoftBounds(limits, handle.soft_limits)
        self._gain = handle.soft_limits.k_velocity
        self._effort = limits.max_effort

    def enforce(self, handle: JointHandle, dt: float) -> None:
        """Rewrite handle.effort_command."""
        slowest, fastest = self._bounds.at(handle.position)
        gain, effort, velocity = self._gain, self._effort, handle.velocity
        low = _saturate(-gain * (velocity - slowest), -effort, effort)
        high = _saturate(-gain * (velocity - fastest), -effort, effort)
        handle.effort_command = _saturate(handle.effort_command, low, high)


class PositionSaturation(_Rule):
    """Within [min, max], and no faster than max_velocity from the previous command."""

    __slots__ = ("_lower", "_upper", "_velocity", "_previous")

    def __init__(self, limits: JointBounds, handle: JointHandle) -> None:
        self._lower = limits.min_position if limits.has_position else -_INF
        self._upper = limits.max_position if limits.has_position else _INF
        self._velocity = limits.max_velocity
        self.reset()

    def reset(self) -> None:
        """Start from the measured position."""
        self._previous = nan

    def enforce(self, handle: JointHandle, dt: float) -> None:
        """Rewrite handle.position_command."""
        previous = handle.position if isnan(self._previous) else self._previous
        low, high = self._lower, self._upper
        if self._velocity is not None:
            step = self._velocity * dt
            low = max(previous - step, low)
            high = min(previous + step, high)
        handle.position_command = self._previous = _saturate(handle.position_command, low, high)


class PositionSoft(_Rule):
    """Within [min, max] and the soft velocity bounds around the previous command."""

    __slots__ = ("_lower", "_upper", "_bounds", "_previous")

    def __init__(self, limits: JointBounds, handle: JointHandle) -> None:
        _need(limits, handle, "soft position limit", "max_velocity")
        self._lower = limits.min_position if limits.has_position else -_INF
        self._upper = limits.max_position if limits.has_position else _INF
        self._bounds = _SoftBounds(limits, handle.soft_limits)
        self.reset()

    def reset(self) -> None:
        """Start from the measured position."""
        self._previous = nan

    def enforce(self, handle: JointHandle, dt: float) -> None:
        """Rewrite handle.position_command."""
        previous = handle.position if isnan(self._previous) else self._previous
        slowest, fastest = self._bounds.at(previous)
        low = max(previous + slowest * dt, self._lower)
        high = min(previous + fastest * dt, self._upper)
        handle.position_command = self._previous = _saturate(handle.position_command, low, high)


class VelocitySaturation(_Rule):
    """Within +-max_velocity, and no faster change than max_acceleration."""

    __slots__ = ("_velocity", "_acceleration", "_previous")

    def __init__(self, limits: JointBounds, handle: JointHandle) -> None:
        _need(limits, handle, "velocity saturation", "max_velocity")
        self._velocity = limits.max_velocity
        self._acceleration = limits.max_acceleration
        self.reset()

    def reset(self) -> None:
        """Start from rest."""
        self._previous = 0.0

    def enforce(self, handle: JointHandle, dt: float) -> None:
        """Rewrite handle.velocity_command."""
        high = self._velocity
        low = -high
        if self._acceleration is not None:
            step = self._acceleration * dt
            low = max(self._previous - step, low)
            high = min(self._previous + step, high)
        handle.velocity_command = self._previous = _saturate(handle.velocity_command, low, high)


class VelocitySoft(_Rule):
    """Within the soft bounds of the measured position, and max_acceleration if there is one."""

    __slots__ = ("_bounds", "_acceleration")

    def __init__(self, limits: JointBounds, handle: JointHandle) -> None:
        _need(limits, handle, "soft velocity limit", "max_velocity")
        self._bounds = _SoftBounds(limits, handle.soft_limits)
        self._acceleration = limits.max_acceleration

    def enforce(self, handle: JointHandle, dt: float) -> None:
        """Rewrite handle.velocity_command."""
        low, high = self._bounds.at(handle.position)
        if self._acceleration is not None:
            step = self._acceleration * dt
            low = max(handle.velocity - step, low)
            high = min(handle.velocity + step, high)
        handle.velocity_command = _saturate(handle.velocity_command, low, high)


LimitRule = (EffortSaturation | EffortSoft | PositionSaturation | PositionSoft
             | VelocitySaturation | VelocitySoft)


def rule_for(handle: JointHandle, limits: JointBounds | None) -> LimitRule | None:
    """The rule of the joint's interface and limits, or None where nothing limits it.

    A <safety_controller> in the URDF makes it the soft rule. Raises HardwareError where a limit
    that the rule needs is missing.
    """
    if limits is None:
        return None
    soft = handle.soft_limits is not None
    if handle.interface == EFFORT:
        return (EffortSoft if soft else EffortSaturation)(limits, handle)
    if handle.interface == POSITION:
        return (PositionSoft if soft else PositionSaturation)(limits, handle)
    return (VelocitySoft if soft else VelocitySaturation)(limits, handle)
