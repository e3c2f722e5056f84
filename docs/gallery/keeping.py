"""What the examples of the gallery share: where results go, a report with a picture, one line."""

from __future__ import annotations

import sys
from pathlib import Path

from aras_visual_servo_bench import Experiment, Run, run_with_images, save_figure, write_report

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def folder() -> Path:
    """Where the example that runs writes: the first word of its command, or out/gallery/NAME."""
    name = Path(sys.argv[0]).stem
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out") / "gallery" / name
    out.mkdir(parents=True, exist_ok=True)
    return out


def keep_runs(experiments: dict[str, Experiment], figure: str) -> list[Run]:
    """Carry experiments out, by name; leave their report, and one of its figures as picture.png."""
    out = folder()
    runs = [run_with_images(experiment, name) for name, experiment in experiments.items()]
    page = write_report(runs, out, ())[0]
    save_figure(runs, figure, out / "picture.png")
    for run in runs:
        off = f"{1e3 * run.verdict.distance:.2f} mm from its goal"
        print(f"{run.name}: {run.outcome}, {run.verdict.name}, {off}")
        if run.reason:
            print(f"  {run.reason}\n  {run.remedy}".rstrip())
    print(page)
    return runs
