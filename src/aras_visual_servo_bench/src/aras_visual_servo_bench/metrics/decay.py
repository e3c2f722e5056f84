"""Decay rate of the errors of a run, and its prediction from the gain and the delay of the loop.

From an image with the feature s, the law computes the velocity -lambda s. This velocity takes
effect after a delay tau from the exposure, and lasts for one image period T. If tau = n T + rho
with an integer n and 0 <= rho < T, the feature at image k + 1 is

    s[k+1] = s[k] - lambda ((T - rho) s[k-n] + rho s[k-n-1])

Inserting s[k] = z^k gives the characteristic equation

    z^(n+2) - z^(n+1) + lambda ((T - rho) z + rho) = 0

Its root z with the largest magnitude determines the decay rate -ln|z| / T, in 1/s. The delay tau is
the sum of the experiment's delay, the mean wait for the next joint state, and the delay of the
joints: the smoothing of the set points (bullet) or the lag (other plants).
"""

from __future__ import annotations

import numpy as np

from ..experiment.experiment import Experiment

IMAGE_PERIOD = 1.0 / 30.0  # time between two images, s
TICK = 0.01  # time between two joint states, s
# The norm of the errors is fitted while it is between these fractions of its initial value.
DECAY_START, DECAY_END = 0.80, 0.15
# A feature whose initial error is at most this fraction of the largest initial error is ignored.
MIN_INITIAL_ERROR = 0.02
ROUNDING = 0.003  # delay that the smoothing of a simulated joint's set points adds, s


def compute_delay(experiment: Experiment) -> float:
    """Compute tau, the delay from an exposure to the commanded joint motion, s."""
    late = ROUNDING if experiment.plant == "bullet" else experiment.lag
    return experiment.delay + 0.5 * TICK + late


def predict_decay_rate(gain: float, tau: float, period: float = IMAGE_PERIOD) -> float:
    """Predict the rate (1/s) at which a feature s decays under the velocity -gain s.

    The docstring of this module gives the equation. Without delay and with a short image period,
    the rate equals the gain.

    Args:
        gain: gain of a proportional law, 1/s.
        tau: delay from an exposure to the commanded joint motion, s.
        period: time between two images, s.
    """
    whole_periods, rho = divmod(tau, period)
    n = int(whole_periods)
    # coefficients of the characteristic equation z^(n+2) - z^(n+1) + gain ((period - rho) z + rho)
    polynomial = np.zeros(n + 3)
    polynomial[0], polynomial[1] = 1.0, -1.0
    polynomial[-2] += gain * (period - rho)
    polynomial[-1] += gain * rho
    slowest = max(np.roots(polynomial), key=abs)
    return float(-np.log(abs(slowest)) / period)


def fit_decay_rate(stamp: np.ndarray, error: np.ndarray) -> float:
    """Fit the decay rate (1/s) of the norm of the errors; return NaN if there are too few values.

    Each error is divided by its initial value.

    Args:
        stamp: (n,) stamps of the images, s.
        error: (n, k) errors in these images.
    """
    if not len(stamp):
        return np.nan
    first = np.abs(error[0])
    error = error[:, first > MIN_INITIAL_ERROR * first.max()]
    if not error.size:
        return np.nan
    norm = np.linalg.norm(error / np.abs(error[0]), axis=1)
    norm = norm / norm[0]
    start, end = int(np.argmax(norm < DECAY_START)), int(np.argmax(norm < DECAY_END)) or len(norm)
    if end - start < 4:
        return np.nan
    return float(-np.polyfit(stamp[start:end], np.log(norm[start:end]), 1)[0])
