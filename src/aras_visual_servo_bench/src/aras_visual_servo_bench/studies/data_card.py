"""Data card of a data set: its content, its origin, and code to read it."""

from __future__ import annotations

from pathlib import Path

import jinja2
import pyarrow as pa
import yaml

from ..errors import catch_write_errors, find_command
from ..metrics.formatting import format_count
from ..setup.assembly import assemble
from . import image_table
from .study_folder import PARTS, TRACES, StudyFolder

CARD_FILE = "README.md"
TEMPLATE = Path(__file__).with_name("data_card.md.jinja")
_TYPE_NAMES = {pa.int64(): "whole number", pa.float64(): "number", pa.string(): "text",
               pa.binary(): "bytes", pa.list_(pa.float64()): "list of numbers"}  # fmt: skip


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
    template = jinja2.Template(
        TEMPLATE.read_text(encoding="utf-8"), trim_blocks=True, keep_trailing_newline=True
    )
    return template.render(
        name=folder.path.resolve().name, runs=format_count(table.num_rows, "run"),
        images=format_count(image_count, "image"), command=find_command(), study=study,
        outcomes=", ".join(f"{one['values']} {one['counts']}" for one in outcomes),
        parts=PARTS, traces=TRACES, columns=columns, type_names=_TYPE_NAMES,
        cameras=_describe_cameras(folder), picture=image_column,
        yaml=yaml.safe_dump(study.to_mapping(), sort_keys=False).rstrip(), labels=folder.labels,
    )  # fmt: skip


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
