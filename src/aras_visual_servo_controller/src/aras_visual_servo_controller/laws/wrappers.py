"""Construction of laws by name, and laws that wrap another law for a start without a step."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.settings import parameter

from .base import LAWS, Law


class ContinuousStart(Law):
    """Continuous start: the camera starts from rest, whatever the first error is (as in ViSP).

    The effect of the initial displacement L^+ e(0) is subtracted from the error. The subtracted
    part decays as exp(-mu t). The wrapped law gets e' = e - L (L^+ e(0)) exp(-mu t), with mu in
    1/s.

    Reference: N. Mansard and F. Chaumette, Task sequencing for high-level sensor-based control,
    IEEE T-RO 23(1), 2007.
    """

    law: Law = parameter(internal=True)
    mu: float = parameter(
        4.0, "1/s", above=0.0, help="decay rate of the part of the initial error that is subtracted"
    )

    def reset(self) -> None:
        """Clear the state that the law stores between images."""
        self.law.reset()
        # Start time (s) of the law, and L^+ e at that time.
        self._initial_motion: tuple[float, np.ndarray] | None = None

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """Compute the desired rate of the error, e_dot (k,)."""
        if self._initial_motion is None:
            self._initial_motion = t, np.array(pseudo_inverse_error)
        start, initial = self._initial_motion
        subtracted = np.exp(-self.mu * max(t - start, 0.0)) * initial
        return self.law.desired_error_rate(error - L @ subtracted, L, pseudo_inverse_error, t, dt)


class Ramp(Law):
    """Ramp: the desired rate of the wrapped law is multiplied by 1 - exp(-t / time), time in s."""

    law: Law = parameter(internal=True)
    time: float = parameter(0.1, "s", above=0.0, help="time constant")

    def reset(self) -> None:
        """Clear the state that the law stores between images."""
        self.law.reset()
        self._start_time: float | None = None

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """Compute the desired rate of the error, e_dot (k,)."""
        if self._start_time is None:
            self._start_time = t
        part = 1.0 - np.exp(-max(t - self._start_time, 0.0) / self.time)
        return part * self.law.desired_error_rate(error, L, pseudo_inverse_error, t, dt)


def create_law(
    name: str, /, continuous_start: float = 0.0, ramp: float = 0.0, **parameters: object
) -> Law:
    """Create a law from its short name or 'package.module:Class'.

    Args:
        name: name of the law, such as 'proportional' or 'pi'; LAWS contains all names.
        continuous_start: rate mu of a ContinuousStart that wraps the law, 1/s; 0 for none.
        ramp: time constant of a Ramp that wraps the law, s; 0 for none.
        parameters: parameters of the law.

    Raises:
        ConfigurationError: the law is unknown, or does not accept a parameter.
    """
    law = LAWS.create(name, **parameters)
    if ramp == continuous_start == 0.0:
        return law
    if ramp != 0.0:
        law = Ramp(law, ramp)
    return ContinuousStart(law, continuous_start) if continuous_start != 0.0 else law
