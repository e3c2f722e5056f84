"""What all curves over time share: their axis, the lines on it, gaps, one colour a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ..pictures.palette import COLOURS, FAINT, GOAL, GOOD, INK
from ..pictures.style import TIME
from ..recording.run import Run

LONGEST, PERIODS = 0.3, 5.0  # s, and median steps, after which a curve is not joined any more
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
    axes[-1].set_xlim(0.0, _end(runs))


def _end(runs: Sequence[Run]) -> float:
    return max([1e-3, *(float(r.time[-1]) for r in runs if len(r.time))])


def settled_mark(axis: Axes, run: Run, settled: float) -> None:
    """When what the axis shows had settled, s; not finite: never."""
    if np.isfinite(settled):
        left = settled > RIGHT * _end([run])
        axis.axvline(settled, color=GOAL, ls=":", lw=1.2)
        axis.annotate(
            f"settled after {settled:.2f} s", (settled, 1.0), xycoords=("data", "axes fraction"),
            xytext=(-4 if left else 4, -3), textcoords="offset points", color=GOOD, va="top",
            ha="right" if left else "left",
        )  # fmt: skip


def colours(runs: Sequence[Run]) -> list[str]:
    """Of each run; one alone needs none."""
    return [INK] if len(runs) == 1 else [COLOURS[i % len(COLOURS)] for i in range(len(runs))]
