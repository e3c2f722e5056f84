#!/usr/bin/env python3
"""Print how much memory runs of each plant leave behind that differ in target, camera and lens.

    tests/benchmarks/memory.py [--runs 200] [--plants free chain]

The last line is JSON: MB by plant. The status is 1 where a plant leaves more than 20 MB.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
from pathlib import Path

from checkout import ROOT

from aras_visual_servo_bench.experiment.experiment import PLANTS, Experiment
from aras_visual_servo_bench.runner.loop import run

MOST = 20.0  # MB over all runs of a plant
WARM = 24  # runs before: libraries are loaded, and caches have what fits into them
EXAMPLES = ROOT / "docs" / "examples"
ARM = {"urdf": str(EXAMPLES / "my_arm.urdf"), "config": str(EXAMPLES / "my_arm_controllers.yaml")}
TARGETS = (
    {"shape": "l_shape"}, {"shape": "poster"}, {"shape": "marker"}, {"shape": "box"},
)  # fmt: skip
COMBINATIONS = 12  # of four targets, pictures or not, and two lenses, as `experiment` draws them


def resident() -> float:
    gc.collect()
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024.0
    raise OSError("/proc/self/status has no VmRSS")


def experiment(plant: str, number: int) -> Experiment:
    """A short run with a target, a place, a camera and a lens that no other number has; it arrives
    where the plant moves at once."""
    side = 0.1 + 1e-5 * number
    target = TARGETS[number % len(TARGETS)]
    size = [side, side, 0.05] if target["shape"] == "box" else [side, side]
    lens = {"lens": "equidistant"} if number % 2 else {}
    camera = {"width": 320, "height": 240, "horizontal_fov": 1.2 + 1e-4 * number, **lens}
    return Experiment.from_mapping({
        "plant": plant,
        "features": "exact" if plant == "ideal" or number % 3 == 0 else "images",
        "scheme": "points",
        "duration": 0.15,
        "gain": 5.0,
        "controller_parameters": {"hold": 0.1},
        "camera": camera,
        "target": {**target, "size": size, "pose": [0.45 + 1e-5 * number, 0.05, 0.051, 0, 0, 0]},
        "goal": {"pose": [0.45, 0.05, 0.35, 3.14159, 0.0, 0.2]},
        "start": {"pose": [0.45, 0.051, 0.352, 3.14159, 0.0, 0.202]},
        **({"robot": ARM} if plant not in ("free", "ideal") else {}),
    })  # fmt: skip


def growth(plant: str, runs: int, warm: int) -> float:
    """Return by how much the memory grows in `runs` runs, MB, after `warm` other runs."""
    held = []
    for number in range(warm + runs):
        run(experiment(plant, number))
        if number == 0:
            gc.freeze()  # imported modules; to search them after each run takes 0.2 s
        held.append(resident())
    return max(held[-COMBINATIONS:]) - max(held[:warm][-COMBINATIONS:])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, help="of each plant (default 200)")
    parser.add_argument("--warm", type=int, default=WARM, help=f"runs before (default {WARM})")
    parser.add_argument("--plants", nargs="+", default=PLANTS, choices=PLANTS)
    given = parser.parse_args()
    grown = {}
    for plant in given.plants:
        grown[plant] = growth(plant, given.runs, given.warm)
        print(f"{plant:8} {grown[plant]:7.1f} MB after {given.runs} runs", flush=True)
    print(json.dumps(grown))
    return 0 if max(grown.values()) <= MOST else 1


if __name__ == "__main__":
    sys.exit(main())
