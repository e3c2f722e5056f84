"""Conversion, checks and descriptions of setting values before they become settings."""

from __future__ import annotations

import contextlib
import math
import numbers
import operator
import os
import re
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .names import suggest

Fault = type[Exception]
_TYPE_NAMES = {
    float: "a finite number", int: "a whole number", bool: "true or false", str: "a text",
    Path: "a path",
}  # fmt: skip
# An unquoted number of YAML 1.2 that YAML 1.1 reads as a text.
_TEXT_NUMBER = re.compile(r"[-+]?(\.\d+([eE][-+]?\d+)?|\d+(\.\d*)?[eE][-+]?\d+)", re.ASCII)
LONGEST_VALUE = 200  # characters of a value that a message shows


def as_number(value: Any, infinite: bool = False) -> float | None:
    """Return a value as a finite number (or infinite, if allowed); None if it is not a number."""
    if isinstance(value, str) and _TEXT_NUMBER.fullmatch(value):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) or infinite and math.isinf(number) else None


def convert_to_file_types(value: Any) -> Any:
    """Return the lists, numbers and texts that represent a Python value in a file."""
    if isinstance(value, Mapping):
        return {key: convert_to_file_types(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        items = list(map(convert_to_file_types, value))
        return items if any(map(operator.is_not, items, value)) else value
    if isinstance(value, range):
        return list(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if not isinstance(value, type) and hasattr(value, "tolist"):  # NumPy's arrays and numbers
        return value.tolist()
    return value


def parse_word(word: str) -> float | str:
    """Return a word as a number if possible, otherwise the word."""
    with contextlib.suppress(ValueError):
        return float(word)
    return word


def check_value(value: Any, where: str, fault: Fault, rules: Mapping[str, Any]) -> None:
    """Check a value, or each value in a list or mapping, against the bounds of `parameter`.

    Raises:
        fault: a value is out of bounds; the message names the value and the bound.
    """
    if not rules:
        return
    if isinstance(value, tuple):
        for i, item in enumerate(value):
            check_value(item, f"{where}[{i}]", fault, rules)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            check_value(item, join_path(where, key), fault, rules)
    elif isinstance(value, str):
        if value in (renamed := rules.get("renamed", {})):
            raise fault(f"{where}: '{value}' is now called '{renamed[value]}'")
        if (known := rules.get("choices")) and value not in known:
            raise fault(f"{where} is {format_value(value)}: {suggest(value, known)}")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        for name, sign, holds in _BOUNDS:
            if (bound := rules.get(name)) is not None and not holds(value, bound):
                unit = rules.get("unit") or ""
                text = unit if unit[:1] in ("", ",") else f" {unit}"
                if sign == "<=" and unit in _COMMON_UNIT_MISTAKES:
                    other, size = _COMMON_UNIT_MISTAKES[unit]
                    text += f" ({value:g} {other} are {value * size:.4g} {unit})"
                raise fault(f"{where} is {value}, must be {sign} {bound:g}{text}")


# Wrong unit in which a number that is too large may be given: name and size, by the correct unit.
_COMMON_UNIT_MISTAKES = {"rad": ("degrees", math.pi / 180.0), "s": ("ms", 1e-3)}
_BOUNDS = (
    ("least", ">=", lambda value, bound: value >= bound),
    ("above", ">", lambda value, bound: value > bound),
    ("most", "<=", lambda value, bound: value <= bound),
    ("below", "<", lambda value, bound: value < bound),
)


def format_value(value: Any) -> str:
    """Return a value as text for a message, shortened if it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python does not convert numbers with thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


def join_path(where: str, key: Any) -> str:
    """Return the full path of a key below `where`."""
    return f"{where}.{key}" if where and where[-1] not in " ~/" else f"{where}{key}"


def describe_hint(hint: Any) -> str:
    """Return a description of the values that an annotation accepts, such as 'a finite number'."""
    if hint in _TYPE_NAMES:
        return _TYPE_NAMES[hint]
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        kinds = dict.fromkeys(describe_hint(part) for part in parts if part is not type(None))
        return " or ".join(kinds)
    if origin is tuple:
        of = {float: "finite numbers", int: "whole numbers", str: "texts"}.get(parts[0], "values")
        return f"a list of {of}" if Ellipsis in parts else f"a list of {len(parts)} {of}"
    return "keys with values"


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with `changes` applied, key by key at every depth; other keys stay.

    A mapping replaces a value without keys, and the reverse. The arguments are not modified.
    """
    merged = dict(base)
    for key, value in changes.items():
        below = merged.get(key)
        both = isinstance(below, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(below, value) if both else value
    return merged


def find_value(values: Mapping[str, Any], path: str) -> Any:
    """Return the value at 'a/b/c'; None if a key is missing or a value is not a mapping."""
    node: Any = values
    for key in path.strip("/").split("/"):
        if not isinstance(node, Mapping) or key not in node:
            return None
        node = node[key]
    return node
