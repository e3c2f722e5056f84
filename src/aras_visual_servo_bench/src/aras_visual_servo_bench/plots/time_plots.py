"""Figures of panels of curves over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..recording.run import Run
from .palette import BAD, COLOURS, FAINT, GOAL, GOOD, INK, SOFT_INK
from .panel import Panel, Texts
from .panels import find_last_time
from .style import (
    TIME_LABEL,
    add_legend,
    add_title,
    escape_math,
    format_log_axis,
    is_paper,
    make_axes,
)

SYMBOLS = {
    "xn": "$x_n$", "yn": "$y_n$", "an": "$a_n$", "alpha": r"$\alpha$", "theta": r"$\theta$",
    "rho": r"$\rho$",
    "condition of L": "condition of $L$", "condition of L J": r"condition of $L\,J$",
    "L": "$L$", "L J": r"$L\,J$", "v": "$v$", "ω": r"$\omega$",
    "|v|": "$|v|$", "|ω|": r"$|\omega|$",
    **{f"v{axis}": f"$v_{axis}$" for axis in "xyz"},
    **{f"ω{axis}": rf"$\omega_{axis}$" for axis in "xyz"},
}  # fmt: skip
# Names of axes that are labelled 'no unit' if the quantity has no unit.
UNITLESS = ("error", "feature")
MAX_NAMES = 12  # largest number of names in a legend
NARROW_LEGEND = {"handlelength": 1.2, "columnspacing": 0.8}
# smallest range of an axis of joint positions (rad, m) or joint velocities (rad/s, m/s)
MIN_AXIS_RANGE = 0.004
# Space above the curves, relative to the height of the axis, in panels whose `span` gives the lower
# end of the axis.
HEADROOM = 0.15
MIN_LINE_POINTS = 3  # smallest number of points of a curve that is drawn as a line, not as dots
DASHES = ("-", (0, (4, 1.5)), (0, (1, 1.2)))
MARKERS = ("o", "s", "^", "D", "v", "P")  # markers on the curves of the first, second, ... run
MARKER_SPACING = 0.125  # distance between markers on a curve, relative to the size of the axes
# Extra line width of the first run's curves, relative to the width of the last run's, so that
# curves that coincide remain visible.
EXTRA_WIDTH = 0.7
# The text of a time mark is to the left of its line if the line is beyond this fraction of the time
# axis.
TEXT_SIDE_SWITCH = 0.75


@dataclass(frozen=True)
class Layout:
    """Layout of a figure.

    Attributes:
        panel_height: height of a panel, inches.
        columns: number of columns of panels.
        second_column: title of the second column.
        legend_columns: number of columns of a legend.
    """

    panel_height: float = 1.75
    columns: int = 1
    second_column: str = ""
    legend_columns: int = 4


def find_symbol(name: str) -> str:
    """Return the mathematical symbol of a quantity, or its name if it has no symbol."""
    stem = name.rstrip("0123456789").rstrip("_")
    number = name[len(stem) :].lstrip("_")
    if number and stem.isalpha() and len(stem) == 1:
        return f"${stem}_{{{number}}}$"
    return SYMBOLS.get(name, escape_math(name.replace("_", " ")))


def make_curve_styles(count: int) -> list[dict[str, object]]:
    """Return the style of the curves of each of `count` runs.

    The curves of a single run need no markers. The markers of several runs differ, so that their
    curves can be distinguished in print without colours. To keep curves that coincide visible, the
    curves of earlier runs are wider, and the markers of different runs are at different positions.
    """
    if count == 1:
        return [{"color": INK}]
    width = plt.rcParams["lines.linewidth"]
    return [
        {
            "color": COLOURS[i % len(COLOURS)], "alpha": 0.9,
            "marker": MARKERS[(i + i // len(COLOURS)) % len(MARKERS)], "mew": 0.0,
            "ms": 4.2 * width, "markevery": (MARKER_SPACING * i / count, MARKER_SPACING),
            "lw": width * (1.0 + EXTRA_WIDTH * (count - 1 - i) / (count - 1)),
        }
        for i in range(count)
    ]  # fmt: skip


def draw_panels(
    panels: Sequence[Panel], runs: Sequence[Run], title: str, layout: Layout
) -> Figure | None:
    """Draw panels as a figure; return None if there are no panels.

    Args:
        panels: panels of the figure.
        runs: runs in the panels. If there are several, the figure has one legend with their names.
        title: title of the figure.
        layout: layout of the figure.
    """
    if not panels:
        return None
    is_single, columns = len(runs) == 1, layout.columns
    figure, axes = make_axes(len(panels), layout.panel_height, columns, is_wide=columns > 1)
    styles = [] if is_single else make_curve_styles(len(runs))
    for axis, panel in zip(axes, panels, strict=True):
        _draw_panel(axis, panel, styles, columns > 1)
    if is_single:
        title += _make_hints(panels)
    elif layout.second_column:
        # only the left panel has a title, because the names of the runs need the space on the right
        title += f" and {layout.second_column.lower()}"
    add_title(axes[0], title)
    if is_single and layout.second_column:
        add_title(axes[1], layout.second_column)
    if not is_single:
        add_legend(axes[columns - 1], **(NARROW_LEGEND if columns > 1 else {}))
    elif columns > 1 and is_paper():
        add_legend(axes[0], **NARROW_LEGEND)
    for axis, panel in zip(axes, panels, strict=True) if is_single and columns == 1 else ():
        labels = axis.get_legend_handles_labels()[1]
        if len(labels) <= MAX_NAMES and labels != [find_symbol(panel.axis)]:
            add_legend(axis, layout.legend_columns)
    label = "time (s)" if is_paper() and columns > 1 else TIME_LABEL
    for column in range(columns):
        axes[column::columns][-1].set_xlabel(label)
    axes[-1].set_xlim(0.0, find_last_time(runs))
    return figure


def _make_hints(panels: Sequence[Panel]) -> str:
    """Return a text that explains pale curves, dashed curves and bands, for the title."""
    curves = [curve for panel in panels for curve in panel.curves]
    dashed = next((panel.dashed for panel in panels if panel.dashed), "")
    hints = ["pale: as measured, full: filtered"] if any(c.is_pale for c in curves) else []
    hints += [f"dashed: {dashed}"] if any(c.dashed for c in curves) else []
    hints += ["band: tolerance"] if any(p.band is not None for p in panels) else []
    return f"  ({'; '.join(hints)})" if hints else ""


def _draw_panel(
    axis: Axes, panel: Panel, styles: Sequence[dict[str, object]], all_named: bool
) -> None:
    """Draw one panel.

    Args:
        axis: axes of the panel.
        panel: panel to draw.
        styles: style of the curves of each run; empty for a single run.
        all_named: True if dashed curves have an entry in the legend, too.
    """
    if panel.is_logarithmic:
        axis.set_yscale("log")
    if panel.band is not None:
        axis.axhspan(-panel.band, panel.band, color=GOAL, alpha=0.13, lw=0)
    for curve in panel.curves:
        if styles:
            style = {**styles[curve.run], "label": escape_math(curve.name)}
        else:
            dashes = DASHES[curve.colour_index // len(COLOURS) % len(DASHES)]
            style = {"color": COLOURS[curve.colour_index % len(COLOURS)], "ls": dashes}
            if not (curve.dashed or curve.is_pale):
                style["label"] = find_symbol(curve.name)
        if curve.dashed:
            style |= {"ls": "--", "lw": 1.0}
        if curve.dashed and all_named:
            style["label"] = escape_math(curve.name)
        if curve.is_pale:
            style |= {"alpha": 0.35, "lw": 0.8}
        if panel.is_dotted:
            dots = {"markevery": None, "ms": 2.0 * style["lw"]} if styles else \
                {"marker": ".", "ms": 3}  # fmt: skip
            style |= {**dots, "ls": ""}
        elif len(curve.time) < MIN_LINE_POINTS and not styles:
            style |= {"marker": ".", "ms": 3}
        axis.plot(*curve.insert_gaps(), **style)
    low, high = axis.get_ylim()
    least, most = panel.span
    if least is not None:
        low, high = min(low, least), high + HEADROOM * (high - min(low, least))
    axis.set_ylim(low, high if most is None else max(high, most))
    if panel.is_logarithmic:
        format_log_axis(axis)
    elif low < 0.0 < high:
        axis.axhline(0.0, color=FAINT, lw=0.8, zorder=1)
    for value, text in panel.levels:
        axis.axhline(value, color=GOAL, ls="--", lw=0.9)
        axis.annotate(text, (1.0, value), xycoords=("axes fraction", "data"), ha="right",
                      xytext=(-2, 3), textcoords="offset points", color=GOOD)  # fmt: skip
    _draw_limits(axis, panel.limits)
    for time, text in panel.marks:
        _draw_mark(axis, time, text, max(float(curve.time[-1]) for curve in panel.curves))
    name = SYMBOLS.get(panel.axis, escape_math(panel.axis))
    if panel.unit or panel.axis in UNITLESS:
        name = f"{name} ({escape_math(panel.unit) or 'no unit'})".strip()
    axis.set_ylabel(name)


def _draw_mark(axis: Axes, time: float, text: str, end: float) -> None:
    """Draw a vertical line with a text at a time, s; the time axis ends at `end`, s."""
    left = time > TEXT_SIDE_SWITCH * end
    axis.axvline(time, color=GOAL, ls=":", lw=1.2)
    axis.annotate(
        f"{text} after {time:.2f} s", (time, 1.0), xycoords=("data", "axes fraction"),
        xytext=(-4 if left else 4, -3), textcoords="offset points", color=GOOD, va="top",
        ha="right" if left else "left",
    )  # fmt: skip


def _draw_limits(axis: Axes, limits: Texts) -> None:
    """Draw limits near the curves as lines; if all limits are far away, write their numbers."""
    if not limits:
        return
    low, high = axis.get_ylim()
    # with a smaller range of the axis, a joint at rest would appear to move
    if high - low < MIN_AXIS_RANGE:
        middle = 0.5 * (low + high)
        low, high = middle - 0.5 * MIN_AXIS_RANGE, middle + 0.5 * MIN_AXIS_RANGE
    room, far_limits = 0.6 * (high - low), []
    for bound, _ in limits:
        if low - room <= bound <= high + room:
            outward = 1.0 if bound > 0.5 * (low + high) else -1.0
            axis.axhline(bound, color=BAD, lw=1.0, ls=(0, (5, 2)))
            low, high = min(low, bound - 0.05 * room), max(high, bound + 0.05 * room)
            axis.axhspan(bound, bound + outward * 10.0 * room, color=BAD, alpha=0.08, lw=0)
        else:
            far_limits.append(f"{bound:.3g}")
    axis.set_ylim(low, high)
    if len(far_limits) == len(limits) and not is_paper():
        # Place the text above or below the curves, where the second half of the curves leaves more
        # space.
        last_half = np.concatenate([y[len(y) // 2 :] for line in axis.lines
                                    if len(y := line.get_ydata()) > 2] or [[low]])  # fmt: skip
        below = np.nanmean(last_half) > 0.5 * (low + high)
        axis.annotate(f"limits {' to '.join(far_limits)}", (1.0, 0.0 if below else 1.0), ha="right",
                      xycoords="axes fraction", va="bottom" if below else "top", fontsize=7.5,
                      xytext=(-3, 3 if below else -2), textcoords="offset points",
                      color=SOFT_INK)  # fmt: skip
