"""One look for every figure: sober, told apart by colour-blind readers too, SI units."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import ScaledTranslation

from .palette import COLOURS, FAINT, GRID, INK, SOFT_INK

STYLE = {
    "figure.figsize": (7.2, 4.5),  # inches; what is wide takes the page's whole width
    "figure.dpi": 110,
    "savefig.dpi": 150,
    "figure.facecolor": "white",
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": False,  # would make formulas of all ticks: slow
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "xtick.color": SOFT_INK,
    "ytick.color": SOFT_INK,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.columnspacing": 1.2,
    "axes.prop_cycle": matplotlib.cycler(color=COLOURS),
    "svg.hashsalt": "aras",
}
# A column of a two-column paper is 3.5 inches, its captions are in 8 points, and its figures'
# titles are their captions; Type 3 fonts are refused by most publishers.
PAPER = {
    **STYLE,
    "figure.figsize": (3.5, 2.4),
    "font.family": "serif",
    "font.serif": ["STIXGeneral"],
    "axes.formatter.use_mathtext": True,
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titleweight": "normal",
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "lines.linewidth": 1.0,
    "lines.markersize": 3,
    "axes.linewidth": 0.6,
    "grid.linewidth": 0.4,
    "pdf.fonttype": 42,
}
FILE_FORMATS = ("png", "svg", "pdf")  # of files
WIDE_FIGURE = 12.0  # inches, of figures over the page's whole width: letters as large as elsewhere
EDGE_MARGIN = 3.0  # pixels between a legend and the edge of its figure
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
TIME_LABEL = "time since servoing began (s)"


@contextmanager
def apply_style(is_paper: bool = False) -> Iterator[None]:
    """All figures made within look alike."""
    with plt.rc_context(PAPER if is_paper else STYLE):
        yield


def is_paper() -> bool:
    """Whether figures are made for a paper."""
    return plt.rcParams["font.family"] == ["serif"]


def find_figure_width(is_wide: bool = False) -> float:
    """Inches; a paper's column knows no wide figures."""
    return WIDE_FIGURE if is_wide and not is_paper() else plt.rcParams["figure.figsize"][0]


class Margins(NamedTuple):
    """Inches round and between axes, of a figure for the screen; a paper's are smaller."""

    left: float = 0.0
    right: float = 0.0
    top: float = 0.0
    bottom: float = 0.0
    row_gap: float = 0.0  # between rows
    column_gap: float = 0.0  # between columns


TIME_MARGINS = Margins(0.92, 0.12, 0.36, 0.58, 0.3, 1.0)


def make_axes(
    count: int,
    panel_height: float,
    columns: int = 1,
    is_wide: bool = False,
    width: float | None = None,
    margins: Margins = TIME_MARGINS,
    **options: object,
) -> tuple[Figure, list[Axes]]:
    """A figure and so many axes of one size, row by row.

    The figure has the look's width, and its margins are fixed: a layout that is worked out from
    every tick's text takes as long as drawing the figure, and moves the axes from one report to
    the next. Only where `width` is given, for labels as long as a user's keys, it is worked out.

    Args:
        each: height of a row, inches. wide: over the page's whole width.
        width: of each column with its labels, inches.
        margins: those of TIMED axes go with a common time and labels in one line.
        options: as of Figure.subplots.
    """
    rows, part = -(-count // columns), 0.66 if is_paper() else 1.0
    if width is not None:
        size = (width * columns, panel_height * rows)
        figure = plt.figure(figsize=size, layout="constrained")
    else:
        scaled = Margins(*(part * inches for inches in margins))
        panel_height *= part
        long = find_figure_width(is_wide)
        across = (long - scaled.left - scaled.right - (columns - 1) * scaled.column_gap) / columns
        high = scaled.top + scaled.bottom + rows * panel_height + (rows - 1) * scaled.row_gap
        figure = plt.figure(figsize=(long, high))
        options["gridspec_kw"] = {
            "left": scaled.left / long, "right": 1.0 - scaled.right / long,
            "top": 1.0 - scaled.top / high, "bottom": scaled.bottom / high,
            "hspace": scaled.row_gap / panel_height, "wspace": scaled.column_gap / across,
        }  # fmt: skip
        options["sharex"] = margins is TIME_MARGINS
    axes = list(figure.subplots(rows, columns, squeeze=False, **options).flat)
    for axis in axes[count:]:
        axis.set_visible(False)
    for axis in axes if width is None and margins is TIME_MARGINS else ():
        axis.yaxis.set_label_coords(-0.71 * part / across, 0.5)
    return figure, axes[:count]


def equalize_heights(figures: Sequence[Figure]) -> None:
    """Give figures over time that stand beside each other one height: the rows of the shorter ones
    grow, their margins stay. Pictures are left as they are: they have shapes of their own."""
    height = max(figure.get_figheight() for figure in figures)
    for figure in figures:
        before, grid = figure.get_figheight(), figure.axes[0].get_gridspec()
        picture = figure.axes[0].name == "3d" or figure.axes[0].get_aspect() != "auto"
        if before == height or picture:
            continue
        top, bottom, rows = (1.0 - grid.top) * before, grid.bottom * before, grid.nrows
        gap = grid.hspace * (before - top - bottom) / (rows + (rows - 1) * grid.hspace)
        each = (height - top - bottom - (rows - 1) * gap) / rows
        figure.set_figheight(height)
        grid.update(top=1.0 - top / height, bottom=bottom / height, hspace=gap / each)


def escape_math(text: str) -> str:
    """A text of a user's, for a figure: a $ in it begins no formula."""
    return text.replace("$", r"\$")


def add_title(axis: Axes, text: str) -> None:
    """A title; in a paper the caption says it."""
    if not is_paper():
        axis.set_title(text)


def format_log_axis(axis: Axes) -> None:
    """Labels 1, 2, 5, 10 where the axis spans little, powers of ten where it spans much."""
    low, high = axis.get_ylim()
    if high < 1e3 * low:
        between = (1.0, 2.0, 5.0) if high < 50.0 * low else (1.0,)
        axis.yaxis.set_major_locator(LogLocator(subs=between))
        axis.yaxis.set_major_formatter("{x:g}")
    elif not is_paper():  # whose letters have no raised minus
        axis.yaxis.set_major_formatter(FuncFormatter(_format_power))
    axis.yaxis.set_minor_formatter(NullFormatter())


def _format_power(value: float, _position: int) -> str:
    """10⁻³; in plain letters, for setting formulas takes a fifth of a report's time."""
    return "10" + str(round(math.log10(value))).translate(SUPERSCRIPTS) if value > 0.0 else ""


def add_legend(axis: Axes, columns: int = 4, **options: object) -> None:
    """Above the data at the right, never over it, nor over a title or tick labels.

    It has as many columns as the figure has room for, and the figure grows by its lines.
    """
    handles, labels = axis.get_legend_handles_labels()
    if not labels:
        return
    figure = axis.get_figure()
    right = axis.get_window_extent().x1

    def make_legend(count: int, up: float = 0.0) -> Legend:
        lifted = axis.transAxes + ScaledTranslation(0.0, up / 72.0, figure.dpi_scale_trans)
        return axis.legend(
            handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), bbox_transform=lifted,
            borderaxespad=0.1, ncols=count, **options,
        )  # fmt: skip

    found, count = _fit_legend(make_legend, min(columns, len(labels)), right - EDGE_MARGIN)
    titles = [a.title if a.get_title() else a._left_title for a in figure.axes]
    box, up = found.get_window_extent(), 0.0  # points
    if box.x0 < axis.get_window_extent().x0:
        up = 0.6 * axis.yaxis.get_ticklabels()[0].get_fontsize()  # half a label at the axis' top
    if any(t.get_text() and box.overlaps(t.get_window_extent()) for t in titles):
        up = plt.rcParams["axes.titlepad"] + 1.2 * titles[0].get_fontsize()
    if up:
        _shorten_legend(make_legend(count, up), right - EDGE_MARGIN)
    if axis.get_subplotspec().is_first_row():
        above = (1.0 - axis.get_position().y1) * figure.get_figheight()
        _grow_margins(figure, above=max(box.height / figure.dpi + up / 72.0 + 0.04 - above, 0.0))


def add_legend_below(figure: Figure, columns: int, handles: Sequence[Artist] | None = None) -> None:
    """In the middle below all axes; the figure grows by the lines after the first."""
    if handles is None:
        handles = [one for axis in figure.axes for one in axis.get_legend_handles_labels()[0]]
    room = figure.get_figwidth() * figure.dpi - 2.0 * EDGE_MARGIN

    def make_legend(count: int) -> Legend:
        for former in figure.legends[:]:
            former.remove()
        return figure.legend(handles=handles, loc="lower center", ncols=count)

    found, count = _fit_legend(make_legend, min(columns, len(handles)), room)
    lines = -(-len(handles) // count)
    _grow_margins(figure, below=found.get_window_extent().height / figure.dpi * (lines - 1) / lines)


def _fit_legend(
    make_legend: Callable[[int], Legend], columns: int, max_width: float
) -> tuple[Legend, int]:
    """The legend with the most columns that fit into so many pixels, and how many these are."""
    for count in range(columns, 0, -1):
        found = make_legend(count)
        if found.get_window_extent().width <= max_width:
            break
    _shorten_legend(found, max_width)
    return found, count


def _shorten_legend(legend: Legend, max_width: float) -> None:
    """Cut its words where even one column is wider than so many pixels."""
    width = legend.get_window_extent().width
    longest = max(len(text.get_text()) for text in legend.get_texts())
    if width > max_width:
        most = max(int(longest * max_width / width) - 3, 1)
        for text in legend.get_texts():
            if len(text.get_text()) > most:
                text.set_text(text.get_text()[:most].rstrip("\\") + "…")


def _grow_margins(figure: Figure, above: float = 0.0, below: float = 0.0) -> None:
    """Make a figure's margins larger by so many inches; its axes keep their sizes."""
    before, grid = figure.get_figheight(), figure.axes[0].get_gridspec()
    top, bottom = (1.0 - grid.top) * before + above, grid.bottom * before + below
    height = before + above + below
    figure.set_figheight(height)
    grid.update(top=1.0 - top / height, bottom=bottom / height)
