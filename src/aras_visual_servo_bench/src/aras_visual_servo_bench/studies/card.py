"""The card of a data set: what it holds, how it was made, and how it is read."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import yaml

from ..errors import catch_write_errors, find_program_name
from ..setup.assembly import assemble
from . import images
from .progress import format_count
from .study_folder import PARTS, TRACES, StudyFolder

CARD_FILE = "README.md"
_TYPE_NAMES = {pa.int64(): "whole number", pa.float64(): "number", pa.string(): "text",
          pa.binary(): "bytes", pa.list_(pa.float64()): "list of numbers"}  # fmt: skip
_PANDAS = """\
import cv2, numpy, pandas
runs = pandas.read_parquet("{parts}").set_index("run")
images = pandas.read_parquet("{traces}")
picture = cv2.imdecode(numpy.frombuffer(images.{picture}[0], numpy.uint8), cv2.IMREAD_UNCHANGED)
images["outcome"] = runs.outcome[images.run].to_numpy()"""
_PYTORCH = """\
import cv2, numpy, pandas, torch
images = pandas.read_parquet("{traces}", columns=["{picture}", "asked"])
grey = [cv2.imdecode(numpy.frombuffer(png, numpy.uint8), 0) for png in images.{picture}]
x, y = torch.from_numpy(numpy.stack(grey)), torch.from_numpy(numpy.stack(images.asked))
pairs = torch.utils.data.TensorDataset(x, y)"""


def write_card(folder: StudyFolder) -> Path:
    """Write the card into the folder of a study whose images are kept; its path."""
    path = folder.path / CARD_FILE
    with catch_write_errors(path):
        path.write_text(make_card(folder), encoding="utf-8")
    return path


def make_card(folder: StudyFolder) -> str:
    """The card's text, in Markdown."""
    study = folder.study
    table = folder.read_results()
    outcomes = sorted(table["outcome"].value_counts().to_pylist(),
                      key=lambda one: (-one["counts"], one["values"]))  # fmt: skip
    found = images.list_columns(study)
    pictured = next((name for name in found if name.startswith("picture")), "")
    seen = int(sum(table["images"].to_pylist()))
    lines = [
        f"# {folder.path.resolve().name}", "",
        f"{format_count(table.num_rows, 'run')}, {format_count(seen, 'image')} of visual "
        "servoing, simulated "
        f"by `{find_program_name()} dataset`. "
        + ("Each run ends with its first image: they are views from the study's starts."
           if study.pictures == "first" else "Every image that the loop answered is kept."), "",
        "Outcomes: " + ", ".join(f"{one['values']} {one['counts']}" for one in outcomes) + ".", "",
        "## Files", "",
        f"- `{PARTS}/*.parquet`: a row a run: what was set, seed, outcome, reason, metrics",
        f"- `{TRACES}/*.parquet`: a row an image, below",
        "- `study.yaml`: what was run; the same file and code give the same bytes",
        "- `manifest.json`: versions, and the SHA-256 of every part", "",
        "## Columns of an image", "", "| column | type | what it holds |", "|---|---|---|",
        *(f"| {name} | {_TYPE_NAMES[one.kind]} | {one.meaning} |" for name, one in found.items()),
        "",
        "## Cameras", "", *_describe_cameras(folder), "",
    ]  # fmt: skip
    if pictured:
        words = {"parts": PARTS, "traces": TRACES, "picture": pictured}
        lines += ["## Read it", "", "With pandas, in this folder:", "", "```python",
                  _PANDAS.format(**words), "```", "", "With PyTorch:", "", "```python",
                  _PYTORCH.format(**words), "```", ""]  # fmt: skip
    text = yaml.safe_dump(study.to_mapping(), sort_keys=False)
    lines += ["## How it was made", "", "```yaml", text.rstrip(), "```", "",
              f"Code {folder.labels['code']}; {folder.labels['versions']}.", ""]  # fmt: skip
    return "\n".join(lines)


def _describe_cameras(folder: StudyFolder) -> list[str]:
    """What of each camera a learner needs, as the first run has it."""
    parts = assemble(folder.study.make_experiment(0))
    try:
        lines = []
        for name, eye in parts.cameras.items():
            model = eye.true_camera
            numbers = ", ".join(f"{k:.6g}" for k in model.K)
            lens = ", ".join(f"{k:.6g}" for k in model.D) or "none"
            lines.append(f"- {name}: {model.width} x {model.height} pixels, {eye.rate:g} Hz, K row "
                         f"by row {numbers}, {model.model} with coefficients {lens}")  # fmt: skip
            if name in parts.placements:
                place = parts.placements[name]
                whose = "the first camera's frame"
                if place.is_fixed or place.target_T_control is not None:
                    whose = "the frame in which the first camera's target stands"
                pose = ", ".join(f"{k:.9g}" for k in place.pose.ravel())
                lines[-1] += f"; its pose in {whose} row by row {pose}"
        return lines
    finally:
        parts.plant.close()
