"""How fast a feature decays by what the gain and the loop's delay predict.

The velocity -lambda s of an exposure holds from tau after it for one image period T. With
tau = n T + rho that gives, from image to image,

    s[k+1] = s[k] - lambda ((T - rho) s[k-n] + rho s[k-n-1])

whose slowest root z says the decay, -ln(z) / T in 1/s. tau is the experiment's delay, the mean wait
for the next joint state, and the rounding of the controllers' set point.
"""

from __future__ import annotations

import numpy as np

from ..asked.experiment import Experiment

IMAGE_PERIOD, TICK = 1.0 / 30.0, 0.01  # s
ROUNDING = 0.003  # s, of the bridge's interpolated set points


def delay_of(experiment: Experiment) -> float:
    """tau, s, from an exposure until the joints move as it asks."""
    late = ROUNDING if experiment.plant == "bullet" else experiment.lag
    return experiment.delay + 0.5 * TICK + late


def predicted(gain: float, tau: float, period: float = IMAGE_PERIOD) -> float:
    """Decay (1/s) of a feature under -gain s, tau (s) late, with an image each period (s)."""
    whole, rest = divmod(tau, period)
    n = int(whole)
    polynomial = np.zeros(n + 3)  # z^(n+2) - z^(n+1) + gain ((T - rest) z + rest)
    polynomial[0], polynomial[1] = 1.0, -1.0
    polynomial[-2] += gain * (period - rest)
    polynomial[-1] += gain * rest
    slowest = max(np.roots(polynomial), key=abs)
    return float(-np.log(abs(slowest)) / period)
