"""The report as one page that needs no other file."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2

from ..numbers.printing import NONE, amount, number
from ..numbers.summary import Quantity, best, shown
from ..pictures.palette import REPORT, css
from ..recording.run import Run
from ..study.overrides import unit_of

# On the tiles: key, factor, unit of what is printed, words.
TILES = (
    ("settled", 1.0, "s", "until it stays within 2 % of its way"),
    ("final_distance", 1e3, "mm", "camera off its goal"),
    ("final_angle", 180.0 / math.pi, "°", "camera turned from its goal"),
    ("path_ratio", 1.0, "", "camera's way over a straight line"),
    ("decay_rate", 1.0, "1/s", "decay of the error"),
    ("condition_L", 1.0, "", "greatest condition number of L"),
    ("image_rate", 1.0, "Hz", "images in simulated time"),
    ("real_time_factor", 1.0, "×", "real time"),
)


@dataclass(frozen=True)
class Shown:
    """A figure on the page: name of its files, title, words below, content of its SVG or PNG."""

    name: str
    title: str
    text: str
    content: bytes
    kind: str = "svg+xml"

    @property
    def data(self) -> str:
        """As an address that holds the picture itself."""
        return f"data:image/{self.kind};base64,{base64.b64encode(self.content).decode()}"


def page(
    title: str,
    runs: Sequence[Run],
    summaries: Sequence[Sequence[Quantity]],
    figures: Sequence[Sequence[Shown]],
    footer: str,
) -> str:
    """The HTML text.

    Args:
        summaries: of each run. figures: rows of one or two.
    """
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return made.get_template("page.html").render(
        title=title,
        colours=css(REPORT),
        runs=[_run(run, quantities) for run, quantities in
              zip(runs, summaries, strict=True)],
        tiles=_tiles(summaries[0]) if len(runs) == 1 else [],
        comparison=_comparison(runs, summaries) if len(runs) > 1 else [],
        figures=figures,
        footer=footer,
    )  # fmt: skip


def _run(run: Run, quantities: Sequence[Quantity]) -> Mapping[str, object]:
    settings = {key: amount(value, unit_of(key)) for key, value in run.settings.items()}
    told = ", ".join(f"{key} {value}" for key, value in list(settings.items())[:7])
    return {
        "name": run.name, "outcome": run.outcome, "verdict": run.verdict.word,
        "converged": run.held, "reached": run.verdict.reached, "reason": run.reason,
        "mend": run.mend, "notes": run.notes, "quantities": quantities,
        "settings": list(settings.items()), "versions": list(run.versions.items()),
        "experiment": run.yaml,
        "meta": " · ".join(filter(None, (run.source, told))),
    }  # fmt: skip


def _tiles(quantities: Sequence[Quantity]) -> list[Mapping[str, str]]:
    known = {q.key: q.value for q in quantities}
    found = []
    for key, factor, unit, text in TILES:
        value = known.get(key, float("nan"))
        if isinstance(value, float) and math.isfinite(value):
            found.append({"value": amount(number(factor * value), unit), "text": text})
    return found


def _comparison(
    runs: Sequence[Run], summaries: Sequence[Sequence[Quantity]]
) -> list[Mapping[str, object]]:
    """A row a quantity that at least two runs have, a column a run, the best marked."""
    keys = list(dict.fromkeys(q.key for qs in summaries for q in qs))
    rows = []
    for key in keys:
        row = [{q.key: q for q in qs}.get(key) for qs in summaries]
        first = next(q for q in row if q is not None)
        cells = shown(row)
        if sum(cell != NONE for cell in cells) < 2:
            continue
        top = best(runs, summaries, key)
        rows.append({
            "key": key, "unit": first.unit, "text": first.text,
            "cells": [{"value": cell, "best": i in top} for i, cell in enumerate(cells)],
        })  # fmt: skip
    return rows
