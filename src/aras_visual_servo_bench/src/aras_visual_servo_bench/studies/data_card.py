"""Data card of a data set: its content, its origin, and code to read it."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import yaml

from ..errors import catch_write_errors, find_command
from ..metrics.formatting import format_count
from ..setup.assembly import assemble
from . import image_table
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
images = pandas.read_parquet("{traces}", columns=["{picture}", "desired_twist"])
grey = [cv2.imdecode(numpy.frombuffer(png, numpy.uint8), 0) for png in images.{picture}]
x, y = torch.from_numpy(numpy.stack(grey)), torch.from_numpy(numpy.stack(images.desired_twist))
pairs = torch.utils.data.TensorDataset(x, y)"""


def write_card(folder: StudyFolder) -> Path:
    """Write the data card into the folder of a study with images; return its path."""
    path = folder.path / CARD_FILE
    with catch_write_errors(path):
        path.write_text(make_card(folder), encoding="utf-8")
    return path


def make_card(folder: StudyFolder) -> str:
    """Return the text of the data card, in Markdown."""
    study = folder.study
    table = folder.read_results()
    outcomes = sorted(table["outcome"].value_counts().to_pylist(),
                      key=lambda one: (-one["counts"], one["values"]))  # fmt: skip
    columns = image_table.list_columns(study)
    image_column = next((name for name in columns if name.startswith("picture")), "")
    image_count = int(sum(table["images"].to_pylist()))
    lines = [
        f"# {folder.path.resolve().name}", "",
        f"{format_count(table.num_rows, 'run')}, {format_count(image_count, 'image')} of visual "
        "servoing, simulated "
        f"by `{find_command()} dataset`. "
        + ("Each run ends with its first image, so the images are views from the study's starts."
           if study.pictures == "first" else
           "The data set contains every image that the control loop processed."), "",
        "Outcomes: " + ", ".join(f"{one['values']} {one['counts']}" for one in outcomes) + ".", "",
        "## Files", "",
        f"- `{PARTS}/*.parquet`: one row per run: settings, seed, outcome, reason, metrics",
        f"- `{TRACES}/*.parquet`: one row per image, with the columns below",
        "- `study.yaml`: the study; the same file and code give bit-identical results",
        "- `manifest.json`: versions, and the SHA-256 of every part", "",
        "## Columns of an image", "", "| column | type | content |", "|---|---|---|",
        *(f"| {name} | {_TYPE_NAMES[one.kind]} | {one.meaning} |" for name, one in columns.items()),
        "",
        "## Cameras", "", *_describe_cameras(folder), "",
    ]  # fmt: skip
    if image_column:
        words = {"parts": PARTS, "traces": TRACES, "picture": image_column}
        lines += ["## Reading the data", "", "With pandas, in this folder:", "", "```python",
                  _PANDAS.format(**words), "```", "", "With PyTorch:", "", "```python",
                  _PYTORCH.format(**words), "```", ""]  # fmt: skip
    text = yaml.safe_dump(study.to_mapping(), sort_keys=False)
    lines += ["## Study", "", "```yaml", text.rstrip(), "```", "",
              f"Code {folder.labels['code']}; {folder.labels['versions']}.", ""]  # fmt: skip
    return "\n".join(lines)


def _describe_cameras(folder: StudyFolder) -> list[str]:
    """Return one line per camera with its rate, intrinsics and pose in the first run."""
    parts = assemble(folder.study.make_experiment(0))
    try:
        lines = []
        for name, camera in parts.cameras.items():
            model = camera.true_camera
            K = ", ".join(f"{k:.6g}" for k in model.K)
            D = ", ".join(f"{k:.6g}" for k in model.D) or "none"
            lines.append(f"- {name}: {model.width} x {model.height} pixels, {camera.rate:g} Hz, K "
                         f"row by row {K}, {model.model} with coefficients {D}")  # fmt: skip
            if name in parts.placements:
                placement = parts.placements[name]
                frame = "the first camera's frame"
                if placement.is_fixed or placement.target_T_control is not None:
                    frame = "the frame of the first camera's target (world or link)"
                pose = ", ".join(f"{k:.9g}" for k in placement.pose.ravel())
                lines[-1] += f"; its pose in {frame} row by row {pose}"
        return lines
    finally:
        parts.plant.close()
