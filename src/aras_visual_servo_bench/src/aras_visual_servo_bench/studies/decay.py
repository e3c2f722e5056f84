"""How fast each feature decays, against what the gain and the loop's delay predict.

    python3 -m aras_visual_servo_bench.studies.decay [--friction]

The velocity -lambda s of an exposure holds from tau after it for one image period T. With
tau = n T + rho that gives, from image to image,

    s[k+1] = s[k] - lambda ((T - rho) s[k-n] + rho s[k-n-1])

whose slowest root z says the decay, -ln(z) / T in 1/s. tau is the experiment's delay, the mean wait
for the next joint state, and the rounding of the controllers' set point.
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np

from ..asked.experiment import Experiment
from ..recording.run import Run
from ..running.loop import run

IMAGE_PERIOD, TICK = 1.0 / 30.0, 0.01  # s
ROUNDING = 0.003  # s, of the bridge's interpolated set points
FROM, TO = 0.80, 0.15  # part of the first error between which the decay is fitted


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


def fitted(stamp: np.ndarray, error: np.ndarray) -> float:
    """Decay (1/s) of an error (n,) between 80 and 15 % of its first value; NaN where too short."""
    part = np.abs(error) / abs(error[0])
    begin = int(np.argmax(part < FROM))
    end = int(np.argmax(part < TO)) or len(part)
    if end - begin < 4:
        return float("nan")
    return float(-np.polyfit(stamp[begin:end], np.log(part[begin:end]), 1)[0])


def decays(gain: float, friction: bool = False, plant: str = "bullet") -> tuple[Run, float]:
    """The run with this gain, and the predicted decay, 1/s."""
    experiment = Experiment(
        plant=plant, friction=friction, gain=gain, linger=None, duration=3.0 / gain
    )
    tau = experiment.delay + 0.5 * TICK + (ROUNDING if plant == "bullet" else experiment.lag)
    return run(experiment), predicted(gain, tau)


def main(argv: list[str] | None = None) -> int:
    """Print a line for each gain and feature, and all as the last line, JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--friction", action="store_true", help="leave the joints' friction in")
    options = parser.parse_args(argv)
    lines = []
    for gain in (0.5, 1.0, 2.0):
        result, rate = decays(gain, options.friction)
        for i, name in enumerate(result.names):
            found = fitted(result.stamp, result.error[:, i])
            lines.append({
                "gain": gain, "feature": name, "fitted": round(found, 4),
                "predicted": round(rate, 4), "off_percent": round(100.0 * (found / rate - 1.0), 2),
            })  # fmt: skip
            print(" ".join(f"{key}={value}" for key, value in lines[-1].items()), flush=True)
    print(json.dumps(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
