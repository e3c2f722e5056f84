"""Servos from many seeded starts, and holds the loop's outcomes against the physics' verdicts.

    python3 -m aras_visual_servo_bench.studies.starts [--count 100] [--plant bullet]
"""

from __future__ import annotations

import argparse
import collections
import json
import sys

from ..asked.experiment import Experiment, Sampler
from ..errors import ExperimentError
from ..recording.run import Run
from ..running.loop import run

# The goal of 2015 hangs from a stretched arm: the camera cannot be nearer to the target than there.
SAMPLER = Sampler(height=(0.15, 0.5), side=0.1)


def contradicts(result: Run) -> bool:
    """Whether the loop holds for reached what the physics knows is not, or the other way round;
    a loop that says up to what it has converged leaves open whether it is there."""
    up_to = result.outcome.startswith("converged up to ")
    return not up_to and result.converged != result.verdict.reached


def row(seed: int, result: Run) -> dict[str, object]:
    """A run in a line of plain values."""
    return {
        "seed": seed,
        "outcome": result.outcome,
        "verdict": result.verdict.word,
        "distance_mm": round(1e3 * result.verdict.distance, 3),
        "angle_deg": round(57.29578 * result.verdict.angle, 3),
        "settled_s": round(result.settled(), 2),
        "contradicts": contradicts(result),
        "reason": result.reason,
    }


def study(experiment: Experiment, seeds: range) -> list[dict[str, object]]:
    """The experiment from each seed's start; what no start was found for is left out and said."""
    rows = []
    for seed in seeds:
        try:
            rows.append(row(seed, run(experiment.with_(seed=seed))))
        except ExperimentError as error:
            print(f"seed {seed}: {error}", file=sys.stderr)
    return rows


def main(argv: list[str] | None = None) -> int:
    """Run, print a line each, and the counts as the last line, JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--plant", default="bullet")
    parser.add_argument("--scheme", default="moments")
    parser.add_argument("--camera", default="original")
    options = parser.parse_args(argv)
    experiment = Experiment(
        plant=options.plant, scheme=options.scheme, camera=options.camera, start=SAMPLER,
        duration=15.0,
    )  # fmt: skip
    rows = []
    for seed in range(options.first, options.first + options.count):
        for line in study(experiment, range(seed, seed + 1)):
            rows.append(line)
            print(" ".join(f"{key}={value}" for key, value in line.items()), flush=True)
    counts = collections.Counter((line["outcome"], line["verdict"]) for line in rows)
    print(json.dumps({
        "runs": len(rows),
        "contradictions": sum(bool(line["contradicts"]) for line in rows),
        **{f"{outcome}, {verdict}": n for (outcome, verdict), n in sorted(counts.items())},
    }))  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
