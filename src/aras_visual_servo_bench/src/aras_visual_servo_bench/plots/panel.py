"""Panel: curves over time that share an axis."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

MAX_CURVES = 24  # largest number of curves in a panel that a reader can distinguish
# A curve is interrupted between two points if the time between them is longer than MAX_GAP_TIME
# (s), and longer than MAX_GAP_PERIODS times the median time between points.
MAX_GAP_TIME, MAX_GAP_PERIODS = 0.3, 5.0


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a panel.

    Attributes:
        name: name of the quantity or of the run.
        time: (n,) times since servoing started, s.
        values: (n,) values at these times; NaN if unknown.
        run: index of the run.
        colour_index: index of the colour.
        dashed: True for a curve of desired values in a panel with achieved values.
        is_pale: True for a curve of measured values in a panel with filtered values.
    """

    name: str
    time: np.ndarray
    values: np.ndarray
    run: int = 0
    colour_index: int = 0
    dashed: bool = False
    is_pale: bool = False

    def insert_gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the times and values, with the value NaN in the middle of each long time step.

        The NaN interrupts the drawn curve.
        """
        steps = np.diff(self.time)
        if not len(steps):
            return self.time, self.values
        longest = max(MAX_GAP_TIME, MAX_GAP_PERIODS * float(np.median(steps)))
        indices = np.flatnonzero(steps > longest)
        time = np.insert(self.time, indices + 1, self.time[indices] + 0.5 * steps[indices])
        return time, np.insert(self.values, indices + 1, np.nan)


Texts = tuple[tuple[float, str], ...]  # values on the axis of a panel, each with its label


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over time that share an axis.

    Attributes:
        title: name of the quantity, without its unit.
        axis: short label of the axis in figures.
        unit: unit of the values.
        curves: curves of the panel.
        is_logarithmic: True for a logarithmic axis of the values.
        is_dotted: True if the values are drawn as dots that are not connected.
        dashed: text that says what dashed curves mean.
        band: tolerance of the values; a band from -band to band is drawn. None for no band.
        levels: values at which a horizontal line is drawn, with their labels.
        limits: limits of the values, such as joint limits, with their labels.
        marks: times that are marked, s, with their labels.
        span: lower and upper value that the axis must contain; either is None if the curves
            determine this end of the axis.
        omitted_curves: number of curves that are not shown because there are too many.
    """

    title: str
    axis: str
    unit: str
    curves: tuple[Curve, ...]
    is_logarithmic: bool = False
    is_dotted: bool = False
    dashed: str = ""
    band: float | None = None
    levels: Texts = ()
    limits: Texts = ()
    marks: Texts = ()
    span: tuple[float | None, float | None] = (None, None)
    omitted_curves: int = 0


def make_panel(
    title: str, axis: str, unit: str, curves: Iterable[Curve], **more: object
) -> list[Panel]:
    """Return a list with one panel; return an empty list if no curve has values.

    The panel contains the curves that have values. If there are more than MAX_CURVES, it contains
    those with the largest range of values. `more` are other attributes of Panel.
    """
    known = [curve for curve in curves if np.isfinite(curve.values).any()]
    if not known:
        return []
    shown = known
    if len(known) > MAX_CURVES:
        changes = [-float(np.nanmax(c.values) - np.nanmin(c.values)) for c in known]
        shown = [known[i] for i in sorted(np.argsort(changes, kind="stable")[:MAX_CURVES])]
    return [Panel(title, axis, unit, tuple(shown), omitted_curves=len(known) - len(shown), **more)]
