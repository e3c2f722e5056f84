"""How fast a feature decays by what the gain and the loop's delay predict.

The velocity -lambda s of an exposure holds from tau after it for one image period T. With
tau = n T + rho that gives, from image to image,

    s[k+1] = s[k] - lambda ((T - rho) s[k-n] + rho s[k-n-1])

whose slowest root z says the decay, -ln(z) / T in 1/s. tau is the experiment's delay, the mean wait
for the next joint state, and the rounding of the controllers' set point.
"""

from __future__ import annotations

import numpy as np

from ..experiment.experiment import Experiment

IMAGE_PERIOD, TICK = 1.0 / 30.0, 0.01  # s
ROUNDING = 0.003  # s, of the bridge's interpolated set points


def compute_delay(experiment: Experiment) -> float:
    """tau, s, from an exposure until the joints move as it asks."""
    late = ROUNDING if experiment.plant == "bullet" else experiment.lag
    return experiment.delay + 0.5 * TICK + late


def predict_decay_rate(gain: float, tau: float, period: float = IMAGE_PERIOD) -> float:
    """Predict the rate (1/s) at which a feature s decays under the velocity -gain s.

    The equation is that of this module: the slowest root of the sampled and delayed loop. Without
    delay and for short periods the rate is the gain.

    Args:
        gain: of a proportional law, 1/s.
        tau: delay from an exposure until the joints move as it asks, s.
        period: time between two images, s.
    """
    whole, rest = divmod(tau, period)
    n = int(whole)
    polynomial = np.zeros(n + 3)  # z^(n+2) - z^(n+1) + gain ((T - rest) z + rest)
    polynomial[0], polynomial[1] = 1.0, -1.0
    polynomial[-2] += gain * (period - rest)
    polynomial[-1] += gain * rest
    slowest = max(np.roots(polynomial), key=abs)
    return float(-np.log(abs(slowest)) / period)
