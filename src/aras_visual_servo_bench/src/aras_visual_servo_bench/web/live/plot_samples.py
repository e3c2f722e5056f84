"""Samples of the live page's plots: the whole run, in a limited number of samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from aras_visual_servo_controller.records.state import RunStartDetector

# Largest number of samples: 100 s at 30 images/s. A plot has fewer pixels, and a full message with
# 20 numbers per sample has about 0.5 MB.
MAX_SAMPLES = 3000
CLEAR = ["clear"]  # row in a list of samples: a page that receives it removes all earlier samples
# change of the stamp between two samples, s; below it, the clock was reset, so the plots restart
CLOCK_RESET = -1.0


def to_json_numbers(values: Sequence[float], digits: int = 6) -> list[float | None]:
    """Round numbers for JSON; infinity and NaN become null."""
    return [round(float(v), digits) if math.isfinite(v) else None for v in values]


class PlotSamples:
    """Samples of the current run, from its start to the present.

    A sample is [stamp, errors, desired twist, achieved twist, joint positions]. If there are more
    than MAX_SAMPLES, those that change the curves least are removed. Therefore even in a long run,
    the curves of its first seconds keep their shape.

    Attributes:
        names: names of the features in the last image with features.
    """

    def __init__(self) -> None:
        self.names: tuple[str, ...] = ()
        self._run_starts = RunStartDetector()
        self._rows: list[list[Any]] = []
        self._news: list[Any] = []

    @property
    def rows(self) -> list[list[Any]]:
        """All samples, oldest first."""
        return list(self._rows)

    def add(self, phase: str, names: tuple[str, ...], row: list[Any]) -> None:
        """Add a sample; at the start of another run, first remove the samples of the run before it.

        Another run starts when the controller starts an approach or servoing, when the features
        change, or when the clock is set back.

        Args:
            phase: phase of the controller.
            names: names of the features; empty for an image without features, which does not start
                another run.
            row: the sample.
        """
        is_other = bool(names and self.names and names != self.names)
        is_other = self._run_starts.is_start(phase) or is_other
        if self._rows and (is_other or row[0] - self._rows[-1][0] < CLOCK_RESET):
            self._rows, self._news = [], [CLEAR]
        self.names = names or self.names
        self._rows.append(row)
        self._news.append(row)
        if len(self._rows) > MAX_SAMPLES:
            self._rows = thin_out(self._rows)
            self._news = [CLEAR, *self._rows]

    def take_news(self) -> list[Any]:
        """Return the samples that were added since the last call.

        If older samples were removed since then, return CLEAR and then all samples of the run.
        """
        news, self._news = self._news, []
        return news


def thin_out(rows: list[list[Any]]) -> list[list[Any]]:
    """Return a quarter fewer samples, without those that change the curves least.

    Every other sample is a candidate for removal. At each candidate, the distance of each curve
    from the straight line between the two neighbouring samples is divided by the range of the
    curve. The candidates whose largest quotient is smallest are removed. Samples where a curve
    begins or ends are kept.
    """
    width = max(len(row[1]) for row in rows)
    values = np.array(
        [[*row[1], *[None] * (width - len(row[1])), *row[2], *row[3]] for row in rows], float
    )
    times = np.array([row[0] for row in rows])
    finite = np.isfinite(values)
    low = np.min(values, axis=0, where=finite, initial=math.inf)
    high = np.max(values, axis=0, where=finite, initial=-math.inf)
    span = np.where(high > low, high - low, 1.0)
    inner = np.arange(1, len(rows) - 1, 2)
    before, after = inner - 1, inner + 1
    duration = times[after] - times[before]
    part = np.where(duration > 0.0, times[inner] - times[before], 0.5) / np.where(
        duration > 0.0, duration, 1.0
    )
    line = values[before] + part[:, None] * (values[after] - values[before])
    change = np.abs(values[inner] - line) / span
    has_edge = (finite[before] != finite[inner]) | (finite[inner] != finite[after])
    change = np.where(has_edge, math.inf, np.where(finite[inner], change, 0.0)).max(axis=1)
    removed = set(inner[np.argsort(change, kind="stable")[: len(rows) // 4]].tolist())
    return [row for i, row in enumerate(rows) if i not in removed]
