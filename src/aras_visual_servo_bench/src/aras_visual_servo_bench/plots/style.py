"""Common style of all figures, with SI units and colours for colour-blind readers."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import ScaledTranslation

from .palette import COLOURS, FAINT, GRID, INK, SOFT_INK

STYLE = {
    "figure.figsize": (7.2, 4.5),  # inches; wide figures have the width WIDE_FIGURE
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
    # mathtext would be slow, because all numbers on the axes would become formulas
    "axes.formatter.use_mathtext": False,
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
# Style of figures for a two-column paper, whose columns are 3.5 inches wide and whose captions have
# letters of 8 points. Type 42 fonts are used, because most publishers do not accept Type 3 fonts.
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
FILE_FORMATS = ("png", "svg", "pdf")
WIDE_FIGURE = 12.0  # width of a figure that extends over the whole page, inches
EDGE_MARGIN = 3.0  # smallest distance between a legend and the edge of its figure, px
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
TIME_LABEL = "time since servoing began (s)"


@contextmanager
def apply_style(is_paper: bool = False) -> Iterator[None]:
    """Apply the common style to all figures made in this context.

    is_paper: True for the style of a paper.
    """
    with plt.rc_context(PAPER if is_paper else STYLE):
        yield


def is_paper() -> bool:
    """Return whether figures are made in the style of a paper."""
    return plt.rcParams["font.family"] == ["serif"]


def find_figure_width(is_wide: bool = False) -> float:
    """Return the width of a figure, inches; `is_wide` has no effect in figures for a paper."""
    return WIDE_FIGURE if is_wide and not is_paper() else plt.rcParams["figure.figsize"][0]


class HeadlessFigure(Figure):
    """Figure that is drawn without a window, and that notebooks show.

    It is independent of pyplot, whose backend and open figures belong to the user.
    """

    def __init__(self, **options: object) -> None:
        super().__init__(**options)
        FigureCanvasAgg(self)

    def make_png(self) -> bytes:
        """Return the figure as PNG, with the resolution of the screen."""
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=self.dpi)
        return stream.getvalue()

    _repr_png_ = make_png  # of notebooks


class Margins(NamedTuple):
    """Margins around and between the axes of figures for the screen, inches; smaller for a paper.
    """

    left: float = 0.0
    right: float = 0.0
    top: float = 0.0
    bottom: float = 0.0
    row_gap: float = 0.0
    column_gap: float = 0.0


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
    """Make a figure with `count` axes of equal size, row by row.

    By default, the figure has the width from `find_figure_width` and fixed margins. If `width` is
    given, Matplotlib computes the layout, so that labels of any length fit. Computing the layout
    takes as long as drawing the figure, and the positions of the axes depend on the labels.

    Args:
        count: number of axes.
        panel_height: height of a row, inches.
        columns: number of columns.
        is_wide: True for a figure that extends over the whole page.
        width: width of each column with its labels, inches; None for fixed margins. A figure for a
            paper ignores this value and has the width of a column of the paper.
        margins: margins around and between the axes. With TIME_MARGINS, the axes also share their
            time axis, and the labels are aligned.
        options: options of Figure.subplots.
    """
    if width is not None and is_paper():
        width = find_figure_width() / columns
    rows, part = -(-count // columns), 0.66 if is_paper() else 1.0
    if width is not None:
        size = (width * columns, part * panel_height * rows)
        figure = HeadlessFigure(figsize=size, layout="constrained")
    else:
        scaled = Margins(*(part * inches for inches in margins))
        panel_height *= part
        long = find_figure_width(is_wide)
        across = (long - scaled.left - scaled.right - (columns - 1) * scaled.column_gap) / columns
        high = scaled.top + scaled.bottom + rows * panel_height + (rows - 1) * scaled.row_gap
        figure = HeadlessFigure(figsize=(long, high))
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
    """Enlarge figures that are shown side by side to the height of the highest of them.

    The panels of a figure become higher, but its margins do not change. Figures with images or 3-D
    views are not changed, because their proportions are fixed.
    """
    height = max(figure.get_figheight() for figure in figures)
    for figure in figures:
        old_height, grid = figure.get_figheight(), figure.axes[0].get_gridspec()
        is_image = figure.axes[0].name == "3d" or figure.axes[0].get_aspect() != "auto"
        if old_height == height or is_image:
            continue
        top, bottom, rows = (1.0 - grid.top) * old_height, grid.bottom * old_height, grid.nrows
        gap = grid.hspace * (old_height - top - bottom) / (rows + (rows - 1) * grid.hspace)
        row_height = (height - top - bottom - (rows - 1) * gap) / rows
        figure.set_figheight(height)
        _set_margins(figure, 1.0 - top / height, bottom / height, gap / row_height)


def escape_math(text: str) -> str:
    """Escape the $ signs in a user's text, so that figures do not show it as a formula."""
    return text.replace("$", r"\$")


def add_title(axis: Axes, text: str) -> None:
    """Add a title to the axes. A figure for a paper has no title, because it has a caption."""
    if not is_paper():
        axis.set_title(text)


def format_log_axis(axis: Axes) -> None:
    """Label a logarithmic axis with powers of ten, and for a small range also with 2 and 5."""
    low, high = axis.get_ylim()
    if high < 1e3 * low:
        between = (1.0, 2.0, 5.0) if high < 50.0 * low else (1.0,)
        axis.yaxis.set_major_locator(LogLocator(subs=between))
        axis.yaxis.set_major_formatter("{x:g}")
    elif not is_paper():  # the font of papers lacks the character ⁻ of powers such as 10⁻³
        axis.yaxis.set_major_formatter(FuncFormatter(_format_power))
    axis.yaxis.set_minor_formatter(NullFormatter())


def _format_power(value: float, _position: int) -> str:
    """Format a power of ten as plain text, such as 10⁻³.

    If the labels were formulas, typesetting them would take a fifth of the time of a report.
    """
    return "10" + str(round(math.log10(value))).translate(SUPERSCRIPTS) if value > 0.0 else ""


def add_legend(axis: Axes, columns: int = 4, **options: object) -> None:
    """Add a legend above the axes at the right, where it does not overlap titles and labels.

    It has as many columns as fit into the figure, at most `columns`. If the top margin of the
    figure is too small for the legend, it is enlarged.
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
    # extent of the legend, px, and its upward shift, points
    box, up = found.get_window_extent(), 0.0
    if box.x0 < axis.get_window_extent().x0:
        # The upper half of the number at the top of the axis needs space below the legend.
        up = 0.6 * axis.yaxis.get_ticklabels()[0].get_fontsize()
    if any(t.get_text() and box.overlaps(t.get_window_extent()) for t in titles):
        up = plt.rcParams["axes.titlepad"] + 1.2 * titles[0].get_fontsize()
    if up:
        _shorten_legend(make_legend(count, up), right - EDGE_MARGIN)
    if axis.get_subplotspec().is_first_row():
        above = (1.0 - axis.get_position().y1) * figure.get_figheight()
        _grow_margins(figure, above=max(box.height / figure.dpi + up / 72.0 + 0.04 - above, 0.0))


def add_legend_below(figure: Figure, columns: int, handles: Sequence[Artist] | None = None) -> None:
    """Add a legend at the centre below all axes.

    The bottom margin has space for one line of the legend. It is enlarged by the height of further
    lines.

    Args:
        figure: figure of the axes.
        columns: largest number of columns.
        handles: entries of the legend; by default those of all axes.
    """
    if handles is None:
        handles = [handle for axis in figure.axes for handle in axis.get_legend_handles_labels()[0]]
    max_width = figure.get_figwidth() * figure.dpi - 2.0 * EDGE_MARGIN

    def make_legend(count: int) -> Legend:
        for old_legend in figure.legends[:]:
            old_legend.remove()
        return figure.legend(handles=handles, loc="lower center", ncols=count)

    found, count = _fit_legend(make_legend, min(columns, len(handles)), max_width)
    lines = -(-len(handles) // count)
    _grow_margins(figure, below=found.get_window_extent().height / figure.dpi * (lines - 1) / lines)


def _fit_legend(
    make_legend: Callable[[int], Legend], columns: int, max_width: float
) -> tuple[Legend, int]:
    """Make a legend with as many columns as fit into `max_width` px, at most `columns`.

    make_legend: function that makes a legend with a number of columns.

    Returns:
        The legend and its number of columns.
    """
    for count in range(columns, 0, -1):
        found = make_legend(count)
        if found.get_window_extent().width <= max_width:
            break
    _shorten_legend(found, max_width)
    return found, count


def _shorten_legend(legend: Legend, max_width: float) -> None:
    """Shorten the texts of a legend if it is wider than `max_width` px."""
    width = legend.get_window_extent().width
    longest = max(len(text.get_text()) for text in legend.get_texts())
    if width > max_width:
        max_length = max(int(longest * max_width / width) - 3, 1)
        for text in legend.get_texts():
            if len(text.get_text()) > max_length:
                text.set_text(text.get_text()[:max_length].rstrip("\\") + "…")


def _grow_margins(figure: Figure, above: float = 0.0, below: float = 0.0) -> None:
    """Enlarge the top and bottom margins of a figure, inches, without changing its axes."""
    old_height, grid = figure.get_figheight(), figure.axes[0].get_gridspec()
    top, bottom = (1.0 - grid.top) * old_height + above, grid.bottom * old_height + below
    height = old_height + above + below
    figure.set_figheight(height)
    _set_margins(figure, 1.0 - top / height, bottom / height)


def _set_margins(figure: Figure, top: float, bottom: float, gap: float | None = None) -> None:
    """Set the edges of the rows of axes and the gap between rows, as GridSpec.update does.

    GridSpec.update itself moves only the axes of figures that pyplot manages.
    """
    grid = figure.axes[0].get_gridspec()
    grid.update(top=top, bottom=bottom, **({} if gap is None else {"hspace": gap}))
    for axis in figure.axes:
        if axis.get_subplotspec() is not None:
            axis.set_position(axis.get_subplotspec().get_position(figure))
