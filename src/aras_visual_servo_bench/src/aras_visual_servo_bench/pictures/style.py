"""One look for every figure: sober, told apart by colour-blind readers too, SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

# Okabe and Ito's palette.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
START, GOAL, LIMIT, INK, FAINT = "#d55e00", "#009e73", "#b3261e", "#333333", "#9aa0a6"
STYLE = {
    "figure.figsize": (7.2, 4.5),  # inches; what is wide takes the page's whole width
    "figure.dpi": 110,
    "savefig.dpi": 150,
    "figure.facecolor": "white",
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": "#8a8f94",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "grid.color": "#e6e8ea",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "xtick.color": "#5f6368",
    "ytick.color": "#5f6368",
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.columnspacing": 1.2,
    "axes.prop_cycle": matplotlib.cycler(color=COLOURS),
    "svg.fonttype": "path",
    "svg.hashsalt": "aras",
}
# A column of a two-column paper is 3.5 inches, its captions are in 8 points, and its figures'
# titles are their captions; Type 3 fonts are refused by most publishers.
PAPER = {
    **STYLE,
    "figure.figsize": (3.5, 2.4),
    "font.family": "serif",
    "font.serif": ["STIXGeneral"],
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titleweight": "normal",
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "lines.linewidth": 1.0,
    "lines.markersize": 3,
    "axes.linewidth": 0.6,
    "grid.linewidth": 0.4,
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
}
WIDE = 12.0  # inches, of figures over the page's whole width: letters as large as elsewhere
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
TIME = "time since servoing began (s)"


@contextmanager
def look(paper: bool = False) -> Iterator[None]:
    """All figures made within look alike."""
    with plt.rc_context(PAPER if paper else STYLE):
        yield


def is_paper() -> bool:
    """Whether figures are made for a paper."""
    return plt.rcParams["font.family"] == ["serif"]


def figure_width(wide: bool = False) -> float:
    """Inches; a paper's column knows no wide figures."""
    return WIDE if wide and not is_paper() else plt.rcParams["figure.figsize"][0]


def canvas(
    rows: int, columns: int = 1, each: float = 1.5, wide: bool = False
) -> tuple[Figure, np.ndarray]:
    """Figure of the look's width and its axes (rows, columns) over a common time.

    Margins are fixed, in inches: a layout that is worked out from every tick's text takes as long
    as drawing the figure, and moves the axes from one report to the next.

    Args:
        each: height of a row, inches. wide: over the page's whole width.
    """
    width, part = figure_width(wide), 0.66 if is_paper() else 1.0
    left, right, top, bottom, gap, between = part * np.array([0.92, 0.12, 0.36, 0.52, 0.3, 1.0])
    each = part * each
    height = top + bottom + rows * each + (rows - 1) * gap
    across = (width - left - right - (columns - 1) * between) / columns
    figure, axes = plt.subplots(
        rows, columns, squeeze=False, sharex=True, figsize=(width, height),
        gridspec_kw={
            "left": left / width, "right": 1.0 - right / width, "top": 1.0 - top / height,
            "bottom": bottom / height, "hspace": gap / each, "wspace": between / across,
        },
    )  # fmt: skip
    for axis in axes.flat:
        axis.yaxis.set_label_coords(-0.74 * part / across, 0.5)
    return figure, axes


def level(figures: Sequence[Figure]) -> None:
    """Give canvases that stand beside each other one height: the rows of the shorter ones grow,
    their margins stay. Sheets are left as they are: their pictures have shapes of their own."""
    height = max(figure.get_figheight() for figure in figures)
    for figure in figures:
        before, grid = figure.get_figheight(), figure.axes[0].get_gridspec()
        if before == height or grid.top is None:  # None: a sheet
            continue
        top, bottom, rows = (1.0 - grid.top) * before, grid.bottom * before, grid.nrows
        gap = grid.hspace * (before - top - bottom) / (rows + (rows - 1) * grid.hspace)
        each = (height - top - bottom - (rows - 1) * gap) / rows
        figure.set_figheight(height)
        grid.update(top=1.0 - top / height, bottom=bottom / height, hspace=gap / each)


def sheet(height: float, wide: bool = False, **margins: float) -> tuple[Figure, float]:
    """Figure of the look's width and so many inches, and that width; margins as in subplots_adjust,
    in inches."""
    width = figure_width(wide)
    figure = plt.figure(figsize=(width, height))
    part = 0.66 if is_paper() else 1.0
    figure.subplots_adjust(
        left=part * margins.get("left", 0.0) / width,
        right=1.0 - part * margins.get("right", 0.0) / width,
        bottom=part * margins.get("bottom", 0.0) / height,
        top=1.0 - part * margins.get("top", 0.0) / height,
    )
    return figure, width


def heading(axis: Axes, text: str) -> None:
    """A title; in a paper the caption says it."""
    if not is_paper():
        axis.set_title(text)


def logarithmic(axis: Axes) -> None:
    """Labels 1, 2, 5, 10 where the axis spans little, powers of ten where it spans much."""
    low, high = axis.get_ylim()
    if high < 1e3 * low:
        between = (1.0, 2.0, 5.0) if high < 50.0 * low else (1.0,)
        axis.yaxis.set_major_locator(LogLocator(subs=between))
        axis.yaxis.set_major_formatter("{x:g}")
    elif not is_paper():  # whose letters have no raised minus
        axis.yaxis.set_major_formatter(FuncFormatter(_power))
    axis.yaxis.set_minor_formatter(NullFormatter())


def _power(value: float, _position: int) -> str:
    """10⁻³; in plain letters, for setting formulas takes a fifth of a report's time."""
    return "10" + str(round(math.log10(value))).translate(RAISED) if value > 0.0 else ""


def legend(axis: Axes, columns: int = 4, **options: object) -> None:
    """Above the data at the right, never over it."""
    handles, labels = axis.get_legend_handles_labels()
    if labels:
        axis.legend(
            handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1,
            ncols=min(columns, len(labels)), **options,
        )  # fmt: skip
