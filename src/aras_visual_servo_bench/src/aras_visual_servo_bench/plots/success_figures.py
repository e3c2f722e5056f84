"""Figures of success rates, next to the distributions of the final distance."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..metrics.metrics import final_distance
from ..metrics.statistics import rate
from ..studies import captions
from ..studies.results import Results
from .distributions import MAX_COLUMNS, MAX_NAME, draw_bars, draw_cumulative, draw_metric_boxes
from .palette import SOFT_INK, choose_text_colour
from .run_groups import (
    MAX_MAPS,
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


def draw_success(all_results: Sequence[Results]) -> Figure | None:
    """Draw the success rate, and the distribution of the final distance next to it.

    If at least two settings have several values, the rates are maps, whose axes are the last two of
    them, with a map for each combination of values of the others. Otherwise, there is a bar for
    each value of the setting, or for each study.
    """
    keys = find_varied_keys(all_results)
    if len(keys) >= 2:
        return _draw_success_maps(all_results, keys)
    return _draw_success_bars(all_results, keys)


def _draw_success_bars(all_results: Sequence[Results], keys: Sequence[str]) -> Figure:
    groups = list_groups(all_results, keys)
    hits = {results.name: results.compute_successes() for results in all_results}
    rates = [rate(hits[results.name][rows]) for _, results, rows in groups]
    has_distance = has_final_distance(all_results)
    figure, axes = make_axes(
        1 + has_distance, 0.42 * len(groups) + 1.5, 1 + has_distance,
        width=4.4 if has_distance else 6.5,
    )  # fmt: skip
    names = [name for name, *_ in groups]
    draw_bars(axes[0], rates, names)
    axes[0].set_xlabel("runs with success (%), Wilson's 95 % interval")
    add_title(axes[0], f"Success by {label_setting(keys[0])}" if keys else "Success")
    if has_distance:
        draw_metric_boxes(axes[1], final_distance, groups)
        axes[1].set_yticks(range(1, len(groups) + 1), names[::-1] if is_paper() else [])
        axes[1].set_ylim(0.5, len(groups) + 0.5)
        axes[0].set_ylim(-0.5, len(groups) - 0.5)
        _describe_tolerance(axes[1], all_results)
    return figure


def _draw_success_maps(all_results: Sequence[Results], keys: Sequence[str]) -> Figure:
    *others, down, across = keys
    pooled = find_pooled_keys("success", all_results)
    others = [key for key in others if key not in pooled]
    columns, lines = find_values(all_results, across), find_values(all_results, down)
    panels = list_groups(all_results, others)
    has_distance = has_final_distance(all_results)
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
        axis.set_xticks(range(len(columns)), map(format_setting, columns))
        axis.set_yticks(range(len(lines)), map(format_setting, lines) if is_first else [])
        axis.set_xlabel(label_setting(across))
        axis.set_ylabel(label_setting(down) if is_first else "")
        title = name if len(panels) > 1 else "Success"
        pool = f" (all {', '.join(pooled)})" if pooled else ""
        if len(panels) > 1 or pooled:
            axis.set_title(title + escape_math(pool))
        else:
            add_title(axis, title)
    figure.colorbar(image, ax=axes[: len(panels)], label="runs with success (%)", shrink=0.9)
    if has_distance:
        curves = list_groups(all_results, find_curve_keys(all_results))
        draw_cumulative(axes[len(panels)], final_distance, curves)
        axes[len(panels)].set_ylabel("runs below (%)")
        _describe_tolerance(axes[len(panels)], all_results)
        if len(curves) > 1:
            axes[len(panels)].legend(fontsize="small")
    return figure


def find_curve_keys(all_results: Sequence[Results]) -> Sequence[str]:
    """Return the keys for whose values there are curves of final distances next to success maps.

    If there are several maps, each map has a curve. A single map has a curve for each of its rows.
    """
    keys = find_varied_keys(all_results)
    pooled = find_pooled_keys("success", all_results)
    others = [key for key in keys[:-2] if key not in pooled] or keys[-2:-1]
    return limit_groups(all_results, others, MAX_MAPS)


def _describe_tolerance(axis: Axes, all_results: Sequence[Results]) -> None:
    """Write the tolerance below an axis of final distances; a paper has it in the caption."""
    if not is_paper():
        text = textwrap.fill(captions.describe_tolerances(all_results), MAX_NAME)
        axis.set_xlabel(f"{axis.get_xlabel()}\n{escape_math(text)}")
