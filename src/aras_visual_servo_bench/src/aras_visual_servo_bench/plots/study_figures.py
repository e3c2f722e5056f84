"""Figures of study results: success, distributions, sensitivity and trajectories."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import scipy
from matplotlib.figure import Figure

from ..errors import catch_write_errors, check_formats
from ..metrics.metric import Metric
from ..studies import study_folder as folders
from ..studies.latex import format_tex_figure
from ..studies.results import REAL_TIME_MULTIPLE, Results
from ..studies.study_folder import StudyFolder
from .distributions import draw_boxes, draw_distributions, draw_rates
from .figure_captions import format_caption, make_caption
from .palette import COLOURS, INK, choose_text_colour
from .style import FILE_FORMATS, add_title, apply_style, escape_math, make_axes
from .success_figures import draw_success

MAX_TRACES = 200  # approximate number of runs of a study whose trajectories are drawn
CAPTIONS, PAPER_FIGURES = "captions.md", "figures.tex"


def write_figures(
    all_results: Sequence[Results], folder: Path, kinds: Sequence[str] = ("png",),
    metrics: Sequence[str] = (), paths: Sequence[Path] = (), is_paper: bool = False,
) -> list[Path]:  # fmt: skip
    """Draw and write all figures for which the results have data, and their captions.

    The captions are in `captions.md`; for a paper they are in `figures.tex`, with the figures.

    Args:
        all_results: results of one or several studies.
        folder: folder for the files; it is created.
        kinds: file formats: png, svg, pdf.
        metrics: names of metrics; empty for all metrics that differ between runs.
        paths: folders of studies whose trajectories are drawn.
        is_paper: whether to draw for a column of a paper, each metric in a separate file.

    Raises:
        StudyError: a file format is unknown, or the folder cannot be written.
    """
    check_formats(kinds, FILE_FORMATS)
    chosen = [
        m for m in all_results[0].select_metrics(metrics) if metrics or m != REAL_TIME_MULTIPLE
    ]
    chosen = [m for m in chosen if _varies(m, all_results) or metrics]
    measured, binary = ([m for m in chosen if m.is_binary == wanted] for wanted in (False, True))
    drawings: dict[str, tuple[Callable[[], Figure | None], Sequence[Metric]]] = {
        "success": (lambda: draw_success(all_results), ()),
    }
    for name, draw, own in (("rates", draw_rates, binary),
                            ("distributions", draw_distributions, measured),
                            ("boxes", draw_boxes, measured)):  # fmt: skip
        panels = {f"_{m.name}": [m] for m in own} if is_paper else {"": own}
        for ending, shown in panels.items():
            drawings[name + ending] = (partial(draw, all_results, shown), shown)
    drawings["sensitivity"] = (lambda: draw_sensitivity(all_results[0], chosen), chosen)
    drawings["trajectories"] = (lambda: draw_trajectories(paths), ())
    written: list[Path] = []
    sentences: dict[str, list[str]] = {}
    with catch_write_errors(f"into {folder}"), apply_style(is_paper):
        folder.mkdir(parents=True, exist_ok=True)
        for name, (draw, own) in drawings.items():
            figure = draw()
            if figure is None:
                continue
            for kind in kinds:
                written.append(folder / f"{name}.{kind}")
                figure.savefig(written[-1])
            sentences[name] = make_caption(name, all_results, own)
        if sentences and kinds:
            written.append(folder / (PAPER_FIGURES if is_paper else CAPTIONS))
            kind = "pdf" if "pdf" in kinds else kinds[0]
            form = format_tex_figure if is_paper else format_caption
            text = "\n".join(form(f"{name}.{kind}", lines) for name, lines in sentences.items())
            written[-1].write_text(text, encoding="utf-8")
    return written


def _varies(metric: Metric, all_results: Sequence[Results]) -> bool:
    """Return whether the values of a metric differ between runs."""
    values = np.concatenate([r.read_numbers(metric.name) for r in all_results])
    known = values[np.isfinite(values)]
    return known.size > 0 and bool(np.ptp(known) > 0.0)


def draw_sensitivity(results: Results, metrics: Sequence[Metric]) -> Figure | None:
    """Draw Spearman's rank correlation between each metric and each numeric setting that varies."""
    keys = []
    for key in results.study.keys:
        values = results.read_column(key) if key in results.table.column_names else []
        if len(set(values)) > 2 and all(isinstance(v, int | float) for v in values):
            keys.append(key)
    names = [m for m in metrics if m != REAL_TIME_MULTIPLE]
    if not keys or not names or results.table.num_rows < 4:
        return None
    cells = np.full((len(names), len(keys)), np.nan)
    for i, metric in enumerate(names):
        measured = results.read_numbers(metric.name)
        for j, key in enumerate(keys):
            varied = results.read_numbers(key)
            known = np.isfinite(measured) & np.isfinite(varied)
            if known.sum() > 3 and np.ptp(measured[known]) and np.ptp(varied[known]):
                cells[i, j] = scipy.stats.spearmanr(varied[known], measured[known]).statistic
    figure, (axis,) = make_axes(1, 0.38 * len(names) + 1.6, width=1.1 * len(keys) + 3.6)
    image = axis.imshow(cells, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="auto")
    axis.grid(False)
    for (i, j), value in np.ndenumerate(cells):
        if np.isfinite(value):
            axis.text(j, i, f"{value:+.2f}", ha="center", va="center", fontsize=9,
                      color=choose_text_colour(image.cmap(0.5 + 0.5 * value)))
    axis.set_xticks(range(len(keys)), map(escape_math, keys), rotation=20 if len(keys) > 3 else 0)
    axis.set_yticks(range(len(names)), [m.name for m in names])
    add_title(axis, "Correlation of metrics and settings")
    figure.colorbar(image, ax=axis, label="rank correlation (Spearman)", shrink=0.9)
    return figure


def draw_trajectories(paths: Sequence[Path]) -> Figure | None:
    """Draw the error norms and the camera's paths (top view and side view) of recorded runs.

    Return None if no study has recorded trajectories.
    """
    traced = [folder for folder in map(StudyFolder.open, paths) if folder.study.traces]
    if not traced:
        return None
    figure, axes = make_axes(3, 3.8, 3, width=4.0)
    for colour, folder in zip(COLOURS, traced, strict=False):
        table = folder.read_results(folders.TRACES)
        run, stamp = np.array(table["run"]), np.array(table["stamp"])
        runs = np.unique(run)
        for n, run_number in enumerate(runs[:: max(len(runs) // MAX_TRACES, 1)]):
            rows = table.take(np.flatnonzero(run == run_number))
            error = np.array(rows["error"].to_pylist(), float)
            time = stamp[run == run_number] - stamp[run == run_number][0]
            norm = np.linalg.norm(error, axis=1)
            label = escape_math(folder.path.resolve().name) if n == 0 else None
            known = norm[np.isfinite(norm)]
            if not known.size:
                continue  # no image of this run has a measurement
            axes[0].semilogy(time, norm / known[0], color=colour, lw=0.7, alpha=0.5, label=label)
            places = np.array(rows["pose"].to_pylist(), float).reshape(-1, 4, 4)[:, :3, 3]
            for axis, (i, j) in ((axes[1], (0, 1)), (axes[2], (0, 2))):
                axis.plot(places[:, i], places[:, j], color=colour, lw=0.7, alpha=0.5)
                axis.plot(places[-1, i], places[-1, j], ".", color=INK, ms=4)
    axes[0].set(xlabel="time since the first image (s)", ylabel="error, relative to the first")
    axes[1].set(xlabel="x (m)", ylabel="y (m)")
    add_title(axes[1], "The camera's paths")
    axes[2].set(xlabel="x (m)", ylabel="z (m)")
    for axis in axes[1:]:
        axis.set_aspect("equal", adjustable="datalim")
        axis.locator_params(nbins=5)
    if len(traced) > 1:
        axes[0].legend()
    return figure
