"""Figures with the distribution of metrics: rates, cumulative distributions and boxes."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..metrics.formatting import choose_unit, format_heading
from ..metrics.metric import Metric
from ..metrics.metrics import final_distance
from ..metrics.statistics import Estimate, rate
from ..studies.results import Results
from .palette import BLUE, COLOURS, INK, PALE_BLUE, SOFT_INK, VERMILION
from .run_groups import MAX_CURVES, RunGroup, find_distance_tolerance, group_runs, label_groups
from .style import escape_math, is_paper, make_axes

# Largest number of letters of a group's name that is written on one line: MAX_NAME in a figure for
# the screen, MAX_LINE in a figure for a paper. Each line of a longer name has at most MAX_LINE
# letters.
MAX_NAME, MAX_LINE = 40, 24
# Largest number of letters of a name with which the legend of a figure for a paper has two columns.
MAX_PAPER_LEGEND = 18
# largest number of panels side by side, and width of a panel, inches
MAX_COLUMNS, PANEL_WIDTH = 3, 3.8
# Height of a row of a legend, inches: LEGEND_ROW in a figure for a paper, SCREEN_ROW in a figure
# for the screen. A figure for the screen becomes higher if its legend has more than MAX_SCREEN_ROWS
# rows.
LEGEND_ROW, SCREEN_ROW, MAX_SCREEN_ROWS = 0.15, 0.2, 4
# width of a letter of a legend, and of the coloured line of an entry, inches
LETTER, LEGEND_HANDLE = 0.075, 0.45
# Heights in figures for a paper, inches, which `make_axes` reduces to 66 %: row of a box or bar
# whose name has one line; each line of a name with several lines; horizontal axis with its labels.
PAPER_ROW, PAPER_LINE, PAPER_AXIS = 0.3, 0.2, 0.9


def draw_rates(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Draw the rates of binary metrics, with a bar for each group of runs."""
    if not metrics:
        return None
    groups = group_runs(all_results)
    columns = min(len(metrics), MAX_COLUMNS)
    names = [split_lines(name) for name, *_ in groups]
    figure, axes = make_axes(len(metrics), find_height(names), columns, width=PANEL_WIDTH)
    for number, (axis, metric) in enumerate(zip(axes, metrics, strict=True)):
        rates = [rate(results.read_values(metric)[rows]) for _, results, rows in groups]
        draw_bars(axis, rates, names if number % columns == 0 or is_paper() else [""] * len(names))
        axis.set_xlabel(_label_metric(metric, "%"))
    axes[0].set_ylabel(label_groups(all_results))
    return figure


def draw_distributions(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Draw the cumulative distribution of each metric, with a curve for each group of runs."""
    if not metrics:
        return None
    groups = group_runs(all_results, MAX_CURVES)
    figure, axes = make_axes(len(metrics), 3.0, min(len(metrics), MAX_COLUMNS), width=PANEL_WIDTH)
    for axis, metric in zip(axes, metrics, strict=True):
        draw_cumulative(axis, metric, groups)
    axes[0].set_ylabel("runs below (%)")
    return add_group_legend(figure, axes[0], label_groups(all_results, MAX_CURVES))


def draw_boxes(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Draw box plots of each metric, with a box for each group of runs."""
    groups = group_runs(all_results)
    if not metrics or len(groups) < 2:
        return None
    columns = min(len(metrics), MAX_COLUMNS)
    # A long name in one line would leave no width for the boxes, so each setting has its own line.
    names = [split_lines(name) for name, *_ in groups]
    figure, axes = make_axes(len(metrics), find_height(names), columns, width=PANEL_WIDTH)
    for number, (axis, metric) in enumerate(zip(axes, metrics, strict=True)):
        draw_metric_boxes(axis, metric, groups)
        first = number % columns == 0 or is_paper()
        axis.set_yticks(range(1, len(groups) + 1), names[::-1] if first else [])
    axes[0].set_ylabel(label_groups(all_results))
    return figure


def draw_bars(axis: Axes, rates: Sequence[Estimate], names: Sequence[str]) -> None:
    """Draw rates as horizontal bars with confidence intervals; the first bar is at the top."""
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


def draw_cumulative(axis: Axes, metric: Metric, groups: Sequence[RunGroup]) -> None:
    """Draw the cumulative distribution of a metric, with a curve for each group of runs."""
    label, size, scaled = _scale_values(metric, groups)
    for i, ((name, *_), values) in enumerate(zip(groups, scaled, strict=True)):
        known = np.sort(values[np.isfinite(values)])
        style = {"color": COLOURS[i % len(COLOURS)], "ls": "-" if i < len(COLOURS) else "--"}
        if not known.size:
            axis.plot([], [], label=f"{name} (no value)", **style)
            continue
        # Runs without a value, such as a settling time, are included, so the curve can end below
        # 100 %.
        fraction = np.arange(known.size + 1) / values.size
        axis.step(np.append(known[0], known), 100.0 * fraction, where="post", label=name, **style)
    set_scale(axis, "x", scaled)
    _mark_tolerance(axis, metric, groups, size)
    axis.set(xlabel=label, ylim=(0.0, 103.0))


def draw_metric_boxes(axis: Axes, metric: Metric, groups: Sequence[RunGroup]) -> None:
    """Draw a horizontal box plot of a metric for each group of runs; the first is at the top."""
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
    set_scale(axis, "x", scaled)
    _mark_tolerance(axis, metric, groups, size)
    axis.set_xlabel(label)
    axis.yaxis.grid(False)


def _scale_values(
    metric: Metric, groups: Sequence[RunGroup]
) -> tuple[str, float, list[np.ndarray]]:
    """Express the values of a metric in a unit that suits their magnitude.

    Returns:
        The metric's name with the chosen unit; the chosen unit, as a multiple of the metric's own
        unit; and the values of each group of runs in the chosen unit.
    """
    values = [results.read_values(metric)[rows] for _, results, rows in groups]
    unit, size = choose_unit(metric.unit, np.concatenate(values))
    return _label_metric(metric, unit), size, [v / size for v in values]


def _mark_tolerance(axis: Axes, metric: Metric, groups: Sequence[RunGroup], size: float) -> None:
    """Draw a dotted line at the tolerance of the distance, if the metric is the final distance.

    size: size of the axis's unit, m.
    """
    limit = find_distance_tolerance([results for _, results, _ in groups])
    if metric.name == final_distance.name and limit is not None:
        axis.axvline(limit / size, color=INK, ls=":", lw=1.2)


def _note_missing(axis: Axes, row: float) -> None:
    """Write the text 'no value' into a row of an axis, for a group of runs without values."""
    axis.text(0.02, row, "no value", transform=axis.get_yaxis_transform(), va="center",
              color=SOFT_INK, fontsize="small")  # fmt: skip


def set_scale(axis: Axes, side: str, values: Sequence[np.ndarray]) -> None:
    """Make an axis logarithmic if all values are positive and span more than two decades."""
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    if known.size and known.min() > 0.0 and known.max() > 100.0 * known.min():
        getattr(axis, f"set_{side}scale")("log")
    elif side == "x":
        axis.locator_params(axis="x", nbins=5)


def find_height(names: Sequence[str]) -> float:
    """Return the height of a panel with one row per name, inches."""
    lines = max(1 + name.count("\n") for name in names)
    if is_paper():
        return (PAPER_ROW if lines == 1 else PAPER_LINE * lines) * len(names) + PAPER_AXIS
    return max(0.3, 0.18 * lines) * len(names) + 1.4


def split_lines(name: str) -> str:
    """Write the long name of a group of runs on several lines; do not divide a list [...].

    In figures for the screen, each setting in the name has its own line. In figures for a paper,
    the name has as few lines as possible.
    """
    limit = MAX_LINE if is_paper() else MAX_NAME
    if len(name) <= limit:
        return name
    whole_lists = re.sub(r"\[[^\]]*\]", lambda found: found[0].replace(" ", "\0"), name)
    settings = [whole_lists] if is_paper() else whole_lists.replace(", ", ",\n").splitlines()
    lines = [textwrap.fill(setting, MAX_LINE, break_long_words=False) for setting in settings]
    return "\n".join(lines).replace("\0", " ")


def add_group_legend(figure: Figure, axis: Axes, title: str) -> Figure:
    """Add a legend below the axes if there are several curves."""
    handles, labels = axis.get_legend_handles_labels()
    if len(labels) < 2:
        return figure
    if is_paper():
        columns = 1 if max(map(len, labels)) > MAX_PAPER_LEGEND else 2
        # height of all rows of the legend and of its title, inches
        extra = LEGEND_ROW * (1 + -(-len(labels) // columns))
    else:
        labels = [split_lines(label) for label in labels]
        longest = max(len(line) for label in labels for line in label.splitlines())
        fitting = int(figure.get_figwidth() / (LETTER * longest + LEGEND_HANDLE))
        columns = min(len(labels), 3, max(fitting, 1))
        lines = max(1 + label.count("\n") for label in labels) * -(-len(labels) // columns)
        extra = SCREEN_ROW * max(lines - MAX_SCREEN_ROWS, 0)
    # the figure grows by the legend's height, so that the axes keep their height
    figure.set_figheight(figure.get_figheight() + extra)
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, title=title)
    return figure


def _label_metric(metric: Metric, unit: str) -> str:
    return escape_math(format_heading(metric.name.replace("_", " "), unit))
