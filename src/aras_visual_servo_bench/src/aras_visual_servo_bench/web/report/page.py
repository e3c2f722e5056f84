"""The page of a report, a single HTML file that needs no other files."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import jinja2

from ...experiment.experiment_keys import find_unit
from ...metrics.formatting import NO_NUMBER, format_heading, format_number, format_quantity
from ...metrics.summary import Quantity, find_best_runs, show_quantities
from ...plots.palette import LIVE_CURVES, REPORT, REPORT_DARK, SCENE, make_css
from ...plots.panel import Panel
from ...recording.run import Run
from .. import SHARED
from ..uplot import SCRIPT, STYLE, read_uplot
from .headline import find_transient, list_remarks, make_headline, make_title
from .missing_data import explain_missing_data
from .report_data import make_contents

# Numbers at the top of the page of a single run: the metric, the factor that converts it to the
# unit on the page, this unit, and a description.
TILES = (
    ("settled", 1.0, "s", "settling time (to 2 % of the initial distance)"),
    ("final_distance", 1e3, "mm", "final position error"),
    ("final_angle", 180.0 / math.pi, "°", "final orientation error"),
    ("path_ratio", 1.0, "", "path length / length of the straight path"),
    ("decay_rate", 1.0, "1/s", "decay rate of the error"),
    ("condition_L", 1.0, "", "largest condition number of L"),
    ("image_rate", 1.0, "Hz", "image rate (simulated time)"),
    ("real_time_factor", 1.0, "×", "real-time factor"),
)


MAX_ROWS = 250  # largest number of rows in a table; a browser needs seconds for thousands of rows
LONG_TEXT = 24  # number of characters above which the texts of a comparison are wrapped
PAGE_FOLDER = Path(__file__).parent / "page"
ENVIRONMENT = jinja2.Environment(
    loader=jinja2.FileSystemLoader(PAGE_FOLDER), autoescape=True, trim_blocks=True,
    lstrip_blocks=True,
)  # fmt: skip
SCRIPTS = (*(SHARED / f"{name}.js" for name in ("scene", "charts")),
           *(PAGE_FOLDER / f"{name}.js" for name in ("film", "report")))


def make_page(
    runs: Sequence[Run],
    summaries: Sequence[Sequence[Quantity]],
    groups: Sequence[tuple[str, str, str, Sequence[Panel]]],
    missing: Mapping[str, str],
    footer: str,
) -> str:
    """Return the HTML text of a report's page.

    Args:
        runs: runs of the report.
        summaries: metrics of each run.
        groups: key, title, description and panels of each group of plots.
        missing: title of each group that cannot be shown, and the data that it needs.
        footer: text at the bottom of the page.

    Raises:
        BenchError: the plotting library uPlot is not installed.
    """
    groups = [group for group in groups if group[-1]]
    contents = make_contents(runs, groups)
    transient = find_transient(summaries, contents["end"])
    several = len(runs) > 1
    tracks = [run["film"]["tracks"] for run in contents["runs"] if run["film"]]
    return ENVIRONMENT.get_template("index.html").render(
        title=make_title(runs),
        uplot_style=read_uplot(STYLE), uplot_script=read_uplot(SCRIPT),
        colours=make_css(REPORT) + make_css(REPORT_DARK, "[data-theme=dark]"),
        style=(SHARED / "style.css").read_text(encoding="utf-8"),
        theme_script=(SHARED / "theme.js").read_text(encoding="utf-8"),
        scripts="\n".join(path.read_text(encoding="utf-8") for path in SCRIPTS),
        contents=to_script_json({**contents, "transient": transient, "colours": LIVE_CURVES, **{
            name: SCENE[name] for name in ("goal", "start", "ideal", "face")}}),
        film=_describe_tracks(tracks) if tracks else "", scene=contents["scene"],
        runs=[_render_run(run, quantities) for run, quantities in
              zip(runs, summaries, strict=True)],
        tiles=[] if several else render_tiles(summaries[0]),
        headline=make_headline(runs, summaries) if several else None,
        notes=list_remarks(runs, lambda run: run.notes),
        gaps=list_remarks(runs, explain_missing_data), missing=missing, transient=transient,
        comparison=_render_comparison(runs, summaries) if several else [],
        groups=[{"key": key, "title": title, "text": text, "count": len(found)}
                for key, title, text, found in groups],
        footer=footer,
    )  # fmt: skip


def to_script_json(values: object) -> str:
    """Return values as JSON for a script element of HTML.

    The characters < > & are escaped, so that no text in the values can end the element.
    """
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _describe_tracks(tracks: Sequence[Mapping[str, object] | None]) -> str:
    """Return a text that says which points' trajectories the film shows.

    tracks: trajectories of each run; None for a run without trajectories.
    """
    if not any(tracks):
        return "no known points"
    return "the features" if any(t and t["is_measured"] for t in tracks) else "the target's corners"


def _render_run(run: Run, quantities: Sequence[Quantity]) -> Mapping[str, object]:
    settings = {key: format_quantity(value, find_unit(key)) for key, value in run.settings.items()}
    main_settings = ", ".join(f"{key} {value}" for key, value in list(settings.items())[:7])
    meta = " · ".join(filter(None, (run.name, run.source, main_settings)))
    return {"run": run, "quantities": quantities[:MAX_ROWS], "more": len(quantities[MAX_ROWS:]),
            "settings": settings, "meta": meta}  # fmt: skip


def render_tiles(quantities: Sequence[Quantity]) -> list[Mapping[str, str]]:
    """Return the value and description of each number at the top of a run's page, if it is known.
    """
    values = {q.key: q.value for q in quantities}
    found = []
    for key, factor, unit, text in TILES:
        value = values.get(key, float("nan"))
        if isinstance(value, float) and math.isfinite(value):
            found.append(
                {"value": format_quantity(format_number(factor * value), unit), "text": text}
            )
    return found


def _render_comparison(
    runs: Sequence[Run], summaries: Sequence[Sequence[Quantity]]
) -> list[Mapping[str, object]]:
    """Return the rows of the table that compares the runs; the best values are marked.

    There is a row for each metric that is known for at least two runs.
    """
    keys = list(dict.fromkeys(q.key for qs in summaries for q in qs[:MAX_ROWS]))
    rows = []
    for key in keys:
        row = [{q.key: q for q in qs}.get(key) for qs in summaries]
        first = next(q for q in row if q is not None)
        cells, unit = show_quantities(row)
        if sum(cell != NO_NUMBER for cell in cells) < 2:
            continue
        top = find_best_runs(runs, summaries, key)
        rows.append({
            "heading": format_heading(key, unit), "text": first.text,
            "is_long": max(map(len, cells)) > LONG_TEXT,
            "cells": [{"value": cell, "best": i in top} for i, cell in enumerate(cells)],
        })  # fmt: skip
    return rows
