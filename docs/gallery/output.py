"""Output of the gallery's examples: folder, report, picture, and one line per run.

With `--no-report` after the folder, an example writes no report. Settings after the folder, such as
`gain=4`, override those of the example.
"""

from __future__ import annotations

import sys
from pathlib import Path

import yaml

from aras_visual_servo_bench import Experiment, Run, run_with_images, save_figure, write_report

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def folder() -> Path:
    """Return the output folder: the first argument of the script, or out/gallery/NAME."""
    name = Path(sys.argv[0]).stem
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out") / "gallery" / name
    out.mkdir(parents=True, exist_ok=True)
    return out


def report_runs(experiments: dict[str, Experiment], figure: str) -> list[Run]:
    """Run named experiments; write their report, and one of its figures as picture.png."""
    out = folder()
    words = (word.partition("=") for word in sys.argv[2:] if "=" in word)
    changes = {key: yaml.safe_load(value) for key, _, value in words}
    runs = [run_with_images(experiment.with_changes(**changes), name)
            for name, experiment in experiments.items()]  # fmt: skip
    if "--no-report" not in sys.argv[2:]:
        print(write_report(runs, out, ())[0])
    save_figure(runs, figure, out / "picture.png")
    for run in runs:
        distance = f"{1e3 * run.verdict.distance:.2f} mm from its goal"
        print(f"{run.name}: {run.outcome}, {run.verdict.name}, {distance}")
        if run.reason:
            print(f"  {run.reason}\n  {run.remedy}".rstrip())
    return runs
