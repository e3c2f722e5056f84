"""The page of schemes, made of what the protocols left: every scheme with its figures.

    python3 -m aras_visual_servo_bench.schemes_page --table DIR/table.csv --out docs/schemes.md

What a scheme is stands in its class's own words; nothing on the page is written by hand.
"""

from __future__ import annotations

import argparse
import collections
import csv
import inspect
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aras_visual_servo_controller.arm.poses import inverse
from aras_visual_servo_controller.features.base import Feature
from aras_visual_servo_controller.schemes.registry import SCHEMES

from .errors import ExperimentError
from .protocol import Protocol
from .runner import run
from .study.statistics import proportion

HEAD = """# Schemes

Made by `python3 -m aras_visual_servo_bench.schemes_page` from the tables that the protocols leave;
`rosrun aras_visual_servo_bench protocol canonical --out DIR` makes them anew.

"""
COLUMNS = ("case", "condition", "start")
GOAL = "goal_reached"
PANELS = 4  # in a row of the picture


def read(paths: Sequence[Path]) -> list[dict[str, str]]:
    """Rows of tables; ExperimentError: one that cannot be read."""
    rows: list[dict[str, str]] = []
    for path in paths:
        try:
            with path.open(newline="", encoding="utf-8") as file:
                rows += list(csv.DictReader(file))
        except OSError as error:
            raise ExperimentError(f"cannot read {path}: {error.strerror}") from None
    return rows


def cell(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """What the runs of one cell came to, in words for a table."""
    reached = [row for row in rows if row["verdict"] == GOAL]
    rate = proportion(len(reached), len(rows))
    outcomes = collections.Counter(row["outcome"] for row in rows if row["verdict"] != GOAL)
    return [
        f"{len(reached)} of {len(rows)}",
        f"{100 * rate.low:.0f}-{100 * rate.high:.0f} %",
        _middle(reached, "settled", "{:.2f}"),
        _middle(reached, "distance", "{:.3f}", 1e3),
        _middle(reached, "path_ratio", "{:.2f}"),
        _middle(rows, "excursion", "{:.2f}"),
        ", ".join(f"{word} {count}" for word, count in outcomes.most_common(2)),
    ]


def _middle(
    rows: Sequence[Mapping[str, str]], key: str, form: str, factor: float = 1.0
) -> str:
    """Median of a column, empty where nothing is known."""
    values = [float(row[key]) for row in rows if row.get(key) not in ("", None, "inf")]
    return form.format(factor * float(np.median(values))) if values else ""


def table(rows: Sequence[Mapping[str, str]]) -> str:
    """Markdown: a line for each case, condition and start, in the order of the rows."""
    groups: dict[tuple[str, ...], list[Mapping[str, str]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in COLUMNS), []).append(row)
    heads = ("scheme", "condition", "task", "reached", "Wilson 95 %", "settled, s",
             "error, mm", "way / straight", "excursion", "what else it came to")  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for key, found in groups.items():
        lines.append("| " + " | ".join((*key, *cell(found))) + " |")
    return "\n".join(lines) + "\n"


def descriptions() -> str:
    """Every registered scheme and feature in its own words."""
    parts = []
    for name, cls in SCHEMES.items():
        text = inspect.getdoc(cls) or ""
        needs = ", ".join(sorted(need.value for need in getattr(cls, "needs", ())))
        kind = "feature" if issubclass(cls, Feature) else "scheme"
        parts.append(f"### `{name}`\n\n{text.split('Attributes:')[0].strip()}\n\n"
                     f"A {kind}" + (f"; needs {needs}.\n" if needs else ".\n"))  # fmt: skip
    return "\n".join(parts)


def picture(protocol: Protocol, start: str, path: Path) -> None:
    """How the target's corners went through the image, a panel for each case, from one start."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    from .shapes import shape_of

    chosen = [
        (row, experiment) for row, experiment, _ in protocol.runs()
        if row["start"] == start and row["seed"] == protocol.first_seed
        and row["condition"] == protocol.conditions[0].name
    ]  # fmt: skip
    rows = -(-len(chosen) // PANELS)
    figure, axes = pyplot.subplots(rows, PANELS, figsize=(3 * PANELS, 2.6 * rows), squeeze=False)
    for axis in axes.ravel():
        axis.set_axis_off()
    for axis, (row, experiment) in zip(axes.ravel(), chosen, strict=False):
        result = run(experiment)
        corners = shape_of(experiment.target.shape, experiment.target.size).vertices()
        ways = []
        for pose in result.pose:
            seen = inverse(pose)
            points = corners @ seen[:3, :3].T + seen[:3, 3]
            ways.append(np.where(points[:, 2:] > 0.0, points[:, :2] / points[:, 2:], np.nan))
        ways = np.array(ways)
        axis.set_axis_on()
        axis.plot(ways[:, :, 0], ways[:, :, 1], linewidth=1.0)
        axis.plot(ways[-1, :, 0], ways[-1, :, 1], "ko", markersize=3.0)
        axis.set_title(f"{row['case']}: {result.outcome}", fontsize=7)
        axis.set_xlim(-0.45, 0.45)
        axis.set_ylim(0.35, -0.35)
        axis.tick_params(labelsize=6)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def main(argv: list[str] | None = None) -> int:
    """Write the page; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--table", type=Path, action="append", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--picture", type=Path, help="PNG of the ways through the image")
    parser.add_argument("--protocol", default="canonical")
    parser.add_argument("--start", default="turn 90", help="task of the picture")
    options = parser.parse_args(argv)
    try:
        protocol = Protocol.load(options.protocol)
        page = HEAD + "## Figures\n\n" + f"Source: {protocol.source}.\n\nChosen:\n\n"
        page += "".join(f"- {text}\n" for text in protocol.chosen) + "\n"
        page += table(read(options.table)) + "\n"
        if options.picture is not None:
            picture(protocol, options.start, options.picture)
            page += f"Ways of the corners through the image, task {options.start}, first seed:\n\n"
            page += f"![ways through the image](images/{options.picture.name})\n\n"
        page += "## What each is\n\n" + descriptions()
        options.out.write_text(page, encoding="utf-8")
    except (ExperimentError, OSError) as error:
        print(f"schemes_page: {error}", file=sys.stderr)
        return 1
    print(f"wrote {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
