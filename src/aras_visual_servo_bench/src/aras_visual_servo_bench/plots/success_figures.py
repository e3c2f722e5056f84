"""Figures of success rates, next to the distributions of the final distance."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from ..metrics.metrics import final_distance
from ..metrics.statistics import rate
from ..studies import captions
from ..studies.results import Results
from .distributions import (
    MAX_COLUMNS,
    MAX_NAME,
    add_group_legend,
    draw_bars,
    draw_cumulative,
    draw_metric_boxes,
    find_height,
    split_lines,
)
from .palette import SOFT_INK, choose_text_colour
from .run_groups import (
    find_map_limit,
    find_pooled_keys,
    find_values,
    find_varied_keys,
    format_setting,
    has_final_distance,
    label_setting,
    limit_groups,
    list_groups,
)
from .style import add_title, escape_math, is_paper, make_axes

# Sizes in figures for a paper, inches: width of all success maps in a row; width of a cell of a
# map, with a number such as 10/10; width of the space between maps; height of a cell; height of the
# horizontal axis with its labels. `make_axes` reduces the heights to 66 %.
PAPER_WIDTH, PAPER_CELL, PAPER_GAP, PAPER_LINE, PAPER_AXIS = 3.2, 0.3, 0.1, 0.3, 0.85
# Height of the panel of the final distance, relative to the height of a success map.
DISTANCE_RATIO = 1.4


def draw_success(all_results: Sequence[Results]) -> Figure | None:
    """Draw the success rate, and the distribution of the final distance next to it.

    If at most one setting has several values, the success rates are drawn as a bar for each value
    of this setting, or for each study. Otherwise, they are drawn as maps: the last two settings
    with several values are the axes of a map, and each combination of values of the other settings
    has its own map.
    """
    keys = find_varied_keys(all_results)
    if len(keys) >= 2:
        return _draw_success_maps(all_results, keys)
    return _draw_success_bars(all_results, keys)


def _draw_success_bars(all_results: Sequence[Results], keys: Sequence[str]) -> Figure:
    groups = list_groups(all_results, keys)
    rates = [rate(results.compute_successes()[rows]) for _, results, rows in groups]
    has_distance = has_final_distance(all_results)
    names = [split_lines(name) for name, *_ in groups]
    height, columns = 0.42 * len(groups) + 1.5, 1 + has_distance
    if is_paper():
        height, columns = find_height(names), 1
    figure, axes = make_axes(1 + has_distance, height, columns, width=4.4 if has_distance else 6.5)
    draw_bars(axes[0], rates, names)
    # in a figure for a paper, the caption describes the interval
    interval = "" if is_paper() else ", Wilson's 95 % interval"
    axes[0].set_xlabel(f"runs with success (%){interval}")
    add_title(axes[0], f"Success by {label_setting(keys[0])}" if keys else "Success")
    if has_distance:
        draw_metric_boxes(axes[1], final_distance, groups)
        axes[1].set_yticks(range(1, len(groups) + 1), names[::-1] if is_paper() else [])
        axes[1].set_ylim(0.5, len(groups) + 0.5)
        axes[0].set_ylim(-0.5, len(groups) - 0.5)
        _describe_tolerance(axes[1], all_results)
    for axis in axes if is_paper() and keys else ():
        axis.set_ylabel(label_setting(keys[0]))
    return figure


def _draw_success_maps(all_results: Sequence[Results], keys: Sequence[str]) -> Figure:
    *others, down, across = keys
    pooled = find_pooled_keys("success", all_results)
    panels = list_groups(all_results, [key for key in others if key not in pooled])
    columns, lines = find_values(all_results, across), find_values(all_results, down)
    figure, axes, distance_axis = _make_map_axes(all_results, len(panels), len(lines), len(columns))
    in_row = axes[0].get_gridspec().ncols
    for number, (axis, (name, results, rows)) in enumerate(zip(axes, panels, strict=True)):
        image = _draw_map(axis, results, rows, (down, lines), (across, columns))
        is_first = number % in_row == 0
        labels = [split_lines(format_setting(line)) for line in lines] if is_first else []
        axis.set_yticks(range(len(lines)), labels)
        axis.set_ylabel(label_setting(down) if is_first else "")
        pool = f" (all {', '.join(pooled)})" if pooled else ""
        if len(panels) > 1 or pooled:
            axis.set_title((name if len(panels) > 1 else "Success") + escape_math(pool))
        else:
            add_title(axis, "Success")
    # a figure for a paper needs no colour bar, because its cells contain the numbers
    if not is_paper():
        figure.colorbar(image, ax=axes, label="runs with success (%)", shrink=0.9)
    if distance_axis is not None:
        curve_keys = find_curve_keys(all_results)
        curves = list_groups(all_results, curve_keys)
        draw_cumulative(distance_axis, final_distance, curves)
        distance_axis.set_ylabel("runs below (%)")
        _describe_tolerance(distance_axis, all_results)
        if is_paper():
            add_group_legend(figure, distance_axis, ", ".join(map(label_setting, curve_keys)))
        elif len(curves) > 1:
            handles, labels = distance_axis.get_legend_handles_labels()
            title = split_lines(", ".join(map(label_setting, curve_keys)))
            distance_axis.legend(
                handles, map(split_lines, labels), title=title, fontsize="small",
                title_fontsize="small",
            )  # fmt: skip
    return figure


def _make_map_axes(
    all_results: Sequence[Results], count: int, lines: int, columns: int
) -> tuple[Figure, list[Axes], Axes | None]:
    """Make a figure with the axes of success maps and, if it is known, of the final distance.

    In a figure for a paper, each cell of a map must be wide enough for a number, which limits the
    number of maps in a row. The axes of the final distance are below the maps and have the width of
    the figure.

    Args:
        all_results: results of one or several studies.
        count: number of maps.
        lines: number of rows of a map.
        columns: number of columns of a map.
    """
    has_distance = has_final_distance(all_results)
    if not is_paper():
        total = count + has_distance
        in_row = min(total, MAX_COLUMNS)
        width = max(0.9 * columns, 3.0) + 2.2 / in_row
        figure, axes = make_axes(total, max(0.55 * lines, 1.6) + 1.4, in_row, width=width)
        return figure, axes[:count], axes[count] if has_distance else None
    in_row = min(count, max(int(PAPER_WIDTH / (PAPER_CELL * columns + PAPER_GAP)), 1))
    rows = -(-count // in_row)
    height = max(PAPER_LINE * lines, 0.9) + PAPER_AXIS
    ratios = [1.0] * rows + [DISTANCE_RATIO] * has_distance
    figure, axes = make_axes(
        in_row * len(ratios), height * sum(ratios) / len(ratios), in_row, width=1.0,
        gridspec_kw={"height_ratios": ratios},
    )  # fmt: skip
    maps = axes[:count]
    for axis in axes[count:]:
        axis.remove()
    if not has_distance:
        return figure, maps, None
    return figure, maps, figure.add_subplot(axes[0].get_gridspec()[-1, :])


def _draw_map(
    axis: Axes, results: Results, rows: np.ndarray, down: tuple[str, list], across: tuple[str, list]
) -> AxesImage:
    """Draw the success rates of some runs of a study.

    Args:
        axis: axes of the map.
        results: results of the study.
        rows: (n,) indices of the rows of these runs in the results.
        down: key of the vertical axis and its values.
        across: key of the horizontal axis and its values.
    """
    (down_key, lines), (across_key, columns) = down, across
    hits = results.compute_successes()
    cells = np.full((len(lines), len(columns)), np.nan)
    image = axis.imshow(cells, vmin=0.0, vmax=100.0, cmap="viridis", aspect="auto")
    text = {"ha": "center", "va": "center", "fontsize": 7 if is_paper() else 9}
    for (line, column), all_rows in results.group_rows((down_key, across_key)).items():
        own = np.intersect1d(all_rows, rows)
        if not own.size:
            continue
        one = rate(hits[own])
        i, j = lines.index(line), columns.index(column)
        cells[i, j] = 100.0 * one.value
        colour = choose_text_colour(image.cmap(one.value))
        axis.text(j, i, f"{int(hits[own].sum())}/{len(own)}", color=colour, **text)
    for i, j in np.argwhere(np.isnan(cells)):
        axis.text(j, i, "–" if is_paper() else "no runs", color=SOFT_INK, **text)
    image.set_data(cells)
    axis.grid(False)
    axis.set_xticks(range(len(columns)), map(format_setting, columns))
    axis.set_xlabel(label_setting(across_key))
    return image


def find_curve_keys(all_results: Sequence[Results]) -> Sequence[str]:
    """Return the settings whose values distinguish the curves of the final distance.

    These curves are drawn next to success maps. If there are several maps, there is one curve for
    the runs of each map. If there is a single map, there is one curve for each of its rows.
    """
    keys = find_varied_keys(all_results)
    pooled = find_pooled_keys("success", all_results)
    others = [key for key in keys[:-2] if key not in pooled] or keys[-2:-1]
    return limit_groups(all_results, others, find_map_limit())


def _describe_tolerance(axis: Axes, all_results: Sequence[Results]) -> None:
    """Write the tolerance of the final distance below its axis, except in figures for a paper."""
    if not is_paper():
        text = textwrap.fill(captions.describe_tolerances(all_results), MAX_NAME)
        axis.set_xlabel(f"{axis.get_xlabel()}\n{escape_math(text)}")
