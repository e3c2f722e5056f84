"""PID controller that behaves like control_toolbox's, so that users can keep their gains."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import isfinite, isnan
from typing import NamedTuple

import numpy as np

from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.compiled import column, jit
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.settings import read

log = logging.getLogger(__name__)

# Columns of the array that stores the state of a Pid.
(
    (
        _P,
        _I,
        _D,
        _I_MAX,  # upper limit of the integral term (i times the integral)
        _I_MIN,  # lower limit of the integral term
        _ANTIWINDUP,  # whether the limits apply to the integral, too
        _LAST_ERROR,  # error from which the next numerical derivative is computed
        _ERROR,  # error of the last computation
        _ERROR_DOT,  # derivative of the error in the last computation, per s
        _INTEGRAL,  # time integral of the error
        _COMMAND,  # command of the last computation
        _I_TERM,  # integral term of the last computation
        _IS_COMPUTED,  # whether the last computation gave a valid command
    ),
    PID_COLUMNS,
) = range(13), 13

# Names of a PID's parameters on the parameter server.
KEYS = ("p", "i", "d", "i_clamp", "i_clamp_min", "i_clamp_max", "antiwindup", "publish_state")


class PidGains(NamedTuple):
    """Gains of a PID; `i_max` and `i_min` limit the integral term, not the integral itself."""

    p: float
    i: float = 0.0
    d: float = 0.0
    i_max: float = 0.0
    i_min: float = 0.0
    antiwindup: bool = False


@dataclass(slots=True)
class PidState:
    """Inputs and results of one computation (control_msgs/PidState without its header)."""

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
    """PID controller u = p e + clamp(i ∫e) + d ė with these peculiarities of control_toolbox:

    - After reset() the last error is 0, so the first derivative is error/dt, which is a large
      value.
    - i_min and i_max are 0 by default; the integral term is then 0 for any i.
    - Without antiwindup only the integral term is limited; the integral grows without bound.
    - With a dt of 0, or an error that is not finite, the result is 0 and the integral is unchanged.
    - The output is not limited here; the hardware does this.

    The state is stored in `row`, a row of an array that compiled code updates. Another thread may
    replace `gains` during a computation; `apply_gains` copies them into the row before the next
    computation. `on_state`, if set, is called with a PidState after each computation.
    """

    # `integral` is the time integral of the error, not multiplied by the gain i.
    integral, command = column(_INTEGRAL), column(_COMMAND)

    def __init__(self, gains: PidGains) -> None:
        """Create a PID. Raises ControllerError for gains that `set_gains` rejects."""
        self.publish_state = False
        self.on_state: Callable[[PidState], None] | None = None
        self.row = np.zeros(PID_COLUMNS)
        self.set_gains(gains)
        self._active_gains: PidGains | None = None
        self.apply_gains()

    @classmethod
    def from_parameters(cls, parameters: Mapping, where: str) -> "Pid":
        """Read p (required), i, d, i_clamp, i_clamp_min, i_clamp_max, antiwindup, publish_state.

        An unknown parameter is logged with the most similar known name.

        Args:
            where: full name of the mapping, for messages.

        Raises:
            ControllerError: p is missing, or a value has a wrong type or is not finite.
        """
        for key in parameters:
            if key not in KEYS:
                log.warning("parameter %s/%s is not used; %s", where, key, suggest(key, KEYS))
        if "p" not in parameters:
            raise ControllerError(
                f"there is no proportional gain; set parameter {where}/p (and i, d, i_clamp as "
                "needed)"
            )
        given = partial(read, parameters, where=where, fault=ControllerError)
        clamp = abs(given("i_clamp", float, default=0.0))
        i_min = given("i_clamp_min", float, default=clamp)
        i_max = given("i_clamp_max", float, default=clamp)
        gains = PidGains(
            given("p", float),
            given("i", float, default=0.0),
            given("d", float, default=0.0),
            abs(i_max),
            -abs(i_min),
            given("antiwindup", bool, default=False),
        )
        pid = cls(gains)
        pid.publish_state = given("publish_state", bool, default=False)
        return pid

    def set_gains(self, gains: PidGains) -> None:
        """Set gains for the following computations; the integral is unchanged.

        Raises:
            ControllerError: a gain is not finite, or i_min > i_max.
        """
        for field, value in zip(PidGains._fields[:5], gains, strict=False):
            if not isfinite(value):
                raise ControllerError(f"PID gain {field} must be finite, got {value}")
        if gains.i_min > gains.i_max:
            raise ControllerError(
                f"PID: i_clamp_min {gains.i_min} exceeds i_clamp_max {gains.i_max}; lower it or "
                "raise i_clamp_max"
            )
        self.gains = PidGains(*map(float, gains[:5]), bool(gains.antiwindup))
        self.has_new_gains = True

    def apply_gains(self) -> None:
        """Copy new gains into the row; call this between two computations."""
        if self.has_new_gains:
            self.has_new_gains = False
            gains = self._active_gains = self.gains
            self.row[:_LAST_ERROR] = gains

    def bind(self, row: np.ndarray) -> None:
        """Copy the state to `row` (13,), and use `row` from now on."""
        row[:] = self.row
        self.row = row

    def reset(self) -> None:
        """Reset integral, last error and derivative."""
        self.row[_LAST_ERROR:] = 0.0

    def compute(self, error: float, dt: float, error_dot: float | None = None) -> float:
        """Compute the command for `error` = target - state, `dt` s after the last computation.

        `error_dot` is the derivative of the error, per s; if it is None, the error is
        differentiated numerically.
        """
        self.apply_gains()
        known = error_dot is not None
        command = compute_pid(self.row, error, error_dot if known else 0.0, known, dt)
        self.notify_listener(dt)
        return command

    def notify_listener(self, dt: float) -> None:
        """Pass the inputs and results of the last computation to `on_state` if they were valid.

        `dt` is the time, s, between the last two computations.
        """
        listener = self.on_state
        if listener is None or not self.row[_IS_COMPUTED]:
            return
        gains = self._active_gains
        error, error_dot, integral, command, i_term = self.row[_ERROR:_IS_COMPUTED].tolist()
        listener(
            PidState(dt, error, error_dot, error, integral, error_dot, gains.p * error, i_term,
                     gains.d * error_dot, gains.i_max, gains.i_min, command)
        )


@jit("f8[::1], f8, f8, b1, f8", allocates=False)
def compute_pid(row, error, error_dot, has_error_dot, dt):
    """Return the command of the PID whose state is `row`, and update the state; see Pid.compute.

    If `has_error_dot` is False, the argument `error_dot` is ignored, and the derivative is computed
    from the last error.
    """
    row[_IS_COMPUTED] = 0.0
    if not has_error_dot:
        if dt == 0.0 or not isfinite(error):
            return 0.0
        error_dot = row[_ERROR_DOT]
        if dt > 0.0:
            error_dot = (error - row[_LAST_ERROR]) / dt
            row[_LAST_ERROR] = error
    row[_ERROR], row[_ERROR_DOT] = error, error_dot
    if dt == 0.0 or isnan(dt) or not (isfinite(error) and isfinite(error_dot)):
        return 0.0
    i, least, most = row[_I], row[_I_MIN], row[_I_MAX]
    integral = row[_INTEGRAL] + dt * error
    if row[_ANTIWINDUP] != 0.0 and i != 0.0:
        low, high = least / i, most / i
        if low > high:
            low, high = high, low
        integral = low if integral < low else high if integral > high else integral
        i_term = i * integral
    else:
        i_term = i * integral
        if row[_ANTIWINDUP] == 0.0:
            i_term = least if i_term < least else most if i_term > most else i_term
    command = row[_P] * error + i_term + row[_D] * error_dot
    row[_INTEGRAL], row[_COMMAND], row[_I_TERM], row[_IS_COMPUTED] = integral, command, i_term, 1.0
    return command
