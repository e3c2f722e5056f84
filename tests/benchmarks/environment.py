#!/usr/bin/env python3
"""Measure the steps per second of processor time of the Gymnasium environment.

    python3 tests/benchmarks/environment.py [--steps 300] [--rounds 3] [--before CHECKOUT]

A step lasts from one image to the next: of a free camera that sees exactly, of one that sees
pictures, and of the Bullet arm. With --before a checkout of another commit, run by its own .venv,
takes turns with this one. Prints a table and, as its last line, JSON: steps a second of each kind
(the best round), and with --before theirs and the `ratio`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

from checkout import ROOT

STEPS = """
import json, sys, time
import numpy as np
try:
    from aras_visual_servo_bench.experiment.experiment import Experiment, RandomStart
    from aras_visual_servo_bench.runner.environment import ServoEnv
    images = "images"
except ImportError:  # their names in older checkouts
    from aras_visual_servo_bench.running.environment import ServoEnv
    from aras_visual_servo_bench.asked.experiment import Experiment, RandomStart
    images = "pictures"
kinds = {
    "free, exact": Experiment(plant="free", lag=0.0, delay=0.0, start=RandomStart()),
    "free, pictures": Experiment(plant="free", features=images, start=RandomStart()),
    "bullet": Experiment(plant="bullet"),
}
found = {}
for name, experiment in kinds.items():
    made, action = ServoEnv(experiment), np.array([0.02, 0.01, -0.01, 0.0, 0.0, 0.01])
    made.reset(seed=1)
    for _ in range(10):
        made.step(action)
    began = time.process_time()
    for number in range(int(sys.argv[1])):
        if any(made.step(action)[2:4]):
            made.reset(seed=number)
    found[name] = int(sys.argv[1]) / (time.process_time() - began)
    made.close()
print(json.dumps(found))
"""


def measured(checkout: Path, steps: int) -> dict[str, float]:
    path = os.pathsep.join(map(str, sorted((checkout / "src").glob("*/src"))))
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    told = subprocess.run(
        [str(checkout / ".venv/bin/python"), "-c", STEPS, str(steps)], check=True, text=True,
        stdout=subprocess.PIPE, env={**os.environ, **threads, "PYTHONPATH": path},
    ).stdout  # fmt: skip
    return json.loads(told.splitlines()[-1])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--before", type=Path, help="a checkout of another commit")
    options = parser.parse_args()
    checkouts = {"here": ROOT} | ({"before": options.before} if options.before else {})
    best: dict[str, dict[str, float]] = {which: {} for which in checkouts}
    for _ in range(options.rounds):
        for which, checkout in checkouts.items():
            for kind, rate in measured(checkout, options.steps).items():
                best[which][kind] = max(rate, best[which].get(kind, 0.0))
    result: dict[str, object] = {**best}
    for kind, rate in best["here"].items():
        line = f"{kind:16s}{rate:8.0f} steps a second"
        if options.before:
            line += f", before {best['before'][kind]:.0f}: {rate / best['before'][kind]:.2f} times"
        print(line)
    if options.before:
        result["ratio"] = {k: best["here"][k] / best["before"][k] for k in best["here"]}
    print(json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
