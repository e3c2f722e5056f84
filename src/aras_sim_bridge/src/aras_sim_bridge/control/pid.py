"""PID with control_toolbox's semantics, because users tuned their gains on them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import NamedTuple

from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read

_INF = float("inf")


class Gains(NamedTuple):
    """One consistent set of gains; `i_max` and `i_min` bound the integral *term*."""

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    i_max: float = 0.0
    i_min: float = 0.0
    antiwindup: bool = False


@dataclass(slots=True)
class PidState:
    """What one computation saw and gave (control_msgs/PidState without its header)."""

    time_step: float
    error: float
    error_dot: float
    p_error: float
    i_error: float
    d_error: float
    p_term: float
    i_term: float
    d_term: float
    i_max: float
    i_min: float
    output: float


class Pid:
    """u = p e + clamp(i ∫e) + d ė, with these peculiarities of the original:

    - the first derivative after reset() is error/dt, a kick, since the last error counts as 0;
    - i_min = i_max = 0 unless set, and then the integral term is 0 whatever i is;
    - without antiwindup the term is clamped while the integral grows on without bound;
    - dt of 0, or a NaN or infinite error, gives 0 and leaves the integral untouched;
    - the output is not clamped: that is the limit handle's work.

    `gains` is replaced as a whole, so another thread may set it while the loop computes.
    `on_state`, if set, is called with a PidState after each computation.
    """

    __slots__ = ("gains", "publish_state", "on_state", "_last_error", "_error", "_error_dot",
                 "_integral", "command")

    def __init__(
        self,
        p: float = 0.0,
        i: float = 0.0,
        d: float = 0.0,
        i_max: float = 0.0,
        i_min: float = 0.0,
        antiwindup: bool = False,
    ) -> None:
        self.publish_state = False
        self.on_state: Callable[[PidState], None] | None = None
        self.set_gains(Gains(p, i, d, i_max, i_min, antiwindup))
        self.reset()

    @classmethod
    def from_parameters(cls, parameters: Mapping, where: str) -> "Pid":
        """Read p (required), i, d, i_clamp, i_clamp_min, i_clamp_max, antiwindup, publish_state.

        `where` is the full name of the mapping, for the message. Raises ControllerError if p is
        missing or a value has the wrong type or is not finite.
        """
        if "p" not in parameters:
            raise ControllerError(
                f"no proportional gain: set parameter {where}/p (and i, d, i_clamp as needed)"
            )
        given = partial(read, parameters, where=where, fault=ControllerError)
        clamp = abs(given("i_clamp", float, default=0.0))
        i_min = given("i_clamp_min", float, default=clamp)
        i_max = given("i_clamp_max", float, default=clamp)
        pid = cls(
            given("p", float),
            given("i", float, default=0.0),
            given("d", float, default=0.0),
            abs(i_max),
            -abs(i_min),
            given("antiwindup", bool, default=False),
        )
        pid.publish_state = given("publish_state", bool, default=False)
        return pid

    def set_gains(self, gains: Gains) -> None:
        """Take new gains from the next computation on; the integral is kept.

        Raises ControllerError if one is not finite or i_min > i_max.
        """
        for field, value in zip(Gains._fields[:5], gains, strict=False):
            if not isfinite(value):
                raise ControllerError(f"PID gain {field} must be finite, got {value}")
        if gains.i_min > gains.i_max:
            raise ControllerError(
                f"PID integral clamp is empty: i_clamp_min {gains.i_min} > "
                f"i_clamp_max {gains.i_max}"
            )
        self.gains = Gains(*map(float, gains[:5]), bool(gains.antiwindup))

    def reset(self) -> None:
        """Forget integral, last error and derivative."""
        self._last_error = 0.0
        self._error = 0.0
        self._error_dot = 0.0
        self._integral = 0.0
        self.command = 0.0

    @property
    def memory(self) -> tuple[float, float]:
        """Last error and integral: what the next computation goes by."""
        return self._last_error, self._integral

    def remember(self, error: float, error_dot: float, integral: float, command: float) -> None:
        """Be as after a computation that saw and gave these."""
        self._last_error = self._error = error
        self._error_dot, self._integral, self.command = error_dot, integral, command

    @property
    def integral(self) -> float:
        """∫e dt in the error's unit times s, before the gain."""
        return self._integral

    def compute(self, error: float, dt: float, error_dot: float | None = None) -> float:
        """Command for `error` = target - state, `dt` s after the last one.

        `error_dot`, in the error's unit per s, is taken from the last error unless it is known.
        """
        # Comparisons are false for NaN, so one chain refuses NaN and infinities alike.
        if error_dot is None:
            if dt == 0.0 or not -_INF < error < _INF:
                return 0.0
            error_dot = self._error_dot
            if dt > 0.0:
                error_dot = (error - self._last_error) / dt
                self._last_error = error
        self._error = error
        self._error_dot = error_dot
        if dt == 0.0 or dt != dt or not (-_INF < error < _INF and -_INF < error_dot < _INF):
            return 0.0
        p, i, d, i_max, i_min, antiwindup = self.gains
        integral = self._integral + dt * error
        if antiwindup and i != 0.0:
            low, high = i_min / i, i_max / i
            if low > high:
                low, high = high, low
            integral = low if integral < low else high if integral > high else integral
            i_term = i * integral
        else:
            i_term = i * integral
            if not antiwindup:
                i_term = i_min if i_term < i_min else i_max if i_term > i_max else i_term
        self._integral = integral
        self.command = command = p * error + i_term + d * error_dot
        listener = self.on_state
        if listener is not None:
            self._report(listener, i_term, dt)
        return command

    def _report(self, listener: Callable[[PidState], None], i_term: float, dt: float) -> None:
        gains = self.gains
        error, error_dot = self._error, self._error_dot
        listener(
            PidState(dt, error, error_dot, error, self._integral, error_dot, gains.p * error,
                     i_term, gains.d * error_dot, gains.i_max, gains.i_min, self.command)
        )
