"""What all curves over time share: their axis, the lines on it, gaps, one look a run."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from ..pictures.palette import COLOURS, FAINT, GOAL, GOOD, INK
from ..pictures.style import TIME
from ..recording.run import Run

LONGEST, PERIODS = 0.3, 5.0  # s, and median steps, after which a curve is not joined any more
MARKERS = ("o", "s", "^", "D", "v", "P")  # of runs, along their curves
MARKED = 0.125  # of an axis' size, along a curve from one marker to the next
THICKER = 0.7  # part by which the first of several curves is thicker than the last
RIGHT = 0.75  # part of the axis behind which words stand to the left of their line


def curve(axis: Axes, time: np.ndarray, values: np.ndarray, **style: object) -> None:
    """A curve of values (n,) over time (n,), open where nothing was measured for long."""
    axis.plot(*broken(time, values), **style)


def broken(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same curve with a NaN within each step of time that is long beside the others."""
    steps = np.diff(time)
    if not len(steps):
        return time, values
    at = np.flatnonzero(steps > max(LONGEST, PERIODS * float(np.median(steps))))
    return np.insert(time, at + 1, time[at] + 0.5 * steps[at]), np.insert(values, at + 1, np.nan)


def zero(axis: Axes) -> None:
    """The line that errors end on."""
    axis.axhline(0.0, color=FAINT, lw=0.8, zorder=1)


def times(axes: Sequence[Axes], runs: Sequence[Run], label: str = TIME) -> None:
    """Label and range of a column of axes."""
    axes[-1].set_xlabel(label)
    axes[-1].set_xlim(0.0, end(runs))


def end(runs: Sequence[Run]) -> float:
    """Of the axis, s since servoing began."""
    return max([1e-3, *(float(r.time[-1]) for r in runs if len(r.time))])


def settled_mark(axis: Axes, run: Run, settled: float) -> None:
    """When what the axis shows had settled, s; not finite: never."""
    if np.isfinite(settled):
        left = settled > RIGHT * end([run])
        axis.axvline(settled, color=GOAL, ls=":", lw=1.2)
        axis.annotate(
            f"settled after {settled:.2f} s", (settled, 1.0), xycoords=("data", "axes fraction"),
            xytext=(-4 if left else 4, -3), textcoords="offset points", color=GOOD, va="top",
            ha="right" if left else "left",
        )  # fmt: skip


def looks(count: int) -> list[dict[str, object]]:
    """How the curves of each of so many runs are drawn; one alone needs neither colour nor marker.

    Markers tell runs apart without colour. Earlier curves are thicker, and the markers of each have
    places of their own, so that curves that coincide are all to be seen.
    """
    if count == 1:
        return [{"color": INK}]
    width = plt.rcParams["lines.linewidth"]
    return [
        {
            "color": COLOURS[i % len(COLOURS)], "alpha": 0.9,
            "marker": MARKERS[(i + i // len(COLOURS)) % len(MARKERS)], "mew": 0.0,
            "ms": 4.2 * width, "markevery": (MARKED * i / count, MARKED),
            "lw": width * (1.0 + THICKER * (count - 1 - i) / (count - 1)),
        }
        for i in range(count)
    ]  # fmt: skip
