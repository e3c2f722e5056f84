"""Figures of study results: success, distributions, sensitivity and trajectories."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..errors import catch_write_errors, check_formats
from ..experiment.experiment_keys import find_unit
from ..metrics.formatting import choose_unit, format_heading, format_quantity, format_value
from ..metrics.metrics import Metric, final_distance
from ..metrics.statistics import Estimate, rate
from ..studies import captions
from ..studies import study_folder as folders
from ..studies.results import REAL_TIME_MULTIPLE, Results
from ..studies.study_folder import StudyFolder
from ..studies.tables import escape_tex
from .palette import BLUE, COLOURS, INK, PALE_BLUE, SOFT_INK, VERMILION, choose_text_colour
from .style import FILE_FORMATS, add_title, apply_style, escape_math, is_paper, make_axes

MAX_GROUPS = 24  # boxes per panel; more boxes are not legible
MAX_NAME, MAX_PAPER_NAME = 40, 18  # letters of a group on one line
MAX_CURVES = 8  # per panel
LEGEND_ROW = 0.15  # inches, of a paper's figure
MAX_MAPS = 12  # success maps in a figure
MAX_TRACES = 200  # runs per study in the figure of trajectories
MAX_COLUMNS, PANEL_WIDTH = 3, 3.8  # panels in a row, and their width, inches
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
        kinds: file formats, of png, svg and pdf.
        metrics: names of metrics; empty for all that vary.
        paths: study folders, for the trajectories.
        is_paper: draw in the width and the font of a paper's column, each metric in a file of its
            own.

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
            plt.close(figure)
            sentences[name] = _make_caption(name, all_results, own)
        if sentences and kinds:
            written.append(folder / (PAPER_FIGURES if is_paper else CAPTIONS))
            kind = "pdf" if "pdf" in kinds else kinds[0]
            form = _format_paper_figure if is_paper else _format_caption
            text = "\n".join(form(f"{name}.{kind}", lines) for name, lines in sentences.items())
            written[-1].write_text(text, encoding="utf-8")
    return written


def _make_caption(
    name: str, all_results: Sequence[Results], shown: Sequence[Metric]
) -> list[str]:
    """Return the sentences of the caption of a figure."""
    kind = name.partition("_")[0]
    has_distance = kind == "success" and _has_distance(all_results)
    names = ", ".join(m.name.replace("_", " ") for m in shown)
    lines = {
        "success": ["Runs with success"
                    + (", and the distribution of the final distance." if has_distance else "."),
                    "Bars and maps: rates; lines: Wilson's 95 % interval."],
        "rates": [f"Rates of {names}, with Wilson's 95 % interval."],
        "distributions": [f"Cumulative distribution of {names}. Runs without a value keep a curve "
                          "below 100 %."],
        "boxes": [f"Quartiles of {names}; whiskers: furthest value within 1.5 interquartile "
                  "ranges; dots: other values."],
        "sensitivity": ["Spearman's rank correlation of metrics and settings."],
        "trajectories": ["Errors relative to the first, and paths of the camera in two views."],
    }[kind]  # fmt: skip
    lines += captions.describe_success(all_results, shown)
    if has_distance or final_distance in shown:
        lines += ["Dotted line: tolerance of the distance."] if _find_limit(all_results) else []
    if kind in ("success", "rates", "distributions", "boxes"):
        pooled = _find_pooled_keys(kind, all_results)
        lines += [f"Runs with different {', '.join(pooled)} are pooled."] if pooled else []
    keys = _find_varied_keys(all_results)
    if has_distance and len(keys) > 1:
        pooled = [key for key in keys if key not in _find_curve_keys(all_results)]
        lines.append(f"The curves pool runs with different {', '.join(pooled)}.")
    if kind in ("rates", "distributions", "boxes"):
        keys = [k for k in _find_varied_keys(all_results)
                if k not in _find_pooled_keys(kind, all_results)]  # fmt: skip
        for m in shown:
            groups, ends = [], []
            for results in all_results:
                own_ends = results.describe_ends()
                for values, rows in results.group_rows(keys).items():
                    groups.append((captions.name_group(keys, values), results.read_values(m)[rows]))
                    ends += [own_ends[i] for i in rows]
            lines += captions.describe_missing(m, groups, ends)
    return [*lines, *captions.describe_repeats(all_results)]


def _format_caption(file: str, lines: Sequence[str]) -> str:
    return f"**{file}**: {' '.join(lines)}\n"


def _format_paper_figure(file: str, lines: Sequence[str]) -> str:
    """Return a figure environment for LaTeX's package graphicx."""
    return "\n".join([
        r"\begin{figure}", r"\centering", rf"\includegraphics{{{file}}}",
        rf"\caption{{{' '.join(map(escape_tex, lines))}}}", r"\end{figure}", "",
    ])  # fmt: skip


def _varies(metric: Metric, all_results: Sequence[Results]) -> bool:
    """Check that a metric is not the same in all runs."""
    values = np.concatenate([r.read_numbers(metric.name) for r in all_results])
    known = values[np.isfinite(values)]
    return known.size > 0 and bool(np.ptp(known) > 0.0)


def _find_values(all_results: Iterable[Results], key: str) -> list:
    """Return the distinct values of a column in order of appearance."""
    return list(dict.fromkeys(v for r in all_results for v in r.read_column(key)))


def _find_varied_keys(all_results: Sequence[Results]) -> list[str]:
    """Return the keys of the grid and the cases that have several values."""
    return [
        k for k in all_results[0].parameters if len(set(map(str, _find_values(all_results, k)))) > 1
    ]


def _has_distance(all_results: Sequence[Results]) -> bool:
    """Check that all studies have measured the final distance of a run."""
    name = final_distance.name
    return all(
        name in r.table.column_names and np.isfinite(r.read_numbers(name)).any()
        for r in all_results
    )  # fmt: skip


def _find_limit(all_results: Sequence[Results]) -> float | None:
    """Return the tolerance of the distance, m, if all runs have the same."""
    limits = {one.limit for r in all_results for one in r.tolerances}
    limit = limits.pop() if len(limits) == 1 else np.nan
    return float(limit) if np.isfinite(limit) else None


def draw_success(all_results: Sequence[Results]) -> Figure | None:
    """Draw the success rate, and the distribution of the final distance next to it.

    The rates are bars over one key or over the studies, or maps over the last two keys that have
    several values: one map for each combination of values of the other keys.
    """
    keys = _find_varied_keys(all_results)
    if len(keys) >= 2:
        return _draw_success_maps(all_results, keys)
    return _draw_success_bars(all_results, keys)


def _draw_success_bars(all_results: Sequence[Results], keys: Sequence[str]) -> Figure:
    groups = _list_groups(all_results, keys)
    hits = {results.name: results.compute_successes() for results in all_results}
    rates = [rate(hits[results.name][rows]) for _, results, rows in groups]
    has_distance = _has_distance(all_results)
    figure, axes = make_axes(
        1 + has_distance, 0.42 * len(groups) + 1.5, 1 + has_distance,
        width=4.4 if has_distance else 6.5,
    )  # fmt: skip
    names = [name for name, *_ in groups]
    _draw_bars(axes[0], rates, names)
    axes[0].set_xlabel("runs with success (%), Wilson's 95 % interval")
    add_title(axes[0], f"Success by {_label_setting(keys[0])}" if keys else "Success")
    if has_distance:
        _draw_metric_boxes(axes[1], final_distance, groups)
        axes[1].set_yticks(range(1, len(groups) + 1), names[::-1] if is_paper() else [])
        axes[1].set_ylim(0.5, len(groups) + 0.5)
        axes[0].set_ylim(-0.5, len(groups) - 0.5)
        _describe_tolerance(axes[1], all_results)
    return figure


def _draw_bars(axis: Axes, rates: Sequence[Estimate], names: Sequence[str]) -> None:
    """Draw rates as horizontal bars, the first at the top, with their intervals."""
    rows = np.arange(len(names))[::-1]
    value = np.array([100.0 * r.value for r in rates])
    spread = np.array([[100.0 * max(r.value - r.low, 0.0), 100.0 * max(r.high - r.value, 0.0)]
                       for r in rates]).T  # fmt: skip
    axis.barh(rows, value, color=BLUE, height=0.65)
    axis.errorbar(value, rows, xerr=spread, fmt="none", ecolor=INK, capsize=3, lw=1.1)
    axis.set_yticks(rows, names)
    axis.set_xlim(0.0, 103.0)
    axis.yaxis.grid(False)
    for row, one in zip(rows, rates, strict=True):
        if not one.count:
            _note_missing(axis, row)


def draw_rates(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Draw the rates of binary metrics, with a bar per group."""
    if not metrics:
        return None
    groups = _group_rows(all_results)
    columns = min(len(metrics), MAX_COLUMNS)
    names = [_split_lines(name) for name, *_ in groups]
    figure, axes = make_axes(len(metrics), _find_height(names), columns, width=PANEL_WIDTH)
    for number, (axis, metric) in enumerate(zip(axes, metrics, strict=True)):
        rates = [rate(results.read_values(metric)[rows]) for _, results, rows in groups]
        _draw_bars(axis, rates, names if number % columns == 0 or is_paper() else [""] * len(names))
        axis.set_xlabel(f"{_make_label(metric)} (%)")
    return figure


def _draw_success_maps(all_results: Sequence[Results], keys: Sequence[str]) -> Figure:
    *others, down, across = keys
    pooled = _find_pooled_keys("success", all_results)
    others = [key for key in others if key not in pooled]
    columns, lines = _find_values(all_results, across), _find_values(all_results, down)
    panels = _list_groups(all_results, others)
    has_distance = _has_distance(all_results)
    count = len(panels) + has_distance
    in_row = min(count, MAX_COLUMNS)
    figure, axes = make_axes(
        count, max(0.55 * len(lines), 1.6) + 1.4, in_row,
        width=max(0.9 * len(columns), 3.0) + 2.2 / in_row,
    )  # fmt: skip
    size = 7 if is_paper() else 9
    for number, (axis, (name, results, own)) in enumerate(zip(axes, panels, strict=False)):
        hits = results.compute_successes()
        cells = np.full((len(lines), len(columns)), np.nan)
        image = axis.imshow(cells, vmin=0.0, vmax=100.0, cmap="viridis", aspect="auto")
        selected = set(own.tolist())
        for (line, column), all_rows in results.group_rows((down, across)).items():
            rows = [row for row in all_rows.tolist() if row in selected]
            if not rows:
                continue
            one = rate(hits[rows])
            i, j = lines.index(line), columns.index(column)
            cells[i, j] = 100.0 * one.value
            axis.text(j, i, f"{int(hits[rows].sum())}/{len(rows)}", ha="center", va="center",
                      color=choose_text_colour(image.cmap(one.value)), fontsize=size)
        for i, j in np.argwhere(np.isnan(cells)):
            axis.text(j, i, "no runs", ha="center", va="center", color=SOFT_INK, fontsize=size)
        image.set_data(cells)
        axis.grid(False)
        is_first = number % in_row == 0 or is_paper()
        axis.set_xticks(range(len(columns)), map(_format_value, columns))
        axis.set_yticks(range(len(lines)), map(_format_value, lines) if is_first else [])
        axis.set_xlabel(_label_setting(across))
        axis.set_ylabel(_label_setting(down) if is_first else "")
        title = name if len(panels) > 1 else "Success"
        pool = f" (all {', '.join(pooled)})" if pooled else ""
        if len(panels) > 1 or pooled:
            axis.set_title(title + escape_math(pool))
        else:
            add_title(axis, title)
    figure.colorbar(image, ax=axes[: len(panels)], label="runs with success (%)", shrink=0.9)
    if has_distance:
        curves = _list_groups(all_results, _find_curve_keys(all_results))
        _draw_cumulative(axes[len(panels)], final_distance, curves)
        axes[len(panels)].set_ylabel("runs below (%)")
        _describe_tolerance(axes[len(panels)], all_results)
        if len(curves) > 1:
            axes[len(panels)].legend(fontsize="small")
    return figure


def _find_curve_keys(all_results: Sequence[Results]) -> Sequence[str]:
    """Return the keys of the curves of final distances next to success maps.

    They are those of the maps; of a single map, the key of its rows.
    """
    keys = _find_varied_keys(all_results)
    pooled = _find_pooled_keys("success", all_results)
    others = [key for key in keys[:-2] if key not in pooled] or keys[-2:-1]
    return _limit_groups(all_results, others, MAX_MAPS)


def _describe_tolerance(axis: Axes, all_results: Sequence[Results]) -> None:
    """Write the tolerance below an axis of final distances; a paper has it in the caption."""
    if not is_paper():
        text = textwrap.fill(captions.describe_tolerances(all_results), MAX_NAME)
        axis.set_xlabel(f"{axis.get_xlabel()}\n{escape_math(text)}")


def _mark_tolerance(
    axis: Axes, metric: Metric, groups: Sequence[tuple[str, Results, np.ndarray]], size: float
) -> None:
    """Draw a dotted line at the tolerance, if the metric is the final distance.

    size: of the unit of the axis, m.
    """
    limit = _find_limit([results for _, results, _ in groups])
    if metric.name == final_distance.name and limit is not None:
        axis.axvline(limit / size, color=INK, ls=":", lw=1.2)


def _list_groups(
    all_results: Sequence[Results], keys: Sequence[str], is_long: bool = False
) -> list[tuple[str, Results, np.ndarray]]:
    """Return name, results and rows of each group of runs.

    is_long: the name contains keys and units, not only values.
    """
    found = []
    for results in all_results:
        for values, rows in results.group_rows(keys).items():
            parts = zip(keys, map(_format_value, values), strict=True)
            name = ", ".join(
                f"{escape_math(k)} {format_quantity(v, find_unit(k))}" if is_long else v
                for k, v in parts
            )
            if len(all_results) > 1 or not name:
                name = f"{escape_math(results.name)} {name}".strip()
            found.append((name, results, rows))
    return found


def _group_rows(
    all_results: Sequence[Results], max_groups: int = MAX_GROUPS
) -> list[tuple[str, Results, np.ndarray]]:
    """Return name, results and rows of at most `max_groups` groups, by as many keys as possible."""
    keys = _limit_groups(all_results, _find_varied_keys(all_results), max_groups)
    return _list_groups(all_results, keys, is_long=True)


def _limit_groups(
    all_results: Sequence[Results], keys: Sequence[str], max_groups: int
) -> Sequence[str]:
    """Return the first keys that form at most `max_groups` groups."""
    while keys and sum(len(r.group_rows(keys)) for r in all_results) > max_groups:
        keys = keys[:-1]
    return keys


def _find_pooled_keys(kind: str, all_results: Sequence[Results]) -> list[str]:
    """Return the keys whose values are not shown separately in a kind of figure."""
    keys = _find_varied_keys(all_results)
    if kind == "success":
        keys, limit = keys[:-2], MAX_MAPS
    else:
        limit = MAX_CURVES if kind == "distributions" else MAX_GROUPS
    shown = _limit_groups(all_results, keys, limit)
    return [key for key in keys if key not in shown]


def draw_distributions(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Draw the cumulative distribution of each metric, with a curve per group."""
    if not metrics:
        return None
    groups = _group_rows(all_results, MAX_CURVES)
    figure, axes = make_axes(len(metrics), 3.0, min(len(metrics), MAX_COLUMNS), width=PANEL_WIDTH)
    for axis, metric in zip(axes, metrics, strict=True):
        _draw_cumulative(axis, metric, groups)
    axes[0].set_ylabel("runs below (%)")
    return _add_legend(figure, axes[0], len(groups))


def _draw_cumulative(
    axis: Axes, metric: Metric, groups: Sequence[tuple[str, Results, np.ndarray]]
) -> None:
    """Draw the cumulative distribution of a metric, with a curve per group."""
    label, size, scaled = _scale_values(metric, groups)
    for i, ((name, *_), values) in enumerate(zip(groups, scaled, strict=True)):
        known = np.sort(values[np.isfinite(values)])
        style = {"color": COLOURS[i % len(COLOURS)], "ls": "-" if i < len(COLOURS) else "--"}
        if not known.size:
            axis.plot([], [], label=f"{name} (no value)", **style)
            continue
        # Runs without a value, e.g. runs that never settle, keep the curve below 100 %.
        fraction = np.arange(known.size + 1) / values.size
        axis.step(np.append(known[0], known), 100.0 * fraction, where="post", label=name, **style)
    _set_scale(axis, "x", scaled)
    _mark_tolerance(axis, metric, groups, size)
    axis.set(xlabel=label, ylim=(0.0, 103.0))


def _scale_values(
    metric: Metric, groups: Sequence[tuple[str, Results, np.ndarray]]
) -> tuple[str, float, list[np.ndarray]]:
    """Return the label of a metric with a unit that suits it, its size, and the values in it."""
    values = [results.read_values(metric)[rows] for _, results, rows in groups]
    unit, size = choose_unit(metric.unit, np.concatenate(values))
    name = escape_math(format_heading(metric.name.replace("_", " "), unit))
    return name, size, [v / size for v in values]


def draw_boxes(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Draw box plots of each metric, with a box per group."""
    groups = _group_rows(all_results)
    if not metrics or len(groups) < 2:
        return None
    columns = min(len(metrics), MAX_COLUMNS)
    # Long names would leave no width for the boxes, so that each setting gets its own line.
    names = [_split_lines(name) for name, *_ in groups]
    figure, axes = make_axes(len(metrics), _find_height(names), columns, width=PANEL_WIDTH)
    for number, (axis, metric) in enumerate(zip(axes, metrics, strict=True)):
        _draw_metric_boxes(axis, metric, groups)
        first = number % columns == 0 or is_paper()
        axis.set_yticks(range(1, len(groups) + 1), names[::-1] if first else [])
    return figure


def _draw_metric_boxes(
    axis: Axes, metric: Metric, groups: Sequence[tuple[str, Results, np.ndarray]]
) -> None:
    """Draw a horizontal box per group, the first at the top."""
    label, size, scaled = _scale_values(metric, groups)
    known = [v[np.isfinite(v)] for v in scaled]
    axis.boxplot(
        known[::-1], orientation="horizontal", widths=0.6, patch_artist=True,
        boxprops={"facecolor": PALE_BLUE, "edgecolor": BLUE},
        medianprops={"color": VERMILION, "lw": 1.6}, whiskerprops={"color": BLUE},
        capprops={"color": BLUE},
        flierprops={"marker": ".", "markersize": 4, "markeredgecolor": SOFT_INK},
    )  # fmt: skip
    for row, values in enumerate(known[::-1], 1):
        if not values.size:
            _note_missing(axis, row)
    _set_scale(axis, "x", scaled)
    _mark_tolerance(axis, metric, groups, size)
    axis.set_xlabel(label)
    axis.yaxis.grid(False)


def _note_missing(axis: Axes, row: float) -> None:
    """Write into a row without data that there is none."""
    axis.text(0.02, row, "no value", transform=axis.get_yaxis_transform(), va="center",
              color=SOFT_INK, fontsize="small")  # fmt: skip


def _find_height(names: Sequence[str]) -> float:
    """Return the height of a panel with one row per name, inches."""
    lines = max(1 + name.count("\n") for name in names)
    return max(0.3, 0.18 * lines) * len(names) * (1.3 if is_paper() else 1.0) + 1.4


def _split_lines(name: str) -> str:
    """Put each setting of a long group name on its own line; lists in brackets stay whole."""
    is_long = len(name) > (MAX_PAPER_NAME if is_paper() else MAX_NAME)
    return re.sub(r", (?![^\[]*\])", ",\n", name) if is_long else name


def draw_sensitivity(results: Results, metrics: Sequence[Metric]) -> Figure | None:
    """Draw Spearman's rank correlation between each metric and each number that varies."""
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
    """Draw the errors of all runs, and the camera's paths in top view and side view."""
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
                continue  # the target was never visible
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


def _add_legend(figure: Figure, axis: Axes, count: int) -> Figure:
    handles, labels = axis.get_legend_handles_labels()
    if count > 1:
        is_narrow = is_paper() and max(map(len, labels)) > MAX_PAPER_NAME
        most = 1 if is_narrow else 2 if is_paper() else 3
        if is_paper():  # the axes keep their height
            rows = -(-count // most)
            figure.set_figheight(figure.get_figheight() + LEGEND_ROW * rows)
        figure.legend(handles, labels, loc="outside lower center", ncols=min(count, most))
    return figure


def _set_scale(axis: Axes, side: str, values: Sequence[np.ndarray]) -> None:
    """Use a logarithmic axis if the values span more than two decades."""
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
