"""Formatting of numbers in tables, pages, figures and on the screen."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np

NO_NUMBER = "–"  # text for NaN
DIGITS = 3
MAX_LINE = 120  # maximum number of characters of the text in each line of `format_rows`
# Numbers are printed without powers of ten if the largest of them is between MIN_PLAIN and
# MAX_PLAIN, and the smallest is at least MIN_FIXED_POINT.
MIN_PLAIN, MAX_PLAIN = 1e-3, 1e5
MIN_FIXED_POINT = 1e-5
NEARLY_ZERO = "≈0"  # text of a number that is negligible compared with the largest of its group
# A number is negligible if it is this many decades smaller than the largest number of its group.
NEGLIGIBLE_DECADES = 6

# Prefixes of units, largest first, with their factors. A quantity is shown with the largest prefix
# with which a typical number is at least MIN_IN_UNIT, or the largest number at least MAX_IN_UNIT
# with the next prefix.
PREFIXES = (("", 1.0), ("m", 1e-3), ("µ", 1e-6))
MIN_IN_UNIT, MAX_IN_UNIT = 0.1, 1e4
SCALABLE_UNITS = {"m": ("m", 1.0), "m/s": ("m/s", 1.0), "s": ("s", 1.0), "ms": ("s", 1e-3)}
# unit in which an angle or an angular velocity is shown, by its SI unit
ANGLE_UNITS = {"rad": "°", "rad/s": "°/s"}


def make_printable(text: object) -> str:
    """Return a text that can be encoded as UTF-8; invalid characters of file names become '?'."""
    return str(text).encode("utf-8", "replace").decode()


def make_number_format(values: Iterable[float], digits: int = DIGITS) -> Callable[[float], str]:
    """Return a function that gives all numbers of a group the same format.

    Either all numbers or none of them are printed with powers of ten.

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
    """Format the value of a setting: round a float, and print other values unchanged."""
    return format_number(value) if isinstance(value, float) else str(value)


def choose_unit(unit: str, values: Sequence[float] | np.ndarray) -> tuple[str, float]:
    """Choose the unit in which values are shown.

    Angles are shown in degrees. A length is shown in m, mm or µm, and a time or speed in units with
    the same prefixes. The largest unit is chosen in which a typical value is at least 0.1; a
    smaller unit is not chosen if the largest value would be 10 000 or more in it. The typical value
    is the geometric mean of the largest and the smallest value; negligible values are ignored.
    Other units do not change.

    Args:
        unit: unit of the values.
        values: numbers that are shown together.

    Returns:
        The new unit, and the factor by which the values must be divided.
    """
    if unit in ANGLE_UNITS:
        return ANGLE_UNITS[unit], math.pi / 180.0
    if unit not in SCALABLE_UNITS:
        return unit, 1.0
    base, size = SCALABLE_UNITS[unit]
    sizes = np.abs(np.asarray(values, float)) * size
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if not sizes.size:
        return unit, 1.0
    largest = sizes.max()
    smallest = sizes[sizes >= largest * 10.0**-NEGLIGIBLE_DECADES].min()
    magnitude = math.sqrt(largest) * math.sqrt(smallest)
    prefix, scale = next(
        (one for one, (_, next_scale) in pairwise(PREFIXES)
         if magnitude >= MIN_IN_UNIT * one[1] or largest >= MAX_IN_UNIT * next_scale),
        PREFIXES[-1],
    )  # fmt: skip
    return prefix + base, scale / size


def format_in_unit(value: float, unit: str) -> str:
    """Return a value as text, in the unit that `choose_unit` chooses for its magnitude."""
    unit, size = choose_unit(unit, [value])
    return format_quantity(format_number(value / size), unit)


def format_heading(name: str, unit: str) -> str:
    """Return the heading of a column or the label of an axis: the name and the unit."""
    return f"{name} ({unit})" if unit else name


def format_quantity(value: object, unit: str) -> str:
    """Return a value with its unit, as text."""
    return f"{value}{'' if unit.startswith('°') else ' '}{unit}" if unit else str(value)


def format_count(number: int, what: str) -> str:
    """Return a number with its noun, such as '1 run' or '2 runs'."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def format_rows(rows: Mapping[str, str]) -> str:
    """Return one line 'title: text' for each title; shorten long texts, and omit empty ones."""
    return "\n".join(
        f"{'  ' if i else ''}{title}: {textwrap.shorten(text, MAX_LINE, placeholder=' …')}"
        for i, (title, text) in enumerate(rows.items()) if text
    )  # fmt: skip
