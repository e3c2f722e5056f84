"""Study folders with synthetic rows: any number of runs in seconds."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_folder import StudyFolder

REASONS = ("the error swings: it grew and shrank 4 times; delay 0.21 s", "the target is lost",
           "a joint stands at its limit: link2")  # fmt: skip


def made_study(path: Path, chunks: range | None = None, **keys: Any) -> StudyFolder:
    """Make a study whose runs succeed where gain * delay is small, and write `chunks` (or all)."""
    study = Study.from_mapping(keys)
    folder = StudyFolder.create(path, study, yaml.safe_dump(study.to_mapping()))
    for chunk in range(study.chunk_count) if chunks is None else chunks:
        write_chunk(folder, chunk)
    return folder


def write_chunk(folder: StudyFolder, chunk: int) -> None:
    done = rows.RunRows()
    for run in folder.study.list_chunk_runs(chunk):
        values = rows.make_blank_row(folder.study, run)
        rng = np.random.default_rng(run)
        gain, delay = float(values.get("gain", 2.0)), float(values.get("delay", 0.1))
        good = gain * delay * math.exp(0.3 * rng.normal()) < 0.5
        reason = "" if good else REASONS[int(rng.integers(3))]
        values |= {
            "outcome": "converged" if good else "oscillating", "reason": reason,
            "verdict": "goal_reached" if good else "goal_missed",
            "remedy": "" if good else "lower the gain, or the delay", "images": 60,
            "simulated": 4.0 * rng.random(), "success": float(good),
            "settled": 3.0 / gain * (1.0 + 0.1 * rng.random()) if good else float("nan"),
            "final_distance": 2e-4 * rng.random() if good else 0.1 * rng.random(),
        }  # fmt: skip
        done.values.append(values)
        done.times.append({"run": run, "wall": 0.05 + 0.01 * rng.random(), "processor": 0.05,
                           "worker": "here:1"})  # fmt: skip
    folder.write_chunk(chunk, done)
