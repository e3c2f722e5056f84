"""Predicted decay rate of a feature from the gain and the delay of the loop.

The velocity -lambda s of an exposure is applied from tau after the exposure for one image period T.
With tau = n T + rho, the feature changes from image to image by

    s[k+1] = s[k] - lambda ((T - rho) s[k-n] + rho s[k-n-1])

The root z with the largest magnitude gives the decay rate -ln(z) / T in 1/s. tau is the sum of the
experiment's delay, the mean wait for the next joint state, and the smoothing of the controllers'
set point.
"""

from __future__ import annotations

import numpy as np

from ..experiment.experiment import Experiment

IMAGE_PERIOD, TICK = 1.0 / 30.0, 0.01  # s, between two images and between two joint states
ROUNDING = 0.003  # s, delay due to the bridge's interpolation of set points


def compute_delay(experiment: Experiment) -> float:
    """Compute tau, the delay from an exposure to the commanded joint motion, s."""
    late = ROUNDING if experiment.plant == "bullet" else experiment.lag
    return experiment.delay + 0.5 * TICK + late


def predict_decay_rate(gain: float, tau: float, period: float = IMAGE_PERIOD) -> float:
    """Predict the rate (1/s) at which a feature s decays under the velocity -gain s.

    The rate is that of the slowest root of the sampled, delayed loop; this module's docstring gives
    the equation. Without delay and for short periods the rate equals the gain.

    Args:
        gain: gain of a proportional law, 1/s.
        tau: delay from an exposure to the commanded joint motion, s.
        period: time between two images, s.
    """
    whole_periods, rho = divmod(tau, period)
    n = int(whole_periods)
    polynomial = np.zeros(n + 3)  # z^(n+2) - z^(n+1) + gain ((T - rho) z + rho)
    polynomial[0], polynomial[1] = 1.0, -1.0
    polynomial[-2] += gain * (period - rho)
    polynomial[-1] += gain * rho
    slowest = max(np.roots(polynomial), key=abs)
    return float(-np.log(abs(slowest)) / period)
