"""Formatting of numbers in tables, pages, figures and on the screen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

NO_NUMBER = "–"  # text for NaN
DIGITS = 3
# Range of the largest number of a group that is printed without powers of ten.
MIN_PLAIN, MAX_PLAIN = 1e-3, 1e5
MIN_FIXED_POINT = 1e-5  # smallest number of such a group; below it there are too many zeros
NEARLY_ZERO = "≈0"  # negligible compared with the largest number; "0" is exactly 0
NEGLIGIBLE_DECADES = 6  # numbers this many decades below the largest are negligible

# Prefixes of units by decreasing size; the unit is the first in which a value is at least 0.1.
PREFIXES = (("", 1.0), ("m", 1e-3), ("µ", 1e-6))
MIN_IN_UNIT = 0.1
SCALABLE_UNITS = {"m": ("m", 1.0), "m/s": ("m/s", 1.0), "s": ("s", 1.0), "ms": ("s", 1e-3)}
ANGLE_UNITS = {"rad": "°", "rad/s": "°/s"}  # shown in degrees, as tolerances are


def make_printable(text: object) -> str:
    """Return a text that can be encoded; characters of file names that are not UTF-8 become '?'."""
    return str(text).encode("utf-8", "replace").decode()


def make_number_format(values: Iterable[float], digits: int = DIGITS) -> Callable[[float], str]:
    """Return a function that formats the numbers of a group uniformly.

    All numbers are printed with powers of ten, or none of them.

    Args:
        values: numbers of the group, e.g. of a row or column; values that are not finite are
            ignored.
        digits: number of significant digits.
    """
    sizes = [abs(v) for v in values if math.isfinite(v)]
    largest = max(sizes, default=0.0)
    negligible = (
        0.5 * 10.0 ** (math.floor(math.log10(largest)) - NEGLIGIBLE_DECADES) if largest else 0.0
    )
    smallest = min((size for size in sizes if size > negligible), default=MIN_PLAIN)
    has_exponent = largest > 0.0 and not (
        MIN_PLAIN <= largest < MAX_PLAIN and smallest >= MIN_FIXED_POINT
    )

    def format_number(value: float) -> str:
        if math.isnan(value):
            return NO_NUMBER
        if math.isinf(value):
            return "-∞" if value < 0.0 else "∞"
        if abs(value) <= negligible:
            return NEARLY_ZERO if value else "0"
        if has_exponent:
            return f"{value:.{digits - 1}e}"
        decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
        text = f"{value:.{decimals}f}"
        return text.rstrip("0").rstrip(".") if decimals else text

    return format_number


def format_number(value: float, digits: int = DIGITS) -> str:
    """Format a single number."""
    return make_number_format((value,), digits)(value)


def format_value(value: object) -> str:
    """Format the value of a setting; values other than floats are printed as they are."""
    return format_number(value) if isinstance(value, float) else str(value)


def choose_unit(unit: str, values: Iterable[float]) -> tuple[str, float]:
    """Return the unit that suits the values, and its size.

    The magnitude of the values is the geometric mean of the largest and the smallest; zero,
    negligible and unknown values have no influence. The unit is the largest of m, mm and µm in
    which it is at least 0.1, and likewise for s and m/s. Angles are in degrees. Other units do not
    change.

    Args:
        unit: of the values.
        values: numbers that are shown together.

    Returns:
        The new unit, and its size in the old unit: divide the values by it.
    """
    if unit in ANGLE_UNITS:
        return ANGLE_UNITS[unit], math.pi / 180.0
    base, size = SCALABLE_UNITS.get(unit, (unit, 0.0))
    sizes = [abs(v) * size for v in values if math.isfinite(v) and v]
    if not size or not sizes:
        return unit, 1.0
    largest = max(sizes)
    smallest = min(s for s in sizes if s >= largest * 10.0**-NEGLIGIBLE_DECADES)
    magnitude = math.sqrt(largest) * math.sqrt(smallest)
    prefix, scale = next(
        (one for one in PREFIXES if magnitude >= MIN_IN_UNIT * one[1]), PREFIXES[-1]
    )
    return prefix + base, scale / size


def format_in_unit(value: float, unit: str) -> str:
    """Return a value with a unit that suits its magnitude."""
    unit, size = choose_unit(unit, [value])
    return format_quantity(format_number(value / size), unit)


def format_heading(name: str, unit: str) -> str:
    """Return the heading of a column or the label of an axis."""
    return f"{name} ({unit})" if unit else name


def format_quantity(value: object, unit: str) -> str:
    """Return a value with its unit."""
    return f"{value}{'' if unit.startswith('°') else ' '}{unit}" if unit else str(value)
