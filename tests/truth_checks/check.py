"""One check, and the list of all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """A line of the table.

    what: compared quantity. expected: what it should be, in words. measured: the worst found, in
    `unit`; bound: what it may be at most.
    """

    what: str
    expected: str
    measured: float
    bound: float
    unit: str = ""

    @property
    def passed(self) -> bool:
        """Whether the measured number is within its bound; NaN is not."""
        return self.measured <= self.bound


@dataclass(frozen=True)
class Check:
    """A group of rows from one function.

    against: what it is compared with. quick: cheap enough (a second or two) for CI.
    """

    name: str
    against: str
    quick: bool
    rows: Callable[[], Iterator[Row]]


CHECKS: dict[str, Check] = {}


def check(against: str, quick: bool = False) -> Callable[[Callable[[], Iterator[Row]]],
                                                         Callable[[], Iterator[Row]]]:
    """Enter a generator of rows into CHECKS under its own name."""
    def enter(function: Callable[[], Iterator[Row]]) -> Callable[[], Iterator[Row]]:
        name = function.__name__.replace("_", " ")
        CHECKS[name] = Check(name, against, quick, function)
        return function

    return enter
