"""Frozen dataclasses from mappings: every key known, every value of its type, every number finite.

The fields' annotations say what is wanted, so a class that can be read from YAML is written once.
Understood are float, int, bool, str, tuples of those (of fixed length, or `tuple[float, ...]`),
Mapping, other such classes, and unions of them, tried in the order written.
"""

from __future__ import annotations

import contextlib
import copyreg
import dataclasses
import difflib
import functools
import math
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from aras_visual_servo_controller.setting_kinds import parsed_yaml

from .errors import ExperimentError

T = TypeVar("T")
LARGEST_FILE = 1_000_000  # bytes; a path such as /dev/zero must not be read to its end
_WORDS = {float: "a finite number", int: "a whole number", bool: "true or false", str: "a text"}


def _frozen(values: dict[str, Any]) -> types.MappingProxyType:
    return types.MappingProxyType(values)


# Python does not pickle read-only views by itself; an experiment goes to other processes.
copyreg.pickle(types.MappingProxyType, lambda view: (_frozen, (dict(view),)))


def nearest(name: str, known: typing.Iterable[str]) -> str:
    """What to say to an unknown name: the nearest known one, or all."""
    known = list(known)
    near = difflib.get_close_matches(str(name), known, 1)
    return f"did you mean '{near[0]}'?" if near else f"there are: {', '.join(known)}"


def build(cls: type[T], values: Any, where: str = "") -> T:
    """Make a dataclass of a mapping.

    Args:
        where: the mapping's own name, for messages.

    Raises:
        ExperimentError: unknown key, wrong type, or what the class itself refuses.
    """
    if not isinstance(values, Mapping):
        raise ExperimentError(f"{where or cls.__name__} is {values!r}, must be keys with values")
    known = {f.name: f for f in dataclasses.fields(cls) if f.init}
    hints = annotations(cls)
    found = {}
    for key, value in values.items():
        place = f"{where}.{key}" if where else str(key)
        if key not in known:
            raise ExperimentError(f"unknown key '{place}': {nearest(key, known)}")
        found[key] = convert(value, hints[key], place)
    try:
        return cls(**found)
    except TypeError as error:  # a field without a default is missing
        raise ExperimentError(f"{where or cls.__name__}: {error}") from None


@functools.lru_cache(maxsize=64)
def annotations(cls: type) -> dict[str, Any]:
    """Of a dataclass's fields, by name."""
    return typing.get_type_hints(cls)


def convert(value: Any, hint: Any, where: str) -> Any:
    """The value as the annotation wants it; ExperimentError where it cannot be."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return _union(value, typing.get_args(hint), where)
    if hint is type(None):
        if value is None:
            return None
    elif dataclasses.is_dataclass(hint):
        return value if isinstance(value, hint) else build(hint, value, where)
    elif origin is tuple:
        return _tuple(value, typing.get_args(hint), where)
    elif origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        if isinstance(value, Mapping):
            return types.MappingProxyType(dict(value))
    elif hint is float:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    elif isinstance(value, hint) and not (hint is int and isinstance(value, bool)):
        return value
    raise ExperimentError(f"{where} is {value!r}, must be {_words(hint)}")


def _union(value: Any, hints: tuple, where: str) -> Any:
    if isinstance(value, Mapping):
        # A mapping was meant for the class whose keys are like its own: that one may complain.
        classes = [hint for hint in hints if dataclasses.is_dataclass(hint)]
        if classes:
            return build(max(classes, key=lambda hint: _likeness(value, hint)), value, where)
    lists = [hint for hint in hints if typing.get_origin(hint) is tuple]
    if isinstance(value, list | tuple) and len(lists) == 1:  # as is the one list's
        return convert(value, lists[0], where)
    for hint in hints:
        with contextlib.suppress(ExperimentError):
            return convert(value, hint, where)
    wanted = " or ".join(_words(hint) for hint in hints if hint is not type(None))
    raise ExperimentError(f"{where} is {value!r}, must be {wanted}")


def _likeness(values: Mapping, cls: type) -> int:
    """How many of the keys are a field of the class, or near to one."""
    names = [f.name for f in dataclasses.fields(cls)]
    return sum(bool(difflib.get_close_matches(str(key), names, 1)) for key in values)


def _tuple(value: Any, hints: tuple, where: str) -> tuple:
    if not isinstance(value, list | tuple):
        raise ExperimentError(f"{where} is {value!r}, must be {_words(tuple[hints])}")
    if len(hints) == 2 and hints[1] is Ellipsis:
        hints = (hints[0],) * len(value)
    if len(value) != len(hints):
        raise ExperimentError(f"{where} has {len(value)} values, must have {len(hints)}")
    return tuple(
        convert(part, hint, f"{where}[{i}]")
        for i, (part, hint) in enumerate(zip(value, hints, strict=True))
    )


def _words(hint: Any) -> str:
    if hint in _WORDS:
        return _WORDS[hint]
    if typing.get_origin(hint) is tuple:
        parts = typing.get_args(hint)
        return "a list" if Ellipsis in parts else f"a list of {len(parts)}"
    return "keys with values"


def require(condition: bool, text: str) -> None:
    """Raise ExperimentError with this text unless the condition holds."""
    if not condition:
        raise ExperimentError(text)


def read_yaml(path: str | Path) -> Any:
    """What a YAML file holds.

    Raises:
        ExperimentError: it cannot be read, never ends, or is no YAML.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise ExperimentError(f"cannot read {path}: {error.strerror or error}") from None
    if len(data) > LARGEST_FILE:
        raise ExperimentError(f"{path} holds more than {LARGEST_FILE} bytes: no such file is meant")
    try:
        return parsed_yaml(data.decode())
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise ExperimentError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None
