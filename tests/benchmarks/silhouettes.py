"""Final pose errors of the arm with solid targets, servoed by the moments of their silhouettes.

    python3 tests/benchmarks/silhouettes.py [--starts 12] [--only sphere]

Prints the table of docs/solid_targets.md: distance and angle from the goal, by the truth. The last
line is JSON, in m and rad.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import checkout  # noqa: F401
import numpy as np

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.targets.target_factory import make_target

LABEL = {"method": "label"}
NEAR = {"method": "nearest_colour", "near_colour": [180, 26, 26], "colour_distance": 40}
ROUND = "gravity_centre_normalised+area_normalised"
ASIDE = [0.03, -0.02, 0.89, np.pi, 0.0, 0.0]
ASKEW = [0.05, -0.04, 0.87, np.pi - 0.2, -0.15, 0.0]
TABLE = 0.5905  # m
CASES = [
    ("box", [0.08, 0.05, 0.06], "moments", LABEL, ASIDE, 0.0),
    ("box", [0.08, 0.05, 0.06], "moments", LABEL, ASKEW, 0.0),
    ("cylinder", [0.06, 0.06, 0.08], ROUND, LABEL, ASIDE, 0.0),
    ("sphere", [0.06, 0.06, 0.06], ROUND, LABEL, ASIDE, 0.0),
    ("red box", [0.08, 0.05, 0.06], "moments", NEAR, ASIDE, 0.0),
    ("red box", [0.08, 0.05, 0.06], "moments", {"threshold": 120}, ASIDE, 0.0),
    ("box", [0.08, 0.05, 0.06], "moments", LABEL, ASIDE, 2.0),
    ("red box", [0.08, 0.05, 0.06], "moments", NEAR, ASIDE, 2.0),
]


def red(size: tuple[float, ...], folder: str) -> str:
    path = Path(folder) / "red.obj"
    text = make_target("box", size).path.read_text()
    path.write_text("mtllib red.mtl\nusemtl red\n" + text)
    path.with_suffix(".mtl").write_text("newmtl red\nKd 0.7 0.1 0.1\n")
    return str(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=12, help="of each target (default 12)")
    parser.add_argument("--only", default="", help="targets whose name starts so")
    options = parser.parse_args()
    starts, found = options.starts, {}
    with TemporaryDirectory() as folder:
        for name, size, scheme, told, goal, noise in CASES:
            if not name.startswith(options.only):
                continue
            shape = red(tuple(size), folder) if name.startswith("red") else name
            target = {"shape": shape, "size": size,
                      "pose": [0.0, 0.0, TABLE + size[2] / 2.0, 0.0, 0.0, 0.3]}  # fmt: skip
            ends, words = [], []
            for seed in range(starts):
                result = run(Experiment(
                    target=target, scheme=scheme, controller_parameters={"segmentation": told},
                    gain=2.0,
                    duration=15.0, goal={"pose": goal}, seed=seed, noise=noise,
                    start={"height": [0.28, 0.4], "side": 0.05, "turn": 0.6, "margin": 4},
                ))  # fmt: skip
                ends.append((1e3 * result.verdict.distance, np.degrees(result.verdict.angle)))
                words.append(result.outcome)
            middle, worst = np.median(ends, axis=0), np.max(ends, axis=0)
            good = sum(word.startswith("converged") for word in words)
            askew = ", askew" if goal is ASKEW else ""
            noisy = f", noise {noise:g}" if noise else ""
            case = f"{name}, {told.get('method', 'fixed')}{askew}{noisy}"
            found[case] = {"converged": good, "worst": [worst[0] / 1e3, np.radians(worst[1])]}
            print(f"| {case} | {good} of {starts} "
                  f"| {middle[0]:.3f} mm, {middle[1]:.3f}° | {worst[0]:.3f} mm, {worst[1]:.3f}° |",
                  flush=True)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
