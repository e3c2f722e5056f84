"""Metric: a function that describes a run by one number, with a unit and a formula.

A metric of your own is a function with the decorator `metric`, and its name is
'package.module:function':

    @metric(unit="m", better="smaller", source="this paper, equation 3")
    def closest(run: Run) -> float: ...
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import StudyError
from ..recording.run import Run

SMALLER, GREATER, NEITHER = "smaller", "greater", ""


@dataclass(frozen=True)
class Metric:
    """A function of a run that returns a number, or NaN if the run has no such number.

    name: name of the metric, and of its column in the results.
    unit: unit of the number; '' if it has none.
    better: 'smaller', 'greater', or '' if neither is better.
    source: formula, or reference of the formula.
    measure: function that computes the number from a run.
    is_feature_based: True if the number depends on the features of the scheme, so that it cannot be
        compared between schemes.
    default: True if this metric is computed in studies that do not choose their metrics.
    is_binary: True if the number is 0 or 1, so that runs are summarised by the rate of 1.
    has_tolerance: True if the number depends on how near to its goal a camera must be to have
        reached it.
    """

    name: str
    unit: str
    better: str
    source: str
    measure: Callable[[Run], float]
    is_feature_based: bool = False
    default: bool = False
    is_binary: bool = False
    has_tolerance: bool = False

    @property
    def text(self) -> str:
        """One-line description of the metric."""
        return (self.measure.__doc__ or "").strip().splitlines()[0]

    def complete_values(self, values: np.ndarray) -> np.ndarray:
        """Return the values (n,) of n runs; in a binary metric, an unknown value may become 0.

        An unknown value (NaN) of a binary metric becomes 0 if 1 is better: a run that did not start
        or raised an error has not reached its goal. Other unknown values remain NaN.

        Raises:
            StudyError: the metric is binary, and a value is neither 0, 1 nor NaN.
        """
        if not self.is_binary:
            return values
        unknown = np.isnan(values)
        wrong = values[~unknown & (values != 0.0) & (values != 1.0)]
        if wrong.size:
            raise StudyError(
                f"metric {self.name} is declared as binary, but a run has the value {wrong[0]:g}: "
                "return 0, 1 or NaN, or remove is_binary=True"
            )
        return np.where(unknown, 0.0, values) if self.better == GREATER else values


def metric(
    unit: str, better: str, source: str, is_feature_based: bool = False, default: bool = False,
    is_binary: bool = False, has_tolerance: bool = False,
) -> Callable[[Callable], Metric]:
    """Return a decorator that makes a Metric of a function that computes a number from a Run.

    The name of the function is the name of the metric and of its column in results. The first line
    of its docstring is the description.

    Args:
        unit: unit of the number; '' if it has none.
        better: 'smaller', 'greater', or '' if neither is better.
        source: formula, or reference of the formula.
        is_feature_based: True if the number depends on the features of the scheme, so that it
            cannot be compared between schemes.
        default: True if this metric is computed in studies that do not choose their metrics.
        is_binary: True if the number is 0 or 1; tables and figures then show the rate of 1.
        has_tolerance: True if the number depends on how near to its goal a camera must be to have
            reached it; captions of tables and figures then state this tolerance.

    Raises:
        StudyError: `better` has another value, or a binary metric has a unit.
    """
    if better not in (SMALLER, GREATER, NEITHER):
        raise StudyError(f"better is '{better}', must be '{SMALLER}', '{GREATER}' or ''")
    if is_binary and unit:
        raise StudyError(f"a binary metric has no unit: remove '{unit}'")
    return lambda measure: Metric(
        measure.__name__, unit, better, source, measure, is_feature_based, default, is_binary,
        has_tolerance,
    )  # fmt: skip
