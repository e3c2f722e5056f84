"""Comparison of the simulator with independent software, and the registry of all checks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One row of the table.

    what: compared quantity. expected: its expected value, as text. measured: the largest deviation
    found, in `unit`. bound: the largest deviation allowed.
    """

    what: str
    expected: str
    measured: float
    bound: float
    unit: str = ""

    @property
    def passed(self) -> bool:
        """True if the measured value is within its bound; False for NaN."""
        return self.measured <= self.bound


@dataclass(frozen=True)
class Check:
    """A group of rows from one function.

    against: reference of the comparison. quick: fast enough (a second or two) for CI.
    """

    name: str
    against: str
    quick: bool
    rows: Callable[[], Iterator[Row]]


CHECKS: dict[str, Check] = {}


def check(against: str, quick: bool = False) -> Callable[[Callable[[], Iterator[Row]]],
                                                         Callable[[], Iterator[Row]]]:
    """Register a generator of rows in CHECKS under its own name."""
    def register(function: Callable[[], Iterator[Row]]) -> Callable[[], Iterator[Row]]:
        name = function.__name__.replace("_", " ")
        CHECKS[name] = Check(name, against, quick, function)
        return function

    return register
