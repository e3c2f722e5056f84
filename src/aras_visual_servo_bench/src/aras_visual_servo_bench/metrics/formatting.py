"""How numbers are printed: in tables, on pages, in figures and on the screen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

NO_NUMBER = "–"  # where there is no number
DIGITS = 3
# of the largest of some numbers that are printed without powers of ten
MIN_PLAIN, MAX_PLAIN = 1e-3, 1e5
MIN_FIXED_POINT = 1e-5  # that stands beside these; below it nobody counts the zeros
NEARLY_ZERO = "≈0"  # beside the largest; a 0 is exactly 0
NEGLIGIBLE_DECADES = 6  # decades below the largest, from which on a number is next to nothing


def make_printable(text: object) -> str:
    """As a text that can be written: what is no UTF-8 in a file's name becomes '?'."""
    return str(text).encode("utf-8", "replace").decode()


def make_number_format(values: Iterable[float], digits: int = DIGITS) -> Callable[[float], str]:
    """How to print numbers that stand together: all of them with powers of ten, or none.

    Args:
        values: of a cell, row or column; those that are not finite do not matter.
        digits: significant ones.
    """
    sizes = [abs(v) for v in values if math.isfinite(v)]
    largest = max(sizes, default=0.0)
    nothing = (
        0.5 * 10.0 ** (math.floor(math.log10(largest)) - NEGLIGIBLE_DECADES) if largest else 0.0
    )
    smallest = min((size for size in sizes if size > nothing), default=MIN_PLAIN)
    raised = largest > 0.0 and not (
        MIN_PLAIN <= largest < MAX_PLAIN and smallest >= MIN_FIXED_POINT
    )

    def format_number(value: float) -> str:
        if math.isnan(value):
            return NO_NUMBER
        if math.isinf(value):
            return "-∞" if value < 0.0 else "∞"
        if abs(value) <= nothing:
            return NEARLY_ZERO if value else "0"
        if raised:
            return f"{value:.{digits - 1}e}"
        decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
        text = f"{value:.{decimals}f}"
        return text.rstrip("0").rstrip(".") if decimals else text

    return format_number


def format_number(value: float, digits: int = DIGITS) -> str:
    """One number that stands alone."""
    return make_number_format((value,), digits)(value)


def format_value(value: object) -> str:
    """A setting's value: a number as all numbers, anything else as it is."""
    return format_number(value) if isinstance(value, float) else str(value)


def format_heading(name: str, unit: str) -> str:
    """What stands over a column, or beside an axis."""
    return f"{name} ({unit})" if unit else name


def format_quantity(value: object, unit: str) -> str:
    """A value with its unit."""
    return f"{value} {unit}" if unit else str(value)
