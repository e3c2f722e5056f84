"""Conversion, checks and descriptions of the values of settings."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import numbers
import operator
import os
import re
import types
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from .names import Fault, suggest

NOTHING: Mapping[str, Any] = types.MappingProxyType({})
_TYPE_NAMES = {
    float: "a finite number", int: "a whole number", bool: "true or false", str: "a text",
    Path: "a path",
}  # fmt: skip
# Numbers such as 1e1 and -.5, which are numbers in YAML 1.2 but texts in YAML 1.1.
_TEXT_NUMBER = re.compile(r"[-+]?(\.\d+([eE][-+]?\d+)?|\d+(\.\d*)?[eE][-+]?\d+)", re.ASCII)
_PLAIN_TYPES = {float, int, str, bool, type(None)}  # types of single values in a settings file
LONGEST_VALUE = 200  # largest number of characters of a setting's value in an error message


def as_number(value: Any, infinite: bool = False) -> float | None:
    """Return a finite number (or infinity if `infinite`) as a float; None for any other value."""
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
    """Convert a Python value, such as a NumPy array or a path, to lists, numbers and texts.

    A settings file can contain only these types. Values of other types are returned unchanged.
    """
    if type(value) in _PLAIN_TYPES:
        return value
    if isinstance(value, list | tuple) and set(map(type, value)) <= _PLAIN_TYPES:
        return value
    if isinstance(value, Mapping):
        return {key: convert_to_file_types(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        items = list(map(convert_to_file_types, value))
        return items if any(map(operator.is_not, items, value)) else value
    if isinstance(value, range):
        return list(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    # arrays and numbers of NumPy have the method `tolist`
    if not isinstance(value, type) and hasattr(value, "tolist"):
        return value.tolist()
    return value


def parse_word(word: str) -> float | str:
    """Convert a word to a number if possible; otherwise return the word."""
    with contextlib.suppress(ValueError):
        return float(word)
    return word


def check_value(value: Any, where: str, fault: Fault, rules: Mapping[str, Any]) -> None:
    """Check that a value, or each value in a list or mapping, is valid according to `rules`.

    `rules` are the bounds and choices that `settings.parameter` declares.

    Raises:
        fault: a value is invalid; the message names the value and the bound or choices.
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
        for name, sign, holds in BOUNDS:
            if (bound := rules.get(name)) is not None and not holds(value, bound):
                unit = rules.get("unit") or ""
                text = unit if unit[:1] in ("", ",") else f" {unit}"
                if sign == "<=" and unit in _COMMON_UNIT_MISTAKES:
                    other, size = _COMMON_UNIT_MISTAKES[unit]
                    text += f" ({value:g} {other} are {value * size:.4g} {unit})"
                raise fault(f"{where} is {value}, must be {sign} {bound:g}{text}")


# Units that users confuse. For each correct unit of a setting: the wrong unit, and the size of the
# wrong unit in the correct one. If a number is too large, the message suggests this mistake.
_COMMON_UNIT_MISTAKES = {"rad": ("degrees", math.pi / 180.0), "s": ("ms", 1e-3)}
# Name of each bound in `settings.parameter`, its sign, and the comparison that must be true.
BOUNDS = (
    ("least", ">=", operator.ge), ("above", ">", operator.gt), ("most", "<=", operator.le),
    ("below", "<", operator.lt),
)  # fmt: skip


def format_value(value: Any) -> str:
    """Return a value as a text for a message. Long texts are shortened."""
    try:
        text = repr(value)
    except ValueError:  # Python does not convert numbers with thousands of digits to text
        return "a number of thousands of digits"
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


def join_path(where: str, key: Any) -> str:
    """Return the full path of a key in the mapping whose path is `where`."""
    return f"{where}.{key}" if where and where[-1] not in " ~/" else f"{where}{key}"


def describe_expected(hint: Any, rules: Mapping[str, Any] = NOTHING) -> str:
    """Describe the valid values of a setting, for a message, such as 'a finite number'.

    `hint` is the annotation of the setting, and `rules` are those that `settings.parameter`
    declares.
    """
    if rules.get("expected"):
        return rules["expected"]
    if hint is str and rules.get("choices"):
        return "one of " + ", ".join(rules["choices"])
    if hint is float and rules.get("infinite"):
        return "a number, or .inf"
    if hint in _TYPE_NAMES:
        return _TYPE_NAMES[hint]
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        kinds = (describe_expected(part) for part in parts if part is not type(None))
        return " or ".join(dict.fromkeys(kinds))
    if origin is tuple:
        of = {float: "finite numbers", int: "whole numbers", str: "texts"}.get(parts[0], "values")
        return f"a list of {of}" if Ellipsis in parts else f"a list of {len(parts)} {of}"
    return "a mapping"


def describe_mismatch(
    value: Any, hint: Any, where: str, rules: Mapping[str, Any] = NOTHING
) -> str:
    """Return the message for a value that cannot be converted to the type of the setting."""
    return f"{where} is {format_value(value)}, must be {describe_expected(hint, rules)}"


@functools.lru_cache(maxsize=64)
def list_annotations(cls: type) -> dict[str, Any]:
    """Return the annotations of a dataclass's fields, by name."""
    return typing.get_type_hints(cls)


@functools.lru_cache(maxsize=64)
def list_fields(cls: type) -> dict[str, dataclasses.Field]:
    """Return the fields of a dataclass that users can set, by name."""
    return {
        field.name: field
        for field in dataclasses.fields(cls)
        if field.init and not field.metadata.get("internal")
    }


def find_below(cls: type, key: str) -> list[str]:
    """Return the paths ('camera.width') of a key in the mappings that a dataclass contains."""
    paths = []
    for name in list_fields(cls):
        hint = list_annotations(cls)[name]
        is_union = typing.get_origin(hint) in (typing.Union, types.UnionType)
        kinds = typing.get_args(hint) if is_union else (hint,)
        for kind in filter(dataclasses.is_dataclass, kinds):
            found = [key] if key in list_fields(kind) else find_below(kind, key)
            paths += [f"{name}.{path}" for path in found]
    return list(dict.fromkeys(paths))


def describe_unknown_key(
    where: str, key: Any, known_keys: Iterable[str], renamed: Mapping[str, str] = NOTHING,
    below: Iterable[str] = (),
) -> str:  # fmt: skip
    """Return the message for an unknown key. It suggests the right place, name or spelling.

    Args:
        renamed: mapping from old names of keys to their new names, which a class of settings
            declares as `renamed_keys`.
        below: paths of keys with this name in the mappings that the settings contain.
    """
    head, colon, path = join_path(where, key).rpartition(": ")
    kind = path if path.startswith("parameter ") else f"key '{path}'"
    if key in renamed:
        return f"{head}{colon}{kind} is now called '{renamed[key]}'"
    if below := list(below):
        return f"{head}{colon}unknown {kind}: did you mean {' or '.join(map(repr, below))}?"
    return f"{head}{colon}unknown {kind}: {suggest(key, known_keys)}"


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of the nested mapping `base` with the values of `changes`.

    If both values of a key are mappings, they are merged in the same way, at every depth.
    Otherwise, the value in `changes` replaces the value in `base`.
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
