"""Figures of study results: success, distributions, sensitivity and trajectories."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..errors import catch_write_errors, check_formats
from ..experiment.experiment_keys import find_unit
from ..metrics.formatting import format_heading, format_quantity, format_value
from ..metrics.metrics import Metric
from ..metrics.statistics import proportion
from ..studies import study_folder as folders
from ..studies.results import REAL_TIME_MULTIPLE, Results
from ..studies.study_folder import StudyFolder
from .palette import BLUE, COLOURS, INK, PALE_BLUE, SOFT_INK, VERMILION, choose_text_colour
from .style import FILE_FORMATS, apply_style, escape_math, make_axes

MAX_GROUPS = 24  # largest number of boxes in a panel; more boxes are not legible
MAX_NAME = 40  # largest number of letters for which the name of a group is written on one line
MAX_CURVES = 8  # largest number of curves in a panel
MAX_TRACES = 200  # approximate number of runs of a study in the figure of trajectories
MAX_COLUMNS, PANEL_WIDTH = 3, 3.8  # largest number of panels side by side; their width, inches


def write_figures(
    all_results: Sequence[Results], folder: Path, kinds: Sequence[str] = ("png",),
    metrics: Sequence[str] = (), paths: Sequence[Path] = (),
) -> list[Path]:  # fmt: skip
    """Draw and write all figures for which the results have data.

    Args:
        all_results: results of one or several studies.
        folder: folder for the files; it is created.
        kinds: file formats: png, svg, pdf.
        metrics: names of metrics; empty for all metrics that differ between runs.
        paths: folders of studies whose trajectories are drawn.

    Raises:
        StudyError: a file format is unknown, or the folder cannot be written.
    """
    check_formats(kinds, FILE_FORMATS)
    chosen = [
        m for m in all_results[0].select_metrics(metrics) if metrics or m != REAL_TIME_MULTIPLE
    ]
    chosen = [m for m in chosen if _varies(m, all_results) or metrics]
    drawings: dict[str, Callable[[], Figure | None]] = {
        "success": lambda: draw_success(all_results),
        "distributions": lambda: draw_distributions(all_results, chosen),
        "boxes": lambda: draw_boxes(all_results, chosen),
        "sensitivity": lambda: draw_sensitivity(all_results[0], chosen),
        "trajectories": lambda: draw_trajectories(paths),
    }
    written: list[Path] = []
    with catch_write_errors(f"into {folder}"), apply_style():
        folder.mkdir(parents=True, exist_ok=True)
        for name, draw in drawings.items():
            figure = draw()
            if figure is None:
                continue
            for kind in kinds:
                written.append(folder / f"{name}.{kind}")
                figure.savefig(written[-1])
            plt.close(figure)
    return written


def _varies(metric: Metric, all_results: Sequence[Results]) -> bool:
    """Return whether the values of a metric differ between runs."""
    values = np.concatenate([r.read_numbers(metric.name) for r in all_results])
    known = values[np.isfinite(values)]
    return known.size > 0 and bool(np.ptp(known) > 0.0)


def draw_success(all_results: Sequence[Results]) -> Figure | None:
    """Draw the success rate.

    The figure is a map if at least two settings have several values; its axes are the last two of
    them. Otherwise, it has a bar for each value of the setting, or for each study.
    """
    keys = [
        k for k in all_results[0].parameters if len(set(map(str, _find_values(all_results, k)))) > 1
    ]
    if len(keys) >= 2:
        return _draw_success_maps(all_results, *keys[-2:])
    return _draw_success_bars(all_results, keys)


def _find_values(all_results: Iterable[Results], key: str) -> list:
    """Return the distinct values of a column, in the order in which they first appear."""
    return list(dict.fromkeys(v for r in all_results for v in r.read_column(key)))


def _draw_success_bars(all_results: Sequence[Results], keys: Sequence[str]) -> Figure:
    names, rates = [], []
    for results in all_results:
        hits = results.compute_successes()
        for values, rows in results.group_rows(keys).items():
            name = ", ".join(map(_format_value, values))
            if len(all_results) > 1 or not name:
                name = f"{escape_math(results.name)} {name}".strip()
            names.append(name)
            rates.append(proportion(int(hits[rows].sum()), len(rows)))
    figure, (axis,) = make_axes(1, 0.42 * len(names) + 1.5, width=6.5)
    rows = np.arange(len(names))[::-1]
    value = np.array([100.0 * r.value for r in rates])
    spread = np.array([[100.0 * max(r.value - r.low, 0.0), 100.0 * max(r.high - r.value, 0.0)]
                       for r in rates]).T  # fmt: skip
    axis.barh(rows, value, color=BLUE, height=0.65)
    axis.errorbar(value, rows, xerr=spread, fmt="none", ecolor=INK, capsize=3, lw=1.1)
    axis.set_yticks(rows, names)
    axis.set(xlim=(0.0, 103.0), xlabel="runs with success (%), Wilson's 95 % interval",
             title=f"Success by {_label_setting(keys[0])}" if keys else "Success")
    axis.yaxis.grid(False)
    return figure


def _draw_success_maps(all_results: Sequence[Results], down: str, across: str) -> Figure:
    columns, lines = _find_values(all_results, across), _find_values(all_results, down)
    count = len(all_results)
    figure, axes = make_axes(
        count, max(0.55 * len(lines), 1.6) + 1.4, count,
        width=max(0.9 * len(columns), 3.0) + 2.2 / count, sharey=True,
    )  # fmt: skip
    for axis, results in zip(axes, all_results, strict=True):
        hits = results.compute_successes()
        cells = np.full((len(lines), len(columns)), np.nan)
        image = axis.imshow(cells, vmin=0.0, vmax=100.0, cmap="viridis", aspect="auto")
        for (line, column), rows in results.group_rows((down, across)).items():
            rate = proportion(int(hits[rows].sum()), len(rows))
            i, j = lines.index(line), columns.index(column)
            cells[i, j] = 100.0 * rate.value
            axis.text(j, i, f"{int(hits[rows].sum())}/{len(rows)}", ha="center", va="center",
                      color=choose_text_colour(image.cmap(rate.value)), fontsize=9)
        image.set_data(cells)
        axis.grid(False)
        axis.set_xticks(range(len(columns)), map(_format_value, columns))
        axis.set_yticks(range(len(lines)), map(_format_value, lines))
        axis.set(
            xlabel=_label_setting(across),
            title=escape_math(results.name) if count > 1 else "Success",
        )
    axes[0].set_ylabel(_label_setting(down))
    figure.colorbar(image, ax=axes, label="runs with success (%)", shrink=0.9)
    return figure


def _group_rows(
    all_results: Sequence[Results], max_groups: int = MAX_GROUPS
) -> list[tuple[str, Results, np.ndarray]]:
    """Group the runs of each study by the settings with several values.

    If there would be more than `max_groups` groups, the last settings are not used.

    Returns:
        For each group its name, the results of its study, and the indices of its runs.
    """
    keys = [
        k for k in all_results[0].parameters if len(set(map(str, _find_values(all_results, k)))) > 1
    ]
    while keys and sum(len(r.group_rows(keys)) for r in all_results) > max_groups:
        keys = keys[:-1]
    found = []
    for results in all_results:
        for values, rows in results.group_rows(keys).items():
            name = ", ".join(
                f"{escape_math(k)} {format_quantity(_format_value(v), find_unit(k))}"
                for k, v in zip(keys, values, strict=True)
            )
            if len(all_results) > 1 or not name:
                name = f"{escape_math(results.name)} {name}".strip()
            found.append((name, results, rows))
    return found


def draw_distributions(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Draw the cumulative distribution of each metric, with a curve for each group of runs."""
    if not metrics:
        return None
    groups = _group_rows(all_results, MAX_CURVES)
    figure, axes = make_axes(len(metrics), 3.0, min(len(metrics), MAX_COLUMNS), width=PANEL_WIDTH)
    for axis, metric in zip(axes, metrics, strict=True):
        for i, (name, results, rows) in enumerate(groups):
            values = results.read_numbers(metric.name)[rows]
            known = np.sort(values[np.isfinite(values)])
            if not known.size:
                continue
            # If some runs have no value (they never settle), the curve ends below 100 %.
            fraction = np.arange(known.size + 1) / values.size
            style = {"color": COLOURS[i % len(COLOURS)], "ls": "-" if i < len(COLOURS) else "--"}
            axis.step(
                np.append(known[0], known), 100.0 * fraction, where="post", label=name, **style
            )
        _set_scale(axis, "x", [r.read_numbers(metric.name)[rows] for _, r, rows in groups])
        axis.set(xlabel=_make_label(metric), ylim=(0.0, 103.0))
    axes[0].set_ylabel("runs below (%)")
    return _add_legend(figure, axes[0], len(groups))


def draw_boxes(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Draw box plots of each metric, with a box for each group of runs."""
    groups = _group_rows(all_results)
    if not metrics or len(groups) < 2:
        return None
    columns = min(len(metrics), MAX_COLUMNS)
    # Long names would take the width of the boxes, so each setting of a name has its own line.
    names = [_split_lines(name) for name, *_ in groups]
    lines = max(1 + name.count("\n") for name in names)
    height = max(0.3, 0.18 * lines) * len(groups) + 1.4
    figure, axes = make_axes(len(metrics), height, columns, width=PANEL_WIDTH)
    for number, (axis, metric) in enumerate(zip(axes, metrics, strict=True)):
        values = [r.read_numbers(metric.name)[rows] for _, r, rows in groups]
        known = [v[np.isfinite(v)] for v in values]
        axis.boxplot(
            known[::-1], orientation="horizontal", widths=0.6, patch_artist=True,
            boxprops={"facecolor": PALE_BLUE, "edgecolor": BLUE},
            medianprops={"color": VERMILION, "lw": 1.6}, whiskerprops={"color": BLUE},
            capprops={"color": BLUE},
            flierprops={"marker": ".", "markersize": 4, "markeredgecolor": SOFT_INK},
        )  # fmt: skip
        _set_scale(axis, "x", values)
        axis.set_xlabel(_make_label(metric))
        first = number % columns == 0
        axis.set_yticks(range(1, len(groups) + 1), names[::-1] if first else [])
        axis.yaxis.grid(False)
    return figure


def _split_lines(name: str) -> str:
    """Put each setting in a long name of a group on its own line; a list [...] is not divided."""
    return re.sub(r", (?![^\[]*\])", ",\n", name) if len(name) > MAX_NAME else name


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
    axis.set_title("Correlation of metrics and settings")
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
    axes[1].set(xlabel="x (m)", ylabel="y (m)", title="The camera's paths")
    axes[2].set(xlabel="x (m)", ylabel="z (m)")
    for axis in axes[1:]:
        axis.set_aspect("equal", adjustable="datalim")
        axis.locator_params(nbins=5)
    if len(traced) > 1:
        axes[0].legend()
    return figure


def _add_legend(figure: Figure, axis: Axes, count: int) -> Figure:
    handles, labels = axis.get_legend_handles_labels()
    if count > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=min(count, 3))
    return figure


def _set_scale(axis: Axes, side: str, values: Sequence[np.ndarray]) -> None:
    """Make an axis logarithmic if all values are positive and span more than two decades."""
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    if known.size and known.min() > 0.0 and known.max() > 100.0 * known.min():
        getattr(axis, f"set_{side}scale")("log")
    elif side == "x":
        axis.locator_params(axis="x", nbins=5)


def _make_label(metric: Metric) -> str:
    return escape_math(format_heading(metric.name.replace("_", " "), metric.unit))


def _label_setting(key: str) -> str:
    """Return the label of a setting with its unit."""
    return escape_math(format_heading(key, find_unit(key)))


def _format_value(value: object) -> str:
    return escape_math(format_value(value))
